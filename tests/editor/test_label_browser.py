"""The page of labels in a real browser: a shape is dragged over the table by the pointer."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import sync_playwright

from kit1000.editor.label_page import LabelPage, labelling
from kit1000.editor.page import eye_of
from kit1000.labelling.label_records import write_record
from tests.samples.labelled_scenes import own_folder, sample_scene, shapes_folder, true_record

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
PATIENCE_S = float(os.environ.get("KIT1000_PATIENCE_S", "60"))
STEPS = 6  # of the pointer

pytestmark = pytest.mark.slow


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "the page did not answer in time"
        time.sleep(0.2)


def middle_of(page: LabelPage, name: str) -> np.ndarray:
    return page.correction.world_from_body(name).apply(page.correction.mesh(name).bounds.mean(0))


def test_a_shape_follows_the_pointer(tmp_path: Path) -> None:
    if CHROMIUM is None:
        pytest.skip("no chromium on the search path: install one to see the page as a person does")
    root, source = own_folder(tmp_path / "mine"), shapes_folder(tmp_path / "shapes")
    write_record(root, true_record(sample_scene(), source))
    wanted = np.array([0.03, 0.02, 0.0])
    with labelling(root, None, None, ()) as (page, address), sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--enable-unsafe-swiftshader"])
        tab = browser.new_page(viewport={"width": 800, "height": 500})
        tab.goto(address)
        wait_for(lambda: bool(page.stage.server.get_clients()))
        time.sleep(10)  # software WebGL draws the meshes
        box = tab.locator("canvas").first.bounding_box()
        assert box is not None
        eye = eye_of(next(iter(page.stage.server.get_clients().values())))
        before = middle_of(page, "tee")
        start, end = (
            np.array(eye.screen(point)) * (box["width"], box["height"]) for point in (before, before + wanted)
        )
        tab.mouse.move(*start)
        time.sleep(1)
        tab.mouse.down()
        for share in np.linspace(0, 1, STEPS):
            tab.mouse.move(*(start + share * (end - start)))
            time.sleep(0.5)
        tab.mouse.up()
        wait_for(lambda: page.correction.body("tee").moved)
        assert np.linalg.norm(middle_of(page, "tee") - before - wanted) < 5e-3
        browser.close()
