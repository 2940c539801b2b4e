"""Studies without people: plans of scenes that need not exist, and records with effects that were put in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.study.questionnaire import NAMES
from kit1000.study.study_plan import Session, StudyPlan, write_plan
from kit1000.study.study_records import (
    CLOSING_FILE,
    PARTICIPANT_FILE,
    PERSON,
    RATINGS_FILE,
    Operator,
    PartResult,
    TrialRecord,
    condition_folder,
    participant_folder,
    trial_folder,
    write_record,
    write_trial,
)
from kit1000.study.tasks import SIZES, Task, Tasks

FITTS = Operator("simulated", "fitts")
Seconds = Callable[[int, Session, int], float]


def plan_of(people: int = 4, conditions: tuple[str, ...] = ("scene-snap", "hand"), seed: int = 0) -> StudyPlan:
    """A plan whose scenes are made up."""
    names = iter(range(1000))
    sets = tuple(tuple(Task(f"test-s{next(names):04d}", kits) for kits in SIZES) for _ in conditions)
    return StudyPlan("0123456789abcdef", "ideal", "a:b", conditions, people, seed, Tasks(Task("test-s0999", 2), sets))


def trial_of(
    plan: StudyPlan, operator: Operator, number: int, session: Session, task: int, seated: int, seconds: float
) -> TrialRecord:
    """A trial in which the first `seated` parts are seated."""
    asked = session.tasks[task - 1]
    outcomes = ["seated"] * seated + ["jammed"] * (asked.kits - seated)
    parts = tuple(PartResult(i, outcome, outcome == "seated", 1.5, 2.5) for i, outcome in enumerate(outcomes))
    return TrialRecord(
        study=plan.id,
        participant=number,
        operator=operator,
        condition=session.condition.name,
        position=session.position,
        task=task,
        scene=asked.scene,
        kits=asked.kits,
        task_set=session.task_set,
        parts=parts,
        specification_s=seconds,
        execution_s=23.0 * asked.kits,
        uploads=1,
    )


def write_study(
    study: Path, plan: StudyPlan, operator: Operator = PERSON, effect: float = 20.0, seed: int = 0
) -> StudyPlan:
    """Records of everybody: the second condition takes `effect` seconds a task more, and seats one part less."""
    write_plan(study, plan)
    for number in range(1, plan.people + 1):
        write_participant(study, plan, operator, number, effect, seed)
    return plan


def write_participant(
    study: Path, plan: StudyPlan, operator: Operator, number: int, effect: float = 20.0, seed: int = 0
) -> None:
    """Records of one participant."""
    rng = np.random.default_rng((seed, number))
    consent: dict[str, Any] = {"consent": {"version": "x", "time": 1.0}} if operator == PERSON else {}
    write_record(
        participant_folder(study, operator, number) / PARTICIPANT_FILE,
        plan.id,
        number,
        operator,
        judge="robot",
        **consent,
    )
    for session in plan.sessions(number):
        second = session.condition.name != plan.conditions[0]
        for task in range(1, len(SIZES) + 1):
            seated = max(SIZES[task - 1] - second - int(rng.integers(2)), 0)
            seconds = round(40 + effect * second + 6 * float(rng.standard_normal()), 3)
            trial = trial_of(plan, operator, number, session, task, seated, seconds)
            write_trial(trial_folder(study, operator, number, session.position, session.condition.name, task), trial)
        if operator == PERSON:
            ratings = {name: int(5 * rng.integers(4, 10) + 20 * second) for name in NAMES}
            folder = condition_folder(study, operator, number, session.position, session.condition.name)
            write_record(folder / RATINGS_FILE, plan.id, number, operator, ratings=ratings)
    if operator == PERSON:
        folder = participant_folder(study, operator, number)
        write_record(folder / CLOSING_FILE, plan.id, number, operator, preferred=plan.conditions[0])
