"""A rehearsal of a study by simulated operators: the same plan, clock and records, without a page, robot or person.

It checks that plan, clock, records and statistics work together, and says nothing about people. Two operators:

- `exact` puts every part at its true goal.
- `paper` errs like a guess of the benchmark, by up to 28 mm along each axis and 27.5°; it takes the first proposal.

Both need the times of the paper for a part, times a factor that differs between participants. The seating test
executes the uploads. The same seed gives the same bytes.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from kit1000.dataset.reader import Dataset
from kit1000.editor.proposals import PartProposals
from kit1000.editor.session import PartEdit
from kit1000.editor.worker import Job, Method, prepared, proposals_of
from kit1000.errors import InputError, did_you_mean
from kit1000.pose import Pose
from kit1000.queries.guesses import draw_ball_error
from kit1000.queries.motions import apply_error
from kit1000.rng import stream
from kit1000.study.clock import TaskClock
from kit1000.study.execution import DECIMALS, by_seating_test, measured
from kit1000.study.plan import Session, StudyPlan
from kit1000.study.records import (
    PARTICIPANT_FILE,
    SIMULATED,
    TRIAL_FILE,
    ParticipantFiles,
    Participation,
    TrialRecord,
)
from kit1000.study.tasks import part_truths, true_motion
from kit1000.values import Query, Truth
from kit1000.version import __version__

EXACT, PAPER = "exact", "paper"
OPERATORS = (EXACT, PAPER)
SECONDS = {"scene": 20.0, "hand": 31.0, "hand-bare": 31.0}  # [s] for a part in a draft of the paper, by interface
UPLOAD_S = 3.0  # [s] to press the button that uploads: assumed
SPREAD = 0.15  # standard deviation of the logarithm of a participant's factor on all times: assumed


def check_operator(name: str) -> None:
    """Raise InputError for an unknown operator."""
    if name not in OPERATORS:
        raise InputError(f"--simulate {name}: {did_you_mean(name, OPERATORS)}there are {', '.join(OPERATORS)}")


def simulate(study: Path, plan: StudyPlan, dataset: Dataset, name: str) -> Path:
    """Let a simulated operator take the place of every participant; returns the folder of its records.

    Existing records stay: the same call continues after an interruption.
    """
    check_operator(name)
    operator = f"{SIMULATED}/{name}"
    for number in tqdm(range(1, plan.people + 1), desc=operator, unit=" participants", disable=None):
        files = ParticipantFiles(study, plan, number, operator)
        for session in plan.sessions(number):
            for task in range(1, len(session.tasks) + 1):
                folder = files.of_task(session, task)
                if not (folder / TRIAL_FILE).is_file():
                    shutil.rmtree(folder, ignore_errors=True)  # left by an interrupted run
                    files.write(folder / TRIAL_FILE, _Trial(files, dataset, session, task, name).record())
        if not (files.folder / PARTICIPANT_FILE).is_file():
            files.write(files.folder / PARTICIPANT_FILE, files.record(Participation, versions={"kit1000": __version__}))
    return study / operator


@dataclass
class _Trial:
    """One task of one simulated participant."""

    files: ParticipantFiles
    dataset: Dataset
    session: Session
    index: int
    """From 1, within the condition."""
    name: str

    def __post_init__(self) -> None:
        plan, number = self.files.plan, self.files.number
        self.task, self.condition = self.session.tasks[self.index - 1], self.session.condition
        scene = self.dataset.recorded_scene(self.task.scene, truth=True)
        self.truths: Mapping[int, Truth] = part_truths(scene, plan.sensor)
        track = "snap" if plan.sensor == "ideal" else f"snap-{plan.sensor}"
        self.queries: Mapping[int, Query] = {query.part: query for query in scene.queries if query.track == track}
        self.factor = float(np.exp(SPREAD * stream(plan.seed, "operator-pace", number).standard_normal()))
        self.rng = stream(plan.seed, "operator", self.name, number, self.condition.name, self.task.scene)
        self.seconds = 0.0
        self.clock = TaskClock(self.task.kits, lambda: self.seconds)

    def record(self) -> TrialRecord:
        """Work until every part is uploaded or the time is over."""
        self.clock.start()
        outcomes: dict[int, str] = {}
        motions: dict[int, Pose] = {}
        uploads, waiting = 0, dict[int, Pose]()
        part_s, upload_s = self.factor * SECONDS[self.condition.interface], self.factor * UPLOAD_S
        for part in self.truths:
            if self.clock.left > part_s + upload_s:
                self.seconds += part_s
                waiting[part] = self._motion(part)
            last = part == max(self.truths)
            if waiting and (last or self.condition.one_part_an_upload):
                self.seconds += upload_s
                self.clock.stop()
                executed = by_seating_test(self.dataset, self.truths)(waiting)
                self.clock.executed(sum(each.seconds for each in executed.values()))
                self.clock.start()
                outcomes |= {i: each.outcome for i, each in executed.items()}
                motions, uploads, waiting = motions | waiting, uploads + 1, {}
        parts = measured(self.dataset, self.truths, motions, outcomes)
        return self.files.record(
            TrialRecord,
            condition=self.condition.name,
            position=self.session.position,
            task=self.index,
            scene=self.task.scene,
            kits=self.task.kits,
            task_set=self.session.task_set,
            parts=tuple(parts.values()),
            specification_s=round(self.clock.specified, DECIMALS),
            execution_s=round(self.clock.execution, DECIMALS),
            uploads=uploads,
            out_of_time=len(motions) < len(parts),
        )

    def _motion(self, part: int) -> Pose:
        """Where the operator puts a part; a condition that snaps then takes the first proposal."""
        motion, pivot, plan = true_motion(self.truths[part]), self.queries[part].pivot, self.files.plan
        if self.name == PAPER:
            motion = apply_error(motion, pivot, *draw_ball_error(self.rng))
        if not self.condition.snaps:
            return motion
        made = prepared(Method(plan.snap, self.dataset.root, self.task.scene, plan.sensor, False))
        found = PartProposals(pivot, answers=proposals_of(made, Job(part, motion)), guess=motion)
        fits = found.near(PartEdit(motion, turned=True))
        return fits[0].goal_from_now if fits else motion
