"""A sitting of one participant: consent, then practice, tasks and a questionnaire for each condition, and the end.

Each step is a page at the same address and leaves a file when it is done, so a sitting continues where it was
interrupted: within a task with its edits, its uploads and its clock.
"""

from __future__ import annotations

import contextlib
import platform
import queue
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kit1000.dataset.json_rows import pose_of, pose_row
from kit1000.dataset.reader import Dataset
from kit1000.editor.controller import Controller
from kit1000.editor.records import EventLog
from kit1000.editor.serve import NO_SNAP, Options, editing, serving
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.planner.execute import SEATED, PartRun, robot_at
from kit1000.pose import Pose
from kit1000.study.pages import TaskPanel, ask_consent, ask_preference, ask_ratings, say_goodbye
from kit1000.study.plan import Session
from kit1000.study.questionnaire import CONSENT_VERSION
from kit1000.study.records import (
    CLOSING_FILE,
    PARTICIPANT_FILE,
    PRACTICE_FILE,
    RATINGS_FILE,
    TRIAL_FILE,
    Closing,
    Consent,
    ParticipantFiles,
    Participation,
    PartResult,
    RatingsRecord,
    Record,
    TrialRecord,
)
from kit1000.study.tasks import part_truths
from kit1000.values import Truth
from kit1000.version import __version__

PRACTICE = 0
SECONDS_A_KIT = 60.0  # the paper's rule: in a task of n kits an upload may start within n minutes
FINISH, UPLOAD = "finish", "upload"
NOT_UPLOADED = "not uploaded"
TICK_S = 1.0  # [s] between two looks at the clock
DECIMALS = 3  # of mm, degrees and seconds in records
Execute = Callable[[Mapping[int, Pose]], Sequence[PartRun]]
"""Executes the motions, goal_from_now, of parts that it has not moved before."""


def time_limit(kits: int) -> float:
    """[s] until which an upload may start."""
    return SECONDS_A_KIT * kits


@dataclass
class TaskClock:
    """Specification and execution seconds of one task.

    It runs from the moment the scene is shown while the participant specifies, and advances by the robot's own seconds
    when an upload is executed; an upload that started in time runs to its end.
    """

    kits: int
    now: Callable[[], float]  # [s] of a clock that never goes back
    specification: float = 0.0  # [s] until it was last stopped
    execution: float = 0.0  # [s] of the robot
    _since: float | None = field(default=None, init=False)

    def start(self) -> None:
        """The participant is in charge from now on."""
        if self._since is None:
            self._since = self.now()

    def stop(self) -> None:
        """The participant is no longer in charge: the robot works, or the page is closed."""
        self.specification, self._since = self.specified, None

    @property
    def specified(self) -> float:
        """[s] for which the participant has been in charge."""
        return self.specification + (0.0 if self._since is None else self.now() - self._since)

    @property
    def reading(self) -> float:
        """[s]"""
        return self.specified + self.execution

    @property
    def left(self) -> float:
        """[s] in which an upload may still start; 0 if none may."""
        return max(time_limit(self.kits) - self.reading, 0.0)

    def may_upload(self) -> bool:
        """Whether an upload may start now."""
        return self.reading < time_limit(self.kits)

    def executed(self, seconds: float) -> None:
        """Add the seconds of the robot for an upload."""
        self.execution += seconds


@dataclass(frozen=True)
class Sitting:
    """One participant, the dataset, and the address of the pages."""

    files: ParticipantFiles
    dataset: Dataset
    port: int | None = None  # None for a free one

    def run(self) -> None:
        """Serve the pages one after another, until the end or Ctrl-C."""
        files = self.files
        sessions = files.plan.sessions(files.number)
        with serving(self.port) as (_, address):
            port = int(address.rpartition(":")[2])
        print(f"{address}  participant {files.number} (Ctrl-C ends; the same command continues)", flush=True)
        pages = Sitting(files, self.dataset, port)
        pages.consent()
        for session in sessions:
            pages.condition(session)
        pages.close()

    def consent(self) -> None:
        """Ask for consent once."""
        path = self.files.folder / PARTICIPANT_FILE
        if path.is_file():
            self.files.read(path, Participation)
            return
        with serving(self.port) as (server, _):
            ask_consent(server)
        consent = Consent(CONSENT_VERSION, round(time.time(), DECIMALS))
        versions = {"kit1000": __version__, "python": platform.python_version(), "machine": platform.machine()}
        self.files.write(path, self.files.record(Participation, consent=consent, versions=versions))

    def condition(self, session: Session) -> None:
        """Practice, tasks and ratings of a condition, as far as they are not done."""
        files, folder = self.files, self.files.of_session(session)
        if not (folder / PRACTICE_FILE).is_file():
            TaskPage(self, session, PRACTICE).run()
            files.write(folder / PRACTICE_FILE, files.record(Record))
        for task in range(1, len(session.tasks) + 1):
            path = files.of_task(session, task) / TRIAL_FILE
            if not path.is_file():
                files.write(path, TaskPage(self, session, task).run())
        if not (folder / RATINGS_FILE).is_file():
            with serving(self.port) as (server, _):
                ratings = ask_ratings(server, session.condition.label)
            files.write(folder / RATINGS_FILE, files.record(RatingsRecord, ratings=ratings))

    def close(self) -> None:
        """Ask the last question once, and say goodbye."""
        path = self.files.folder / CLOSING_FILE
        with serving(self.port) as (server, _):
            if not path.is_file():
                preferred = ask_preference(server, self.files.plan.conditions)
                self.files.write(path, self.files.record(Closing, preferred=preferred))
            say_goodbye(server)
        print(f"{path.parent}: complete")


@dataclass
class TaskPage:
    """One task at the page."""

    sitting: Sitting
    session: Session
    index: int  # from 1; 0 to practise
    requests: queue.Queue[str] = field(default_factory=queue.Queue)
    motions: dict[int, Pose] = field(default_factory=dict)
    outcomes: dict[int, str] = field(default_factory=dict)
    uploads: int = 0
    counts: dict[str, int] = field(default_factory=lambda: {"undo": 0, "refuse": 0})

    def __post_init__(self) -> None:
        self.plan = self.sitting.files.plan
        self.task = self.session.tasks[self.index - 1] if self.index else self.plan.tasks.practice
        self.clock = TaskClock(self.task.kits, time.monotonic)

    def run(self) -> TrialRecord:
        """Serve the page until the task is done."""
        plan, dataset, condition = self.plan, self.sitting.dataset, self.session.condition
        scene = dataset.recorded_scene(self.task.scene, truth=True)
        truths = part_truths(scene, plan.sensor)
        options = Options(
            dataset.root,
            self.task.scene,
            self.sitting.files.of_task(self.session, self.index),
            plan.sensor,
            plan.snap if condition.snaps else NO_SNAP,
            self.sitting.port,
            interface=condition.interface,
        )
        earlier = EventLog(options.out, options.header(dataset.id)).rows
        with robot_at(scene, plan.sensor, plan.seed) as robot, editing(options, self.seen) as (controller, _):
            execute: Execute = lambda motions: robot.run(motions).parts  # noqa: E731
            self.resume(earlier, execute)
            one = condition.one_part_an_upload
            panel = TaskPanel(controller.stage.server, self._title(), one, self.requests.put)
            self._work(controller, execute, panel, len(truths))
        return self.record(measured(dataset, truths, self.motions, self.outcomes), earlier)

    def _work(self, controller: Controller, execute: Execute, panel: TaskPanel, parts: int) -> None:
        panel.wait_for_somebody()
        self.clock.start()
        try:
            for request in self._requests(panel):
                if request == FINISH or (self.index and not self.clock.may_upload()):
                    return
                if request == UPLOAD:
                    self.upload(controller, execute, panel)
                if len(self.motions) == parts or (not self.index and SEATED in self.outcomes.values()):
                    return
        finally:
            self.clock.stop()
            controller.log.add("clock", **self._reading())

    def _requests(self, panel: TaskPanel) -> Iterator[str]:
        """The requests of the participant, and an empty text at each tick."""
        while True:
            panel.show(self.clock.left if self.index else None, self.outcomes)
            request = ""
            with contextlib.suppress(queue.Empty):
                request = self.requests.get(timeout=TICK_S)
            yield request

    def upload(self, controller: Controller, execute: Execute, panel: TaskPanel) -> None:
        """Let the robot execute the confirmed parts that it has not moved yet; the clock of the participant stops."""
        with controller.lock:
            edits = controller.space.session.edits
            parts = [
                part for part in controller.space.scene.parts if edits[part].confirmed and part not in self.motions
            ]
            motions = {part: edits[part].goal_from_now for part in parts}
            controller.held = bool(motions)  # nothing can be moved while the clock stands still
        if not motions:
            panel.note("Nothing to upload: confirm a part first.")
            return
        self.clock.stop()
        rows = {str(part): pose_row(motion) for part, motion in motions.items()}
        controller.log.add("upload", motions=rows, **self._reading())
        panel.note("The robot is at work …")
        self._execute(execute, motions)
        controller.log.add("executed", outcomes={str(i): self.outcomes[i] for i in motions}, **self._reading())
        panel.note("")
        controller.held = False
        self.clock.start()

    def _execute(self, execute: Execute, motions: dict[int, Pose]) -> None:
        runs = execute(motions)
        self.clock.executed(sum(run.seconds for run in runs))
        self.motions |= motions
        self.outcomes |= {run.part: run.outcome for run in runs}
        self.uploads += 1

    def resume(self, rows: Sequence[Mapping[str, Any]], execute: Execute) -> None:
        """Continue an interrupted sitting: uploads are executed again, and the clock continues."""
        for row in rows:
            self._count(row["event"])
            if row["event"] == "upload":
                self._execute(execute, {int(part): pose_of(motion) for part, motion in row["motions"].items()})
            if "specification_s" in row:
                self.clock.specification = float(row["specification_s"])

    def seen(self, row: Mapping[str, Any]) -> None:
        """An event of the page. In hand control a confirmed part is an upload by itself."""
        self._count(row["event"])
        carried = row["event"] == "do" and any(edit.get("confirmed") for edit in row["edits"].values())
        if carried and self.session.condition.one_part_an_upload:
            self.requests.put(UPLOAD)

    def _count(self, event: str) -> None:
        if event in self.counts:
            self.counts[event] += 1

    def _reading(self) -> dict[str, float]:
        return {
            "specification_s": round(self.clock.specified, DECIMALS),
            "execution_s": round(self.clock.execution, DECIMALS),
        }

    def _title(self) -> str:
        what = f"Task {self.index} of {len(self.session.tasks)}" if self.index else "Practice: seat one part"
        return f"{what} · {self.session.condition.label}"

    def record(self, parts: Mapping[int, PartResult], earlier: Sequence[Mapping[str, Any]]) -> TrialRecord:
        """The record of the task. parts: their results. earlier: events of interrupted sittings."""
        return self.sitting.files.record(
            TrialRecord,
            condition=self.session.condition.name,
            position=self.session.position,
            task=max(self.index, 1),
            scene=self.task.scene,
            kits=self.task.kits,
            task_set=self.session.task_set,
            parts=tuple(parts.values()),
            uploads=self.uploads,
            undos=self.counts["undo"],
            refused=self.counts["refuse"],
            interruptions=sum(row["event"] == "open" for row in earlier),
            out_of_time=len(self.motions) < len(parts) and not self.clock.may_upload(),
            **self._reading(),
        )


def measured(
    dataset: Dataset, truths: Mapping[int, Truth], motions: Mapping[int, Pose], outcomes: Mapping[int, str]
) -> dict[int, PartResult]:
    """The errors of motions by part; a part without a motion was not uploaded."""
    parts = sorted(motions)
    found = {part: PartResult(part, NOT_UPLOADED, False, None, None) for part in sorted(truths)}
    if not parts:
        return found
    stacked, own = Pose.stack([motions[part] for part in parts]), [truths[part] for part in parts]
    errors = pose_errors(stacked, Targets.of(own, lambda part_id: dataset.geometry.part(part_id).mesh.vertices))
    seated = seatings(stacked, own, dataset.geometry).seated
    for i, part in enumerate(parts):
        position, angle = 1e3 * float(errors.position[i]), float(np.degrees(errors.rotation[i]))
        rounded = round(position, DECIMALS), round(angle, DECIMALS)
        found[part] = PartResult(part, outcomes[part], bool(seated[i]), *rounded)
    return found
