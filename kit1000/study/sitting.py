"""A sitting of one participant: consent, then for each condition practice, four tasks and a questionnaire, and the end.

Each step is a page of the same address and leaves a file when it is done, so that a sitting goes on where it was broken
off: in the middle of a task with its edits, its uploads and its clock.
"""

from __future__ import annotations

import contextlib
import platform
import queue
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kit1000.dataset.reader import Dataset
from kit1000.dataset.tables import pose_of, pose_row
from kit1000.editor.controller import Controller
from kit1000.editor.records import EventLog
from kit1000.editor.serve import Options, editing, serving
from kit1000.planner.execute import SEATED
from kit1000.pose import Pose
from kit1000.study.clock import TaskClock
from kit1000.study.execution import DECIMALS, ROBOT, Judge, judging, measured
from kit1000.study.pages import TaskPanel, ask_consent, ask_preference, ask_ratings, say_goodbye
from kit1000.study.questionnaire import CONSENT_VERSION
from kit1000.study.study_plan import Session, StudyPlan
from kit1000.study.study_records import (
    CLOSING_FILE,
    PARTICIPANT_FILE,
    PERSON,
    RATINGS_FILE,
    TRIAL_FILE,
    PartResult,
    TrialRecord,
    check_judge,
    condition_folder,
    participant_folder,
    trial_folder,
    write_record,
    write_trial,
)
from kit1000.study.tasks import part_truths
from kit1000.study.trial_header import TrialHeader, header_of
from kit1000.version import __version__

PRACTICE = 0
PRACTICE_FILE = "practised.json"
FINISH, UPLOAD = "finish", "upload"
TICK_S = 1.0  # [s] between two looks at the clock


@dataclass(frozen=True)
class Sitting:
    """What a sitting is about."""

    study: Path
    plan: StudyPlan
    dataset: Dataset
    number: int
    port: int
    judge: str = ROBOT
    origins: tuple[str, ...] = ()


def sit(
    study: Path,
    plan: StudyPlan,
    dataset: Dataset,
    number: int,
    port: int | None = None,
    judge: str = ROBOT,
    origins: tuple[str, ...] = (),
) -> None:
    """Serve the pages of a participant one after another, until the end or Ctrl-C."""
    sessions = plan.sessions(number)
    with serving(port, origins) as (_, address):
        chosen = int(address.rpartition(":")[2])
    print(f"{address}  participant {number} (Ctrl-C ends; the same command again goes on)", flush=True)
    sitting = Sitting(study, plan, dataset, number, chosen, judge, origins)
    _consent(sitting)
    for session in sessions:
        folder = condition_folder(study, PERSON, number, session.position, session.condition.name)
        if not (folder / PRACTICE_FILE).is_file():
            TaskPage(sitting, session, PRACTICE).run()
            write_record(folder / PRACTICE_FILE, plan.id, number, PERSON)
        for task in range(1, len(session.tasks) + 1):
            path = trial_folder(study, PERSON, number, session.position, session.condition.name, task)
            if not (path / TRIAL_FILE).is_file():
                write_trial(path, TaskPage(sitting, session, task).run())
        if not (folder / RATINGS_FILE).is_file():
            with serving(chosen, origins) as (server, _):
                ratings = ask_ratings(server, session.condition.label)
            write_record(folder / RATINGS_FILE, plan.id, number, PERSON, ratings=ratings)
    _close(sitting)


def _consent(sitting: Sitting) -> None:
    path = participant_folder(sitting.study, PERSON, sitting.number) / PARTICIPANT_FILE
    if path.is_file():
        check_judge(path, sitting.plan.id, PERSON, sitting.number, sitting.judge)
        return
    with serving(sitting.port, sitting.origins) as (server, _):
        ask_consent(server)
    consent = {"version": CONSENT_VERSION, "time": round(time.time(), DECIMALS)}
    versions = {"kit1000": __version__, "python": platform.python_version(), "machine": platform.machine()}
    write_record(path, sitting.plan.id, sitting.number, PERSON, judge=sitting.judge, consent=consent, versions=versions)


def _close(sitting: Sitting) -> None:
    path = participant_folder(sitting.study, PERSON, sitting.number) / CLOSING_FILE
    with serving(sitting.port, sitting.origins) as (server, _):
        if not path.is_file():
            preferred = ask_preference(server, sitting.plan.conditions)
            write_record(path, sitting.plan.id, sitting.number, PERSON, preferred=preferred)
        say_goodbye(server)
    print(f"{path.parent}: complete")


@dataclass
class TaskPage:
    """One task at the page."""

    sitting: Sitting
    session: Session
    index: int
    """From 1; 0 to practise."""
    requests: queue.Queue[str] = field(default_factory=queue.Queue)
    motions: dict[int, Pose] = field(default_factory=dict)
    outcomes: dict[int, str] = field(default_factory=dict)
    uploads: int = 0
    tally: dict[str, int] = field(default_factory=lambda: {"undo": 0, "refuse": 0})

    def __post_init__(self) -> None:
        plan, number, condition = self.sitting.plan, self.sitting.number, self.session.condition
        self.task = self.session.tasks[self.index - 1] if self.index else plan.tasks.practice
        self.header: TrialHeader = header_of(plan, PERSON, number, self.session, self.index)
        self.folder = trial_folder(
            self.sitting.study, PERSON, number, self.session.position, condition.name, self.index
        )
        self.clock = TaskClock(self.task.kits, time.monotonic)

    def run(self) -> TrialRecord:
        """Serve the page until the task is done."""
        plan, scene = self.sitting.plan, self.sitting.dataset.recorded_scene(self.task.scene, truth=True)
        truths = part_truths(scene, plan.sensor)
        snap = plan.snap if self.session.condition.snaps else "none"
        options = Options(
            self.sitting.dataset.root,
            self.task.scene,
            self.folder,
            plan.sensor,
            snap,
            self.sitting.port,
            interface=self.header.interface,
            origins=self.sitting.origins,
        )
        earlier = EventLog(self.folder, self.header).rows
        with (
            judging(self.sitting.judge, scene, plan.sensor, plan.seed) as judge,
            editing(options, self.seen, self.header) as (controller, _),
        ):
            self.resume(earlier, judge)
            server: Any = controller.stage.server  # type: ignore[attr-defined]
            panel = TaskPanel(server, self._title(), self.session.condition.one_part_an_upload, self.requests.put)
            self._work(controller, judge, panel, len(truths))
        return self.record(measured(self.sitting.dataset, truths, self.motions, self.outcomes), earlier)

    def _work(self, controller: Controller, judge: Judge, panel: TaskPanel, parts: int) -> None:
        panel.wait_for_somebody()
        self.clock.start()
        try:
            for request in self._requests(panel):
                if request == FINISH or (self.index and not self.clock.may_upload()):
                    return
                if request == UPLOAD:
                    self.upload(controller, judge, panel)
                if len(self.motions) == parts or (not self.index and SEATED in self.outcomes.values()):
                    return
        finally:
            self.clock.stop()
            controller.log.add("clock", **self._reading())

    def _requests(self, panel: TaskPanel) -> Iterator[str]:
        """What is asked for at the page, and an empty word at each tick."""
        while True:
            panel.show(self.clock.left if self.index else None, self.outcomes)
            request = ""
            with contextlib.suppress(queue.Empty):
                request = self.requests.get(timeout=TICK_S)
            yield request

    def upload(self, controller: Controller, judge: Judge, panel: TaskPanel) -> None:
        with controller.lock:
            edits = controller.space.session.edits
            parts = [
                part for part in controller.space.scene.parts if edits[part].confirmed and part not in self.motions
            ]
            motions = {part: edits[part].goal_from_now for part in parts}
            controller.held = bool(motions)  # the clock stands still: so does the hand
        if not motions:
            panel.note("Nothing to upload: confirm a part first.")
            return
        self.clock.stop()
        rows = {str(part): pose_row(motion) for part, motion in motions.items()}
        controller.log.add("upload", motions=rows, **self._reading())
        panel.note("The robot is at work …")
        self._carry_out(judge, motions)
        controller.log.add("executed", outcomes={str(i): self.outcomes[i] for i in motions}, **self._reading())
        panel.note("")
        controller.held = False
        self.clock.start()

    def _carry_out(self, judge: Judge, motions: dict[int, Pose]) -> None:
        carried = judge.carry_out(motions)
        self.clock.executed(sum(each.seconds for each in carried.values()))
        self.motions |= motions
        self.outcomes |= {part: each.outcome for part, each in carried.items()}
        self.uploads += 1

    def resume(self, rows: Sequence[Mapping[str, Any]], judge: Judge) -> None:
        """Take up what an interrupted sitting has left: uploads are carried out again, the clock goes on."""
        for row in rows:
            self._count(row["event"])
            if row["event"] == "upload":
                self._carry_out(judge, {int(part): pose_of(motion) for part, motion in row["motions"].items()})
            if "specification_s" in row:
                self.clock.specification = float(row["specification_s"])

    def seen(self, row: Mapping[str, Any]) -> None:
        """An event of the page. With a hand, the part that it has carried is an upload."""
        self._count(row["event"])
        carried = row["event"] == "do" and any(edit.get("confirmed") for edit in row["edits"].values())
        if carried and self.session.condition.one_part_an_upload:
            self.requests.put(UPLOAD)

    def _count(self, event: str) -> None:
        if event in self.tally:
            self.tally[event] += 1

    def _reading(self) -> dict[str, float]:
        return {
            "specification_s": round(self.clock.specified, DECIMALS),
            "execution_s": round(self.clock.execution, DECIMALS),
        }

    def _title(self) -> str:
        what = f"Task {self.index} of {len(self.session.tasks)}" if self.index else "Practice: seat one part"
        return f"{what} · {self.session.condition.label}"

    def record(self, parts: Mapping[int, PartResult], earlier: Sequence[Mapping[str, Any]]) -> TrialRecord:
        """The record of the task. parts: what became of them. earlier: events of sittings that were broken off."""
        return TrialRecord(
            study=self.sitting.plan.id,
            participant=self.sitting.number,
            operator=PERSON,
            condition=self.session.condition.name,
            position=self.session.position,
            task=max(self.index, 1),
            scene=self.task.scene,
            kits=self.task.kits,
            task_set=self.session.task_set,
            parts=tuple(parts.values()),
            uploads=self.uploads,
            undos=self.tally["undo"],
            refused=self.tally["refuse"],
            interruptions=sum(row["event"] == "open" for row in earlier),
            out_of_time=len(self.motions) < len(parts) and not self.clock.may_upload(),
            **self._reading(),
        )
