"""Reading a study back: every finished trial and answer of one kind of operator, each checked against the plan."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

from kit1000.errors import InputError
from kit1000.study.execution import JUDGES
from kit1000.study.study_plan import Session, StudyPlan
from kit1000.study.study_records import (
    CLOSING_FILE,
    HUMAN,
    PARTICIPANT_FILE,
    PERSON,
    RATINGS_FILE,
    SIMULATED,
    SIMULATED_FOLDER,
    TRIAL_FILE,
    Operator,
    Participant,
    TrialRecord,
    read_ratings,
    read_record,
    read_trial,
)

FOLDER = re.compile(r"p(\d{3,})")
CONDITION_FOLDER = re.compile(r"(\d+)-([a-z-]+)")
TASK_FOLDER = re.compile(r"task-(\d+)")


def operators_of(study: Path) -> list[Operator]:
    """Whose records a study has: people first, then the models."""
    found = [PERSON] if _participants(study, PERSON) else []
    models = sorted(path.name for path in (study / SIMULATED_FOLDER).glob("*") if path.is_dir())
    return found + [model for name in models if _participants(study, model := Operator(SIMULATED, name))]


def chosen_operator(study: Path, simulated: str | None) -> Operator:
    """Whose records a report is about: those asked for, or the only ones there are. Never two kinds at once."""
    found = operators_of(study)
    if simulated is not None:
        found = [operator for operator in found if operator == Operator(SIMULATED, simulated)]
    if not found:
        what = "records" if simulated is None else f"records of the simulated operator {simulated}"
        raise InputError(f"{study}: no {what}; let people sit in (--participant 1) or simulate (--simulate fitts)")
    if len(found) > 1 and found[0] != PERSON:
        names = ", ".join(operator.name for operator in found)
        raise InputError(f"{study}: holds several simulated operators ({names}); name one: --report --simulate NAME")
    return found[0]


def read_participants(study: Path, plan: StudyPlan, operator: Operator) -> list[Participant]:
    """All participants of one kind, by number; raises InputError for the first record that does not belong."""
    found = []
    for path, number in _participants(study, operator):
        if not 1 <= number <= plan.people:
            raise InputError(f"{path}: the plan has participants 1 to {plan.people}; move the folder away")
        found.append(_read_participant(path, plan, operator, number))
    return found


def _participants(study: Path, operator: Operator) -> list[tuple[Path, int]]:
    """Folders of participants with their numbers."""
    folders = sorted(path for path in operator.folder(study).glob("*") if path.is_dir())
    numbered = [(path, FOLDER.fullmatch(path.name)) for path in folders]
    for path, match in numbered:
        if match is None:
            raise InputError(f"{path}: no folder of a participant, such as p001; move it away")
    found = [(path, int(match[1])) for path, match in numbered if match]
    for one, other in pairwise(found):
        if one[1] == other[1]:
            raise InputError(f"{other[0]}: participant {one[1]} is there twice ({one[0].name}); move one away")
    return [each for each in found if (each[0] / PARTICIPANT_FILE).is_file() or any(each[0].rglob(TRIAL_FILE))]


def _read_participant(path: Path, plan: StudyPlan, operator: Operator, number: int) -> Participant:
    participant_file = path / PARTICIPANT_FILE
    row = read_record(participant_file, plan.id, operator, number)
    if operator.kind == HUMAN and not isinstance(row.get("consent"), dict):
        raise InputError(f"{participant_file}: no consent; the records of this participant must not be used")
    if row.get("judge") not in JUDGES:
        raise InputError(f"{participant_file}: judge: expected {' or '.join(JUDGES)}, got {row.get('judge')!r}")
    sessions = {(each.position, each.condition.name): each for each in plan.sessions(number)}
    trials, ratings = [], {}
    for folder in sorted(each for each in path.iterdir() if each.is_dir()):
        match = CONDITION_FOLDER.fullmatch(folder.name)
        session = sessions.get((int(match[1]), match[2])) if match else None
        if session is None:
            raise InputError(f"{folder}: the plan has no such condition for participant {number}; move the folder away")
        trials += _read_trials(folder, plan, operator, number, session)
        if (folder / RATINGS_FILE).is_file():
            ratings[session.condition.name] = read_ratings(folder / RATINGS_FILE, plan.id, operator, number)
    closing, preferred = path / CLOSING_FILE, None
    if closing.is_file():
        preferred = read_record(closing, plan.id, operator, number).get("preferred")
        if preferred is not None and preferred not in plan.conditions:
            raise InputError(f"{closing}: preferred: expected one of {', '.join(plan.conditions)}, got {preferred!r}")
    return Participant(number, operator, row["judge"], tuple(trials), ratings, preferred)


def _read_trials(folder: Path, plan: StudyPlan, operator: Operator, number: int, session: Session) -> list[TrialRecord]:
    found = []
    for path in sorted(folder.glob(f"*/{TRIAL_FILE}")):
        match = TASK_FOLDER.fullmatch(path.parent.name)
        trial = read_trial(path, plan.id, operator, number)
        index = int(match[1]) if match else 0
        if not 1 <= index <= len(session.tasks):
            raise InputError(f"{path}: expected task-1 to task-{len(session.tasks)}; move the folder away")
        task = session.tasks[index - 1]
        planned = (session.position, session.condition.name, session.task_set, index, task.scene, task.kits)
        written = (trial.position, trial.condition, trial.task_set, trial.task, trial.scene, trial.kits)
        if written != planned:
            raise InputError(f"{path}: is about {written}, where the plan has {planned}; is the file a copy?")
        if [part.part for part in trial.parts] != list(range(task.kits)):
            raise InputError(f"{path}: parts: expected one result for each of the {task.kits} parts, in order")
        found.append(trial)
    return found
