"""The editing page in a real browser: a part dragged, snapped and confirmed by pointer and keys; cups; a second tab.

Software WebGL draws about a frame a second, so the window is small and everything waits for conditions.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from kit1000.dataset.reader import Dataset
from kit1000.editor.controller import Controller
from kit1000.editor.hand import PLACE, HandWorkspace
from kit1000.editor.page import eye_of
from kit1000.editor.pointing import Eye
from kit1000.editor.scene import EditedScene
from kit1000.editor.serve import Options, editing
from kit1000.editor.worker import Completion
from kit1000.known_shapes.predictor import FoundShape, FoundShapes
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.submission import read_submission
from kit1000.values import Query, TrueGeometry

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
WINDOW = {"width": 800, "height": 500}
PATIENCE_S = float(os.environ.get("KIT1000_PATIENCE_S", "60"))
NOT_OURS = ("THREE.", "GPU stall", "GL Driver Message")  # warnings of the libraries inside viser
SCROLLING = "Unable to preventDefault inside passive event listener"  # by viser's camera control, at a wheel or touch

GRIP = (0.0, 0.0, -0.03)  # [m] on a cup, up its tube

pytestmark = pytest.mark.slow


def near(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    """A method that answers 3 mm beside every guess."""
    assert query.guess is not None
    return PredictedMotion(Pose.from_translation((0.003, 0.0, 0.0)) @ query.guess, 0.9)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium with software WebGL."""
    if CHROMIUM is None:
        pytest.skip("no chromium on the search path: install one to see the page as a person does")
    with sync_playwright() as play:
        opened = play.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-gpu-vsync"]
        )
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def session(mini: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Controller, str]]:
    """An editing session with that method, and its address."""
    scene_id = Dataset(mini).split("test").scene_ids[0]
    options = Options(mini, scene_id, tmp_path_factory.mktemp("edits"), snap=f"{__name__}:near")
    with editing(options) as opened:
        yield opened


@pytest.fixture
def carrying(mini: Path, tmp_path: Path) -> Iterator[tuple[Controller, str]]:
    """A session of hand control, and its address."""
    scene_id = Dataset(mini).split("test").scene_ids[0]
    with editing(Options(mini, scene_id, tmp_path, interface="hand")) as opened:
        yield opened


@pytest.fixture(scope="module")
def visit(browser: Browser) -> Iterator[Callable[[str], Page]]:
    """Opens a page; nothing may be asked of another host, and no error may be written to the console."""
    complaints: list[str] = []
    context = browser.new_context(viewport=WINDOW, device_scale_factor=0.5)  # type: ignore[arg-type]

    def opened(address: str) -> Page:
        page = context.new_page()
        page.on("console", lambda one: _complain(complaints, one.type, one.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda one: None if _is_own(one.url, address) else complaints.append(one.url))
        page.goto(address)
        page.wait_for_selector("canvas", timeout=1000 * PATIENCE_S)
        return page

    yield opened
    context.close()
    assert not complaints


def _complain(complaints: list[str], kind: str, text: str) -> None:
    if SCROLLING in text:
        return
    if kind == "error" or (kind == "warning" and not any(word in text for word in NOT_OURS)):
        complaints.append(text)


def _is_own(url: str, address: str) -> bool:
    return url.startswith((address, "data:", "blob:"))


def wait(condition: Callable[[], bool], page: Page) -> None:
    """Until a condition holds."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, page.inner_text("body")
        page.wait_for_timeout(100)


def eye(controller: Controller) -> Eye:
    """Of the tab in charge."""
    clients = controller.stage.server.get_clients()
    return eye_of(clients[min(clients)])


def on_page(controller: Controller, page: Page, point: np.ndarray) -> tuple[float, float]:
    """Where a point (3,) [m] is in the window [px]."""
    box = page.locator("canvas").first.bounding_box()
    assert box is not None
    x, y = eye(controller).screen(point)
    return box["x"] + x * box["width"], box["y"] + y * box["height"]


def ready(controller: Controller, page: Page) -> None:
    """Until the page is connected, its camera known, and its notices closed: they swallow the pointer."""
    wait(lambda: len(controller.stage.server.get_clients()) > 0, page)
    page.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(one => one.click())")
    bounds = controller.space.scene.bounds
    wait(lambda: 0.43 < max(np.abs(np.subtract(eye(controller).screen(p), 0.5)).max() for p in bounds) < 0.46, page)


def test_a_part_is_edited_from_start_to_a_confirmed_file(
    session: tuple[Controller, str], visit: Callable[[str], Page]
) -> None:
    controller, page = session[0], visit(session[1])
    ready(controller, page)
    renderer = "document.createElement('canvas').getContext('webgl').getParameter(0x1F01)"
    assert page.evaluate(renderer)
    space, part = controller.space, controller.space.scene.parts[0]
    pivot, plate = space.scene.pivot(part), space.scene.plates[0]
    page.mouse.move(*on_page(controller, page, pivot))
    page.mouse.down()
    page.mouse.move(*on_page(controller, page, plate.point), steps=4)
    wait(lambda: space.over_kits(part), page)
    page.mouse.up()
    wait(lambda: len(space.session.done) == 1, page)
    hand = space.session.edits[part].goal_from_now
    assert float(np.abs(plate.projected(hand.apply(pivot)) - plate.point).max()) < 0.02
    wait(lambda: space.ghost(part) is not None, page)  # the method has answered the hand
    page.get_by_text("90 % sure").first.wait_for(timeout=1000 * PATIENCE_S)
    page.keyboard.press("Space")
    wait(lambda: space.session.edits[part].state == "snapped", page)
    page.keyboard.press("Enter")
    wait(lambda: space.session.edits[part].confirmed, page)
    assert np.allclose(space.session.edits[part].goal_from_now.xyz, hand.xyz + (0.003, 0.0, 0.0), atol=1e-12)
    page.get_by_text("confirmed").first.wait_for(timeout=1000 * PATIENCE_S)
    assert len(read_submission(controller.log.path.parent).predictions) >= 1
    page.keyboard.press("Control+z")
    wait(lambda: space.session.edits[part].state == "snapped", page)
    page.keyboard.press("Control+y")
    wait(lambda: space.session.edits[part].confirmed, page)
    page.close()


def test_a_part_is_carried_by_two_cups(carrying: tuple[Controller, str], visit: Callable[[str], Page]) -> None:
    controller, page = carrying[0], visit(carrying[1])
    ready(controller, page)
    space, part = controller.space, controller.space.scene.parts[0]
    assert isinstance(space, HandWorkspace)
    page.get_by_text("drag the green cup onto a part").first.wait_for(timeout=1000 * PATIENCE_S)
    page.keyboard.press(str(part + 1))
    wait(lambda: space.carried(PLACE) == part, page)
    page.mouse.move(*on_page(controller, page, space.rest(PLACE).apply(GRIP)))
    page.mouse.down()
    page.mouse.move(*on_page(controller, page, space.scene.plates[0].point), steps=4)
    wait(lambda: space.over_kits(PLACE), page)
    page.mouse.up()
    wait(lambda: len(space.session.done) == 2, page)
    expected = space.part_edit(PLACE).goal_from_now
    page.keyboard.press("Enter")
    wait(lambda: space.session.edits[part].confirmed, page)
    assert space.session.edits[part].goal_from_now.xyz.tolist() == expected.xyz.tolist()
    wait(lambda: (controller.log.path.parent / "manifest.toml").is_file(), page)
    assert len(read_submission(controller.log.path.parent).predictions) >= 1
    page.close()


def test_a_part_is_dragged_after_its_known_shape_has_replaced_what_was_seen(
    mini: Path, tmp_path: Path, visit: Callable[[str], Page]
) -> None:
    scene_id = Dataset(mini).split("test").scene_ids[0]
    true = EditedScene.open(Dataset(mini), scene_id, "ideal", truth=True)
    found = {part: FoundShape("known", mesh, ()) for part, mesh in true.meshes.items()}
    with editing(Options(mini, scene_id, tmp_path)) as (controller, address):
        page = visit(address)
        controller.completed(Completion(FoundShapes(FoundShape("kits", true.kits, ()), found)))
        ready(controller, page)
        space, part = controller.space, controller.space.scene.parts[0]
        page.get_by_text("known").first.wait_for(timeout=1000 * PATIENCE_S)
        page.mouse.move(*on_page(controller, page, space.scene.pivot(part)))
        page.mouse.down()
        page.mouse.move(*on_page(controller, page, space.scene.plates[0].point), steps=4)
        wait(lambda: space.over_kits(part), page)
        page.mouse.up()
        wait(lambda: len(space.session.done) == 1, page)
        page.close()


def test_a_reload_shows_the_same_and_a_second_tab_only_watches(
    session: tuple[Controller, str], visit: Callable[[str], Page]
) -> None:
    controller = session[0]
    part, plate = controller.space.scene.parts[0], controller.space.scene.plates[0]
    controller.place(part, Pose.from_translation(plate.point - controller.space.scene.pivot(part)))
    controller.command("confirm")
    page = visit(session[1])
    ready(controller, page)
    page.get_by_text("confirmed").first.wait_for(timeout=1000 * PATIENCE_S)
    count = len(controller.space.session.done)
    second = visit(session[1])
    second.get_by_text("only watches").first.wait_for(timeout=1000 * PATIENCE_S)
    second.keyboard.press("Control+z")
    page.bring_to_front()
    page.keyboard.press("x")  # the positive control: of the two keys this one counts
    wait(lambda: len(controller.space.session.done) != count, page)
    assert controller.space.session.done[-1].name == f"part {part + 1}: turn"
    assert len(controller.space.session.done) == count + 1
