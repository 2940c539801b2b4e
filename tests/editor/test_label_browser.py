"""The page of labels in a real browser: a shape is dragged over the table by the pointer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from kit1000.editor.label_page import LabelPage, labelling
from kit1000.editor.page import eye_of
from kit1000.labelling.label_records import write_record
from tests.editor.test_browser import WINDOW, browser, wait
from tests.samples.labelled_scenes import own_folder, sample_scene, shapes_folder, true_record

__all__ = ["browser"]  # a fixture

STEPS = 6  # of the pointer

pytestmark = pytest.mark.slow


def middle_of(page: LabelPage, name: str) -> np.ndarray:
    return page.correction.world_from_body(name).apply(page.correction.mesh(name).bounds.mean(0))


def test_a_shape_follows_the_pointer(tmp_path: Path, browser: Browser) -> None:
    root, source = own_folder(tmp_path / "mine"), shapes_folder(tmp_path / "shapes")
    write_record(root, true_record(sample_scene(), source))
    wanted = np.array([0.03, 0.02, 0.0])
    with labelling(root, None, None, ()) as (page, address):
        tab = browser.new_page(viewport=WINDOW)  # type: ignore[arg-type]
        tab.goto(address)
        wait(lambda: bool(page.stage.server.get_clients()), tab)
        tab.wait_for_timeout(10_000)  # software WebGL draws the meshes
        box = tab.locator("canvas").first.bounding_box()
        assert box is not None
        eye = eye_of(next(iter(page.stage.server.get_clients().values())))
        before = middle_of(page, "tee")
        start, end = (
            np.array(eye.screen(point)) * (box["width"], box["height"]) for point in (before, before + wanted)
        )
        tab.mouse.move(*start)
        tab.wait_for_timeout(1000)
        tab.mouse.down()
        for share in np.linspace(0, 1, STEPS):
            tab.mouse.move(*(start + share * (end - start)))
            tab.wait_for_timeout(500)
        tab.mouse.up()
        wait(lambda: page.correction.body("tee").moved, tab)
        assert np.linalg.norm(middle_of(page, "tee") - before - wanted) < 5e-3
        tab.close()
