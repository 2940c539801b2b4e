"""The picture of the editing page in the README: a scripted pointer drags a part onto its cavity in Chromium.

python docs/pictures/editor_page.py data/kit1000
"""

from __future__ import annotations

import io
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from editor import OFF, SCENE, goal_of
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from kit1000.cli.scenes import SNAP
from kit1000.editor.controller import Controller
from kit1000.editor.page import ViserStage, eye_of
from kit1000.editor.pointing import Eye
from kit1000.editor.serve import Options, editing

OUT = Path(__file__).with_name("editor.png")
WINDOW = (1280, 800)  # [px]
STEPS = 6  # of the drag
PATIENCE_S = 300.0  # for all fits of the scene, on a busy machine
FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader"]  # software WebGL: no graphics card is needed


def main(data: Path) -> None:
    """Edit, and write the picture."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with (
        TemporaryDirectory() as folder,
        editing(Options(data, SCENE, Path(folder), snap=SNAP)) as (editor, address),
        sync_playwright() as play,
    ):
        browser = play.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": WINDOW[0], "height": WINDOW[1]})
        page.goto(address)
        _drag(editor, page)
        Image.open(io.BytesIO(page.screenshot())).convert("RGB").save(OUT, optimize=True)
        browser.close()


def _drag(editor: Controller, page: Page) -> None:
    """Drag the first part onto its cavity, and let go."""
    scene, space = editor.space.scene, editor.space
    part, seen = scene.parts[0], scene.tops[scene.parts[0]]
    place = goal_of(scene, part).apply(scene.pivot(part))
    _wait(page, lambda: _framed(editor))
    page.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(one => one.click())")
    _wait(page, lambda: not space.sought())
    grabbed = seen[np.square(seen - scene.pivot(part)).sum(1).argmin()]
    page.mouse.move(*_pixel(editor, page, grabbed))
    page.mouse.down()
    target = space.pointing.below(place).projected(place) + OFF
    page.mouse.move(*_pixel(editor, page, target), steps=STEPS)
    _wait(page, lambda: space.ghost(part) is not None)
    page.mouse.up()
    _wait(page, lambda: bool(space.session.done) and not space.waits(part))
    page.wait_for_timeout(3000)  # what was sent last is drawn


def _framed(editor: Controller) -> bool:
    """Whether the browser shows the whole scene."""
    eye = _eye(editor)
    away = [np.abs(np.subtract(eye.screen(point), 0.5)).max() for point in editor.space.scene.bounds] if eye else []
    return bool(away) and 0.43 < max(away) < 0.46


def _eye(editor: Controller) -> Eye | None:
    """The camera of the browser; None until it is connected."""
    assert isinstance(editor.stage, ViserStage)
    return next((eye_of(client) for client in editor.stage.server.get_clients().values()), None)


def _pixel(editor: Controller, page: Page, point: np.ndarray) -> tuple[float, float]:
    """Where a point (3,) [m] of the world is in the window."""
    box, eye = page.locator("canvas").first.bounding_box(), _eye(editor)
    assert box is not None
    assert eye is not None
    x, y = eye.screen(point)
    return box["x"] + x * box["width"], box["y"] + y * box["height"]


def _wait(page: Page, condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("the page does not get on")
        page.wait_for_timeout(200)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
