"""Studies without people: plans of scenes that need not exist, and records with known effects."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kit1000.study.plan import Session, StudyPlan, write_plan
from kit1000.study.questionnaire import NAMES
from kit1000.study.records import (
    CLOSING_FILE,
    PARTICIPANT_FILE,
    RATINGS_FILE,
    TRIAL_FILE,
    Closing,
    Consent,
    ParticipantFiles,
    Participation,
    PartResult,
    Ratings,
    RatingsRecord,
    TrialRecord,
)
from kit1000.study.tasks import SIZES, Task, Tasks


def plan_of(people: int = 4, conditions: tuple[str, ...] = ("scene-snap", "hand"), seed: int = 0) -> StudyPlan:
    """A plan whose scenes do not exist."""
    names = iter(range(1000))
    sets = tuple(tuple(Task(f"test-s{next(names):04d}", kits) for kits in SIZES) for _ in conditions)
    return StudyPlan("0123456789abcdef", "ideal", "a:b", conditions, people, seed, Tasks(Task("test-s0999", 2), sets))


def trial_of(files: ParticipantFiles, session: Session, task: int, seated: int, seconds: float) -> TrialRecord:
    """A trial in which the first `seated` parts are seated."""
    planned = session.tasks[task - 1]
    outcomes = ["seated"] * seated + ["jammed"] * (planned.kits - seated)
    return files.record(
        TrialRecord,
        condition=session.condition.name,
        position=session.position,
        task=task,
        scene=planned.scene,
        kits=planned.kits,
        task_set=session.task_set,
        parts=tuple(PartResult(i, outcome, outcome == "seated", 1.5, 2.5) for i, outcome in enumerate(outcomes)),
        specification_s=seconds,
        execution_s=23.0 * planned.kits,
        uploads=1,
    )


def write_study(study: Path, plan: StudyPlan, effect: float = 20.0, seed: int = 0) -> StudyPlan:
    """Records of everybody: the second condition takes `effect` seconds per task more, and seats one part less."""
    write_plan(study, plan)
    for number in range(1, plan.people + 1):
        write_participant(ParticipantFiles(study, plan, number), effect, seed)
    return plan


def write_participant(files: ParticipantFiles, effect: float = 20.0, seed: int = 0) -> None:
    """Records of one participant."""
    rng, plan = np.random.default_rng((seed, files.number)), files.plan
    consent = Consent("x", 1.0)
    files.write(files.folder / PARTICIPANT_FILE, files.record(Participation, versions={}, consent=consent))
    for session in plan.sessions(files.number):
        second = session.condition.name != plan.conditions[0]
        for task in range(1, len(SIZES) + 1):
            seated = max(SIZES[task - 1] - second - int(rng.integers(2)), 0)
            seconds = round(40 + effect * second + 6 * float(rng.standard_normal()), 3)
            files.write(files.of_task(session, task) / TRIAL_FILE, trial_of(files, session, task, seated, seconds))
        ratings = Ratings(*(int(5 * rng.integers(4, 10) + 20 * second) for _ in NAMES))
        files.write(files.of_session(session) / RATINGS_FILE, files.record(RatingsRecord, ratings=ratings))
    files.write(files.folder / CLOSING_FILE, files.record(Closing, preferred=plan.conditions[0]))
