"""An interrupted sitting continues with its uploads, its outcomes and its clock, and the record counts it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any, cast
from unittest.mock import MagicMock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

pytest.importorskip("viser")

from kit1000.cli import main
from kit1000.dataset.json_rows import pose_row
from kit1000.dataset.reader import Dataset
from kit1000.planner.execute import PartRun
from kit1000.pose import Pose
from kit1000.study import sitting
from kit1000.study.pages import TaskPanel
from kit1000.study.plan import write_plan
from kit1000.study.records import PRACTICE_FILE, ParticipantFiles, PartResult
from kit1000.study.sitting import FINISH, UPLOAD, Sitting, TaskClock, TaskPage, time_limit
from tests.samples.editing import desk, dragged, goal, scene_of
from tests.samples.studies import plan_of, write_participant

MOTION = Pose.from_translation((0.01, 0.02, 0.03))


class Robot:
    """Seats everything in ten seconds, and remembers the uploads."""

    def __init__(self) -> None:
        self.uploads: list[dict[int, Pose]] = []

    def __call__(self, motions: Mapping[int, Pose]) -> list[PartRun]:
        self.uploads.append(dict(motions))
        return [PartRun(part, "seated", "", 10.0) for part in motions]


def page_of(tmp_path: Path, condition: int = 0, index: int = 1) -> TaskPage:
    plan = plan_of()
    session = next(each for each in plan.sessions(1) if each.condition.name == plan.conditions[condition])
    return TaskPage(Sitting(ParticipantFiles(tmp_path, plan, 1), cast(Dataset, None)), session, index)


def test_work_before_a_crash_is_continued(tmp_path: Path) -> None:
    page, robot = page_of(tmp_path), Robot()
    rows: list[dict[str, Any]] = [
        {"event": "open"},
        {"event": "undo"},
        {"event": "upload", "motions": {"1": pose_row(MOTION)}, "specification_s": 12.5, "execution_s": 0.0},
        {"event": "executed", "outcomes": {"1": "seated"}, "specification_s": 12.5, "execution_s": 10.0},
        {"event": "refuse"},
        {"event": "clock", "specification_s": 31.25, "execution_s": 10.0},
        {"event": "close"},
    ]
    page.resume(rows, robot)
    [upload] = robot.uploads
    assert list(upload) == [1]
    assert upload[1].wxyz.tobytes() + upload[1].xyz.tobytes() == MOTION.wxyz.tobytes() + MOTION.xyz.tobytes()
    assert page.outcomes == {1: "seated"}
    assert (page.clock.specified, page.clock.execution, page.clock.reading) == (31.25, 10.0, 41.25)
    record = page.record({i: PartResult(i, "seated", True, 1.0, 1.0) for i in range(2)}, rows)
    assert (record.uploads, record.undos, record.refused, record.interruptions) == (1, 1, 1, 1)
    assert not record.out_of_time  # there was time left: the participant ended the task


def test_the_command_continues_a_sitting_whose_steps_are_done(
    mini: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = replace(plan_of(), dataset_id=Dataset(mini).id)
    write_plan(tmp_path, plan)
    files = ParticipantFiles(tmp_path, plan, 1)
    write_participant(files)
    for session in plan.sessions(1):
        (files.of_session(session) / PRACTICE_FILE).touch()
    monkeypatch.setattr(sitting, "serving", lambda *_: nullcontext((None, "http://127.0.0.1:8080")))
    monkeypatch.setattr(sitting, "say_goodbye", lambda _: None)
    assert main(["study", str(mini), "--out", str(tmp_path), "--participant", "1"]) == 0
    assert "complete" in capsys.readouterr().out


def test_while_the_robot_works_clock_and_hand_stand_still(mini: Path, tmp_path: Path) -> None:
    """One part is uploaded; nothing that the participant does meanwhile has an effect."""
    scene = scene_of(mini)
    table, part = desk(scene, tmp_path), scene.parts[0]
    controller, page, true = table.controller, page_of(tmp_path), goal(scene, part)
    controller.place(part, true)
    controller.command("confirm")
    before = controller.space.session

    class BusyRobot(Robot):
        def __call__(self, motions: Mapping[int, Pose]) -> list[PartRun]:
            controller.place(part, MOTION)
            dragged(table, part, np.zeros(3))
            for verb in ("undo", "reset-all", "turn-left"):
                controller.command(verb)
            assert "robot is at work" in table.stage.texts["note"]
            return super().__call__(motions)

    page.clock.start()
    page.upload(controller, BusyRobot(), cast(TaskPanel, MagicMock()))
    assert page.outcomes == {part: "seated"}
    assert controller.space.session is before
    assert controller.space.current[part].goal_from_now is before.edits[part].goal_from_now
    controller.command("undo")
    assert controller.space.session is not before


def test_time_that_ran_out_is_on_record(tmp_path: Path) -> None:
    page = page_of(tmp_path)
    page.clock.specification = 120.0
    record = page.record({i: PartResult(i, "not uploaded", False, None, None) for i in range(2)}, [])
    assert record.out_of_time
    assert record.interruptions == record.uploads == 0


def test_a_part_that_a_hand_has_carried_is_an_upload_by_itself(tmp_path: Path) -> None:
    carried = {"event": "do", "edits": {"0": {"confirmed": True}, "-2": {"confirmed": False}}}
    moved = {"event": "do", "edits": {"-2": {"confirmed": False}}}
    scene, hand = page_of(tmp_path, 0), page_of(tmp_path, 1)
    for page in (scene, hand):
        page.seen(moved)
        assert page.requests.empty()
        page.seen(carried)
    assert scene.requests.empty()
    assert hand.requests.get_nowait() == UPLOAD != FINISH


@pytest.mark.parametrize(
    "option", ["--people 8", "--conditions scene hand", "--sensor d415", "--snap none", "--seed 7"], ids=str.split
)
def test_an_option_that_contradicts_the_plan_is_refused(
    mini: Path, tmp_path: Path, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_plan(tmp_path, replace(plan_of(), dataset_id=Dataset(mini).id))
    assert main(["study", str(mini), "--out", str(tmp_path), *option.split()]) == 2
    error = capsys.readouterr().err
    assert option in error
    assert str(tmp_path) in error


def test_a_sitting_and_a_report_cannot_be_combined(
    mini: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", str(mini), "--out", str(tmp_path), "--participant", "1", "--report"]) == 2
    assert "--participant" in capsys.readouterr().err


class Now:
    def __init__(self) -> None:
        self.seconds = 100.0

    def __call__(self) -> float:
        return self.seconds


def test_the_clock_stands_still_while_the_participant_is_not_in_charge() -> None:
    now = Now()
    clock = TaskClock(2, now)
    now.seconds += 5
    assert clock.reading == 0
    clock.start()
    now.seconds += 5
    clock.stop()
    now.seconds += 50
    assert clock.reading == 5
    clock.executed(23)
    clock.start()
    clock.start()  # twice is once
    now.seconds += 1
    assert (clock.specified, clock.execution, clock.reading) == (6, 23, 29)


@given(st.lists(st.tuples(st.sampled_from(["start", "stop", "wait", "run"]), st.floats(0, 50)), max_size=20))
def test_the_clock_never_goes_back(steps: list[tuple[str, float]]) -> None:
    now = Now()
    clock, before = TaskClock(3, now), 0.0
    for kind, seconds in steps:
        if kind == "wait":
            now.seconds += seconds
        elif kind == "run":
            clock.executed(seconds)
        else:
            getattr(clock, kind)()
        assert clock.reading >= before - 1e-9
        assert clock.may_upload() == (clock.reading < time_limit(3))
        before = clock.reading
