"""A study carried out by simulated operators: the same plan, clock, robot and records, without a page or a person.

What comes of it tests the machine: that plan, clock, records and statistics work, and how success depends on the error
of a hand. It says nothing about people, and ratings are never simulated. The same seed gives the same bytes.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from tqdm import tqdm

from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.editor.proposals import PartProposals, Proposal
from kit1000.editor.records import EventLog
from kit1000.editor.session import PartEdit
from kit1000.editor.session import Session as Edits
from kit1000.editor.worker import Job, Method, prepared, proposals_of
from kit1000.kits.seating import UP
from kit1000.metrics import seatings
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.study.clock import TaskClock
from kit1000.study.execution import DECIMALS, ROBOT, Judge, judging, measured
from kit1000.study.operators import SPREAD, Aim, Hand, operator_of
from kit1000.study.study_plan import Session, StudyPlan
from kit1000.study.study_records import (
    PARTICIPANT_FILE,
    SIMULATED,
    TRIAL_FILE,
    Operator,
    TrialRecord,
    check_judge,
    participant_folder,
    trial_folder,
    write_record,
    write_trial,
)
from kit1000.study.tasks import Task, part_truths, true_motion
from kit1000.study.trial_header import header_of
from kit1000.values import Truth
from kit1000.version import __version__

RATINGS_NOTE = "none: load is a matter of people"


@dataclass
class Time:
    """A clock that only goes when it is told to."""

    seconds: float = 0.0

    def __call__(self) -> float:
        return self.seconds

    def pass_by(self, seconds: float) -> None:
        """Let time pass."""
        self.seconds += seconds


def simulate(study: Path, plan: StudyPlan, dataset: Dataset, name: str, judge: str = ROBOT) -> Path:
    """Let a simulated operator sit in for every participant; returns the folder of its records.

    What is already there is kept: the same command continues after an interruption.
    """
    operator = Operator(SIMULATED, operator_of(name).name)
    numbers = range(1, plan.people + 1)
    jobs = [
        (number, each, i + 1) for number in numbers for each in plan.sessions(number) for i in range(len(each.tasks))
    ]
    for number in numbers:
        path = participant_folder(study, operator, number) / PARTICIPANT_FILE
        if path.is_file():
            check_judge(path, plan.id, operator, number, judge)
        else:
            values = {"kit1000": __version__, "judge": judge, "ratings": RATINGS_NOTE}
            write_record(path, plan.id, number, operator, **values)
    for number, session, task in tqdm(jobs, desc=f"simulated {name}", unit=" tasks", disable=None):
        folder = trial_folder(study, operator, number, session.position, session.condition.name, task)
        if not (folder / TRIAL_FILE).is_file():
            shutil.rmtree(folder, ignore_errors=True)  # of an interrupted run
            write_trial(folder, _Trial(plan, dataset, operator, number, session, task, folder, judge).run())
    return operator.folder(study)


class _Trial:
    """One task of one simulated participant."""

    def __init__(
        self,
        plan: StudyPlan,
        dataset: Dataset,
        operator: Operator,
        number: int,
        session: Session,
        index: int,
        folder: Path,
        judge: str,
    ) -> None:
        self.plan, self.dataset, self.operator, self.number = plan, dataset, operator, number
        self.session, self.index, self.judge_kind = session, index, judge
        self.task: Task = session.tasks[index - 1]
        self.scene: RecordedScene = dataset.recorded_scene(self.task.scene, truth=True)
        self.truths: dict[int, Truth] = part_truths(self.scene, plan.sensor)
        self.time = Time()
        header = header_of(plan, operator, number, session, index)
        self.log = EventLog(folder, header, clock=self.time)
        self.edits = Edits.begin(tuple(self.truths))
        self.clock = TaskClock(self.task.kits, self.time)
        rng = stream(plan.seed, "operator", operator.name, number, session.condition.name, self.task.scene)
        self.hand = Hand(operator_of(operator.name), session.condition, _pace(plan, number, operator.name), rng)
        self.tally = _Tally()

    def run(self) -> TrialRecord:
        """Work until every part is uploaded or the time is over."""
        self.log.add("open")
        self.clock.start()
        with judging(self.judge_kind, self.scene, self.plan.sensor, self.plan.seed) as judge:
            if self.session.condition.one_part_an_upload:
                for part in self.truths:
                    self._specify(part)
                    self._upload(judge, [part])
            else:
                self._upload(judge, list(self._in_time()))
        self.log.add("close")
        return self._record()

    def _in_time(self) -> Iterator[int]:
        """Specify parts while there is time: one who sees that the next would come too late uploads what is there."""
        longest = 0.0
        for part in self.truths:
            if self.clock.left <= longest + self.hand.upload_seconds():
                return
            before = self.time()
            self._specify(part)
            longest = max(longest, self.time() - before)
            yield part

    def _specify(self, part: int) -> None:
        truth, pivot = self.truths[part], self._pivot(part)
        put = self.hand.put(self._aim(part))
        self.time.pass_by(put.seconds)
        edit = PartEdit(put.motion, turned=True)
        self._do("put", part, edit)
        if self.session.condition.snaps:
            edit = self._snapped(part, truth, pivot, edit)
        self._do("confirm", part, PartEdit(edit.goal_from_now, edit.snapped, edit.confidence, edit.turned, True))

    def _snapped(self, part: int, truth: Truth, pivot: np.ndarray, edit: PartEdit) -> PartEdit:
        """The proposal that the operator takes; its own placement where it takes none."""
        for fit in self._proposals(part, pivot, edit):
            self.time.pass_by(self.hand.look_seconds())
            right = bool(seatings(Pose.stack([fit.goal_from_now]), [truth], self.dataset.geometry).seated[0])
            if self.hand.accepts(right):
                edit = edit.taken(fit.goal_from_now, round(fit.confidence, 6))
                self._do("snap", part, edit)
                return edit
            self.tally.refused += 1
            self.log.add("refuse", part=part, confidence=round(fit.confidence, 6))
        return edit

    def _proposals(self, part: int, pivot: np.ndarray, edit: PartEdit) -> list[Proposal]:
        """The fits that the page would show, in its order."""
        made = prepared(Method(self.plan.snap, self.dataset.root, self.task.scene, self.plan.sensor, False))
        found = PartProposals(pivot)
        found.answers, found.guess = proposals_of(made, Job(part, edit.goal_from_now)), edit.goal_from_now
        return found.near(edit)

    def _upload(self, judge: Judge, parts: list[int]) -> None:
        if not parts or not self.clock.may_upload():
            return
        self.time.pass_by(self.hand.upload_seconds())
        if not self.clock.may_upload():
            return
        motions = {part: self.edits.edits[part].goal_from_now for part in parts}
        self.log.add("upload", parts=parts)
        self.clock.stop()
        carried = judge.carry_out(motions)
        self.clock.executed(sum(each.seconds for each in carried.values()))
        self.tally.motions |= motions
        self.tally.outcomes |= {part: each.outcome for part, each in carried.items()}
        self.tally.uploads += 1
        self.log.add("executed", outcomes={str(part): each.outcome for part, each in sorted(carried.items())})
        self.clock.start()

    def _do(self, name: str, part: int, edit: PartEdit) -> None:
        self.edits = self.edits.did(name, {part: edit})
        self.log.did(self.edits)

    def _aim(self, part: int) -> Aim:
        truth = self.truths[part]
        normal = truth.world_from_kit.rotate(UP)
        others = [true_motion(other).apply(self._pivot(i)) for i, other in self.truths.items() if i != part]
        return Aim(true_motion(truth), self._pivot(part), normal, others)

    def _pivot(self, part: int) -> np.ndarray:
        suffix = "" if self.plan.sensor == "ideal" else f"-{self.plan.sensor}"
        return next(
            query.pivot for query in self.scene.queries if query.part == part and query.track == f"snap{suffix}"
        )

    def _record(self) -> TrialRecord:
        parts = measured(self.dataset, self.truths, self.tally.motions, self.tally.outcomes)
        return TrialRecord(
            study=self.plan.id,
            participant=self.number,
            operator=self.operator,
            condition=self.session.condition.name,
            position=self.session.position,
            task=self.index,
            scene=self.task.scene,
            kits=self.task.kits,
            task_set=self.session.task_set,
            parts=tuple(parts.values()),
            specification_s=round(self.clock.specified, DECIMALS),
            execution_s=round(self.clock.execution, DECIMALS),
            uploads=self.tally.uploads,
            refused=self.tally.refused,
            out_of_time=len(self.tally.motions) < len(parts),
        )


@dataclass
class _Tally:
    motions: dict[int, Pose] = field(default_factory=dict)
    outcomes: dict[int, str] = field(default_factory=dict)
    uploads: int = 0
    refused: int = 0


def _pace(plan: StudyPlan, number: int, name: str) -> float:
    """Factor on all times of a person: the same in all conditions; 1 for the operators without scatter."""
    if not operator_of(name).scatters:
        return 1.0
    return float(np.exp(SPREAD * stream(plan.seed, "operator-pace", number).standard_normal()))
