"""A whole sitting in a real browser, by a scripted pointer: consent, practice, tasks, questionnaires, last question."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

from kit1000.dataset.reader import Dataset
from kit1000.editor.controller import Controller
from kit1000.editor.hand import PLACE
from kit1000.planner.execute import PartRun
from kit1000.study import sitting
from kit1000.study.plan import StudyPlan, write_plan
from kit1000.study.questionnaire import SCALES
from kit1000.study.records import ParticipantFiles, read_participants
from kit1000.study.tasks import Task, Tasks, part_truths
from tests.editor.test_browser import PATIENCE_S, WINDOW, browser, on_page, ready, wait

__all__ = ["browser"]  # a fixture

pytestmark = pytest.mark.slow


@pytest.fixture
def plan(mini: Path) -> StudyPlan:
    """One task a condition, in the first scene whose parts can all be edited; it has a single part, so that a task ends
    with its upload."""
    split = Dataset(mini).split("test-all", truth=True)
    sizes = {scene.id: len(scene.scene.bodies) - 1 for scene in split}
    asked = {scene.id: {query.part for query in scene.queries if query.track == "snap"} for scene in split}
    tasks = [Task(i, size) for i, size in sizes.items() if size == 1 and asked[i] == {0}]
    return StudyPlan(Dataset(mini).id, "ideal", "none", ("scene", "hand"), 4, 0, Tasks(tasks[0], ((tasks[0],),) * 2))


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Controller]:
    """The controllers of the editing pages, in the order in which they open; the seating test replaces the robot."""
    controllers: list[Controller] = []
    editing = sitting.editing

    @contextlib.contextmanager
    def watched(*arguments: Any) -> Iterator[tuple[Controller, str]]:
        with editing(*arguments) as (controller, address):
            controllers.append(controller)
            yield controller, address

    def execution(scene: Any, sensor: str, seed: int) -> Any:
        def run(motions: Any) -> SimpleNamespace:
            truths, unknown = part_truths(scene, sensor), dict.fromkeys(motions, "")
            found = sitting.measured(scene.split.dataset, truths, motions, unknown)
            outcomes = {i: "seated" if found[i].seated_by_test else "not seated" for i in motions}
            return SimpleNamespace(parts=[PartRun(i, outcome, "", 23.0) for i, outcome in outcomes.items()])

        return contextlib.nullcontext(SimpleNamespace(run=run))

    monkeypatch.setattr(sitting, "editing", watched)
    monkeypatch.setattr(sitting, "robot_at", execution)
    return controllers


class Person:
    """Drives the page."""

    def __init__(self, page: Page, opened: list[Controller]) -> None:
        self.page, self.opened, self.tasks = page, opened, 0

    def press(self, button: str) -> None:
        self.page.get_by_role("button", name=button, exact=True).click(timeout=1000 * PATIENCE_S)

    def choose(self, label: str, answer: str) -> None:
        self.page.get_by_label(label, exact=True).first.click(timeout=1000 * PATIENCE_S)
        self.page.get_by_role("option", name=answer, exact=True).click(timeout=1000 * PATIENCE_S)

    def task(self) -> Controller:
        """The next editing page, open and ready."""
        self.tasks += 1
        wait(lambda: len(self.opened) == self.tasks, self.page)
        ready(self.opened[-1], self.page)
        self.page.get_by_text("Finish task").first.wait_for(timeout=1000 * PATIENCE_S)
        return self.opened[-1]

    def drag(self, controller: Controller, body: int, plate: int) -> None:
        """Drag a part or a cup onto a plate, 0 being the largest."""
        space = controller.space
        start, before = space.current[body].goal_from_now.apply(space.pivot(body)), len(space.session.done)
        self.page.mouse.move(*on_page(controller, self.page, start))
        self.page.mouse.down()
        self.page.mouse.move(*on_page(controller, self.page, space.scene.plates[plate].point), steps=4)
        wait(lambda: space.over_kits(body), self.page)
        self.page.mouse.up()
        wait(lambda: len(space.session.done) > before, self.page)


def use_scene(person: Person) -> None:
    """Each part is dragged and confirmed, then all are uploaded."""
    controller = person.task()
    for i, part in enumerate(controller.space.scene.parts):
        person.drag(controller, part, i)
        person.page.keyboard.press("Enter")
        wait(lambda: controller.space.session.edits[part].confirmed, person.page)  # noqa: B023
    person.press("Upload")


def use_hand(person: Person) -> None:
    """Each part is picked by its number and carried; that is an upload by itself."""
    controller = person.task()
    for i, part in enumerate(controller.space.scene.parts):
        person.page.keyboard.press(str(part + 1))
        wait(lambda: controller.space.carried(PLACE) is not None, person.page)
        person.drag(controller, PLACE, i)
        person.page.keyboard.press("Enter")
        wait(lambda: controller.log.path.read_text().count('"executed"') > i, person.page)  # noqa: B023


def test_a_sitting_from_consent_to_the_last_question(
    mini: Path, plan: StudyPlan, opened: list[Controller], browser: Browser, tmp_path: Path, capsys: Any
) -> None:
    write_plan(tmp_path, plan)
    dataset = Dataset(mini)
    served = sitting.Sitting(ParticipantFiles(tmp_path, plan, 1), dataset)
    thread = threading.Thread(target=served.run, daemon=True)
    thread.start()
    page = browser.new_page(viewport=WINDOW)  # type: ignore[arg-type]
    printed: list[str] = []

    def address() -> bool:
        printed.append(capsys.readouterr().out)
        return "http://" in "".join(printed)

    wait(address, page)
    page.goto("".join(printed).split()[0])
    begin = page.get_by_role("button", name="Begin", exact=True)
    begin.wait_for(timeout=1000 * PATIENCE_S)
    assert begin.is_disabled()
    assert not list(tmp_path.rglob("participant.json"))
    page.get_by_role("checkbox").first.check()
    wait(lambda: begin.is_enabled(), page)
    begin.click()
    person = Person(page, opened)
    steps: dict[str, Callable[[Person], None]] = {"scene": use_scene, "hand": use_hand}
    for session in plan.sessions(1):
        person.task()
        person.press("Finish task")  # of the practice
        steps[session.condition.name](person)
        submit = page.get_by_role("button", name="Submit", exact=True)
        submit.wait_for(timeout=1000 * PATIENCE_S)
        for i, scale in enumerate(SCALES):
            assert submit.is_disabled()
            person.choose(scale.title, str(10 * i))
        wait(lambda: submit.is_enabled(), page)  # noqa: B023
        submit.click()
    person.choose("Answer", "Hand control")
    person.press("Submit")
    page.get_by_text("You have finished").first.wait_for(timeout=1000 * PATIENCE_S)
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    [someone] = read_participants(tmp_path, plan)
    assert someone.preferred == "hand"
    assert {tuple(ratings.values()) for ratings in someone.ratings.values()} == {(0, 10, 20, 30, 40, 50)}
    assert len(someone.trials) == 2
    for trial in someone.trials:
        assert trial.uploads == 1
        assert sum(part.position_mm is not None for part in trial.parts) == 1
        assert trial.specification_s > 0
    page.close()
