"""The records of a study as files: who took part, what each trial came to, what was answered.

    STUDY/plan.json
    STUDY/people/p001/participant.json          consent, versions
                      1-hand/task-1/events.jsonl, predictions.csv, trial.json
                      1-hand/ratings.json       six ratings after a condition
                      closing.json              the condition that was preferred
    STUDY/simulated/fitts/p001/...              the same, without anything that only a person can say

Each file says which operator made it, and lies where such records belong: a simulated one can never pass for a
person's. The record of a trial is written last, so that a sitting goes on where it was broken off.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from kit1000.errors import InputError, did_you_mean
from kit1000.files import write_json
from kit1000.planner.execute import SEATED
from kit1000.study.questionnaire import checked_ratings

HUMAN, SIMULATED = "human", "simulated"
PEOPLE_FOLDER, SIMULATED_FOLDER = "people", "simulated"
PARTICIPANT_FILE, TRIAL_FILE, RATINGS_FILE, CLOSING_FILE = (
    "participant.json",
    "trial.json",
    "ratings.json",
    "closing.json",
)
FORMAT = "kit1000-study-record/1"


@dataclass(frozen=True)
class Operator:
    """Who did something: a person, or a model of one."""

    kind: str
    """human or simulated"""
    name: str
    """human, or the name of the model."""

    def __post_init__(self) -> None:
        if self.kind not in (HUMAN, SIMULATED) or (self.kind == HUMAN) != (self.name == HUMAN):
            raise InputError(f"operator: expected human, or simulated with a model's name, got {self.kind} {self.name}")

    def folder(self, study: Path) -> Path:
        """Where the records of such operators lie."""
        return study / PEOPLE_FOLDER if self.kind == HUMAN else study / SIMULATED_FOLDER / self.name


PERSON = Operator(HUMAN, HUMAN)


@dataclass(frozen=True)
class PartResult:
    """What became of one part."""

    part: int
    outcome: str
    """One of the robot's outcomes, or `not uploaded`."""
    seated_by_test: bool
    """Whether the uploaded motion passes the seating test of the benchmark."""
    position_mm: float | None
    """Position error of the uploaded motion to the nearest goal; None without one."""
    angle_deg: float | None


@dataclass(frozen=True)
class TrialRecord:
    """One task of one participant."""

    study: str
    """Id of the plan."""
    participant: int
    operator: Operator
    condition: str
    position: int
    """Place of the condition among those of the participant, from 1."""
    task: int
    """From 1, within the condition."""
    scene: str
    kits: int
    task_set: int
    parts: tuple[PartResult, ...]
    specification_s: float
    """[s] that the person was in charge."""
    execution_s: float
    """[s] of the robot."""
    uploads: int = 0
    undos: int = 0
    refused: int = 0
    """Proposals that were passed over."""
    interruptions: int = 0
    """Times the sitting was broken off within this task."""
    out_of_time: bool = False
    """Whether the clock kept a part from being uploaded."""

    @property
    def seated(self) -> int:
        """Parts that the robot has seated."""
        return sum(part.outcome == SEATED for part in self.parts)


@dataclass(frozen=True)
class Participant:
    """Everything that one participant has left."""

    number: int
    operator: Operator
    judge: str
    """Who said what became of the parts: robot, or test."""
    trials: tuple[TrialRecord, ...]
    ratings: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Six ratings by condition."""
    preferred: str | None = None


def participant_folder(study: Path, operator: Operator, number: int) -> Path:
    """The folder of a participant."""
    return operator.folder(study) / f"p{number:03d}"


def condition_folder(study: Path, operator: Operator, number: int, position: int, condition: str) -> Path:
    """The folder of what a participant has done in one condition."""
    return participant_folder(study, operator, number) / f"{position}-{condition}"


def trial_folder(study: Path, operator: Operator, number: int, position: int, condition: str, task: int) -> Path:
    """The folder of a task, to which the page writes too."""
    return condition_folder(study, operator, number, position, condition) / f"task-{task}"


def write_record(path: Path, study_id: str, participant: int, operator: Operator, **values: Any) -> None:
    """Write a record with its stamp."""
    stamp = {"format": FORMAT, "study": study_id, "participant": participant, "operator": asdict(operator)}
    write_json(path, stamp | values)


def write_trial(folder: Path, trial: TrialRecord) -> None:
    """Write the record of a finished trial."""
    values = {key: value for key, value in asdict(trial).items() if key not in ("study", "participant", "operator")}
    write_record(folder / TRIAL_FILE, trial.study, trial.participant, trial.operator, **values)


def read_record(path: Path, study_id: str, operator: Operator, participant: int) -> dict[str, Any]:
    """The contents of a record, without its stamp, which must be that of this study, operator and participant."""
    try:
        row = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no record ({_one_line(error)}); remove the file and take this part again") from None
    if not isinstance(row, dict) or row.get("format") != FORMAT:
        raise InputError(f"{path}: expected a record of the format {FORMAT}; this file is none")
    stamp = row.get("operator")
    if stamp != asdict(operator):
        raise InputError(
            f"{path}: a record of {_operator_text(stamp)} among those of {_operator_text(asdict(operator))}; "
            "people and simulations are never mixed: move it away"
        )
    for name, expected in (("study", study_id), ("participant", participant)):
        if row.get(name) != expected or isinstance(row.get(name), bool):
            raise InputError(f"{path}: {name}: expected {expected!r}, got {row.get(name)!r}; is the file a copy?")
    return {key: value for key, value in row.items() if key not in ("format", "study", "participant", "operator")}


def check_judge(path: Path, study_id: str, operator: Operator, participant: int, judge: str) -> None:
    """Raise InputError where the participant of a record was judged otherwise: one has one judge."""
    known = read_record(path, study_id, operator, participant).get("judge")
    if known != judge:
        raise InputError(
            f"--judge {judge}: {path} was judged by the {known}; go on with --judge {known}, or choose another --out"
        )


def read_trial(path: Path, study_id: str, operator: Operator, participant: int) -> TrialRecord:
    """A trial as written by `write_trial`."""
    row = read_record(path, study_id, operator, participant)
    values: dict[str, Any] = _fields(path, row, TRIAL_FIELDS)
    values["parts"] = tuple(PartResult(**_fields(path, part, PART_FIELDS)) for part in row["parts"])
    return TrialRecord(study=study_id, participant=participant, operator=operator, **values)


def read_ratings(path: Path, study_id: str, operator: Operator, participant: int) -> dict[str, int]:
    """The six ratings; a simulated operator has none."""
    row = read_record(path, study_id, operator, participant)
    if operator.kind != HUMAN:
        raise InputError(f"{path}: ratings of a simulated operator; only people can rate load: remove the file")
    if not isinstance(row.get("ratings"), dict):
        raise InputError(f"{path}: ratings: expected six numbers by name")
    return checked_ratings(row["ratings"], str(path))


def _number(least: float) -> Callable[[Any], bool]:
    return lambda value: not isinstance(value, bool) and isinstance(value, int | float) and least <= value < 1e9


def _whole(least: int) -> Callable[[Any], bool]:
    return lambda value: not isinstance(value, bool) and isinstance(value, int) and least <= value < 10**9


def _text(value: Any) -> bool:
    return isinstance(value, str) and bool(value)


def _flag(value: Any) -> bool:
    return isinstance(value, bool)


def _optional_number(value: Any) -> bool:
    return value is None or _number(0)(value)


Fields = Mapping[str, tuple[str, Callable[[Any], bool]]]
PART_FIELDS: Fields = {
    "part": ("a whole number from 0", _whole(0)),
    "outcome": ("text", _text),
    "seated_by_test": ("true or false", _flag),
    "position_mm": ("a number from 0, or null", _optional_number),
    "angle_deg": ("a number from 0, or null", _optional_number),
}
TRIAL_FIELDS: Fields = {
    "condition": ("text", _text),
    "position": ("a whole number from 1", _whole(1)),
    "task": ("a whole number from 1", _whole(1)),
    "scene": ("text", _text),
    "kits": ("a whole number from 1", _whole(1)),
    "task_set": ("a whole number from 0", _whole(0)),
    "parts": ("a list of results", lambda value: isinstance(value, list)),
    "specification_s": ("seconds from 0", _number(0)),
    "execution_s": ("seconds from 0", _number(0)),
    "uploads": ("a whole number from 0", _whole(0)),
    "undos": ("a whole number from 0", _whole(0)),
    "refused": ("a whole number from 0", _whole(0)),
    "interruptions": ("a whole number from 0", _whole(0)),
    "out_of_time": ("true or false", _flag),
}


def _fields(path: Path, row: Any, fields: Fields) -> dict[str, Any]:
    """Exactly these values of a row, checked."""
    if not isinstance(row, dict):
        raise InputError(f"{path}: expected an object, got {type(row).__name__}")
    unknown = sorted(row.keys() - fields.keys())
    if unknown:
        raise InputError(f"{path}: no field {unknown[0]!r}; {did_you_mean(unknown[0], fields)}".rstrip("; "))
    for name, (expected, holds) in fields.items():
        if name not in row:
            raise InputError(f"{path}: {name} is missing; expected {expected}")
        if not holds(row[name]):
            raise InputError(f"{path}: {name}: expected {expected}, got {row[name]!r:.60}")
    return {name: row[name] for name in fields}


def _operator_text(stamp: Any) -> str:
    if isinstance(stamp, dict) and stamp.get("kind") == HUMAN:
        return "a person"
    if isinstance(stamp, dict) and stamp.get("kind") == SIMULATED:
        return f"a simulated operator ({stamp.get('name')})"
    return "nobody known"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
