"""The records of a study as files: who took part, the result of each trial, the answers.

    STUDY/plan.json
    STUDY/people/p001/participant.json          consent, versions
                      1-hand/task-1/events.jsonl, predictions.csv, trial.json
                      1-hand/ratings.json       six ratings after a condition
                      closing.json              the preferred condition

The record of a trial is written last, so a sitting continues where it was interrupted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from kit1000.errors import InputError
from kit1000.files import converted, read_json, write_json
from kit1000.planner.execute import SEATED
from kit1000.study.plan import Session, StudyPlan
from kit1000.study.questionnaire import HIGHEST, STEP

PEOPLE = "people"  # the folder of all participants
PARTICIPANT_FILE, PRACTICE_FILE, TRIAL_FILE = "participant.json", "practised.json", "trial.json"
RATINGS_FILE, CLOSING_FILE = "ratings.json", "closing.json"
FORMAT = "kit1000-study-record/3"
Count = Annotated[int, Meta(ge=0)]
Number = Annotated[float, Meta(ge=0, lt=1e9)]


class Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What every record states; by itself the record that somebody has practised."""

    study: str  # id of the plan
    participant: int
    format: Literal["kit1000-study-record/3"] = FORMAT


class Consent(msgspec.Struct, frozen=True):
    """The consent of a participant: the version of its text, and when it was given [s] since 1970."""

    version: str
    time: float


class Participation(Record, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The beginning of a sitting."""

    versions: Mapping[str, str]
    consent: Consent | None = None


class PartResult(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The result of one part."""

    part: Count
    outcome: str  # an outcome of the robot, or `not uploaded`
    seated_by_test: bool  # whether the uploaded motion passes the seating test of the benchmark
    position_mm: Number | None  # position error of the uploaded motion to the nearest goal; None if none was uploaded
    angle_deg: Number | None


class TrialRecord(Record, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One task of one participant."""

    condition: str
    position: int  # position of the condition in the participant's order, 1 or 2
    task: int  # from 1, within the condition
    scene: str
    kits: int
    task_set: int
    parts: tuple[PartResult, ...]
    specification_s: Number  # [s] for which the participant was in charge
    execution_s: Number  # [s] of the robot
    uploads: Count = 0
    undos: Count = 0
    refused: Count = 0  # proposals that were passed over
    interruptions: Count = 0  # number of times that the sitting was interrupted within this task
    out_of_time: bool = False  # whether a part was not uploaded because the time was over

    @property
    def seated(self) -> int:
        """Number of parts that the robot has seated."""
        return sum(part.outcome == SEATED for part in self.parts)


Rating = Annotated[int, Meta(ge=0, le=HIGHEST, multiple_of=STEP)]


class Ratings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The six ratings; none may be missing."""

    mental: Rating
    physical: Rating
    temporal: Rating
    performance: Rating
    effort: Rating
    frustration: Rating


class RatingsRecord(Record, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Six ratings after a condition."""

    ratings: Ratings


class Closing(Record, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The last answer: the preferred condition."""

    preferred: str


AnyRecord = TypeVar("AnyRecord", bound=Record)


@dataclass(frozen=True)
class Participant:
    """Everything that one participant has left behind."""

    number: int
    trials: tuple[TrialRecord, ...]
    ratings: Mapping[str, Mapping[str, int]] = field(default_factory=dict)  # six ratings by condition
    preferred: str | None = None


@dataclass(frozen=True)
class ParticipantFiles:
    """The files of one participant."""

    study: Path
    plan: StudyPlan
    number: int

    @property
    def folder(self) -> Path:
        """The folder of the participant."""
        return self.study / PEOPLE / f"p{self.number:03d}"

    def of_session(self, session: Session) -> Path:
        """The folder of a condition."""
        return self.folder / f"{session.position}-{session.condition.name}"

    def of_task(self, session: Session, task: int) -> Path:
        """The folder of a task, to which the page writes too. task: from 1; 0 to practise."""
        return self.of_session(session) / f"task-{task}"

    def folders(self) -> Iterator[Path]:
        """All folders that the plan has for this participant."""
        yield self.folder
        for session in self.plan.sessions(self.number):
            yield self.of_session(session)
            yield from (self.of_task(session, task) for task in range(len(session.tasks) + 1))

    def record(self, kind: type[AnyRecord], **values: Any) -> AnyRecord:
        """A record of this participant."""
        return kind(study=self.plan.id, participant=self.number, **values)

    def write(self, path: Path, record: Record) -> None:
        """Write a record."""
        write_json(path, msgspec.to_builtins(record))

    def read(self, path: Path, kind: type[AnyRecord]) -> AnyRecord:
        """A record of this participant; raises InputError if the file holds anything else."""
        record = converted(read_json(path), kind, path)
        for name, value in {"study": self.plan.id, "participant": self.number}.items():
            if (stated := getattr(record, name)) != value:
                raise InputError(f"{path}: {name}: expected {value!r}, got {stated!r}; move the file away")
        return record


def read_participants(study: Path, plan: StudyPlan) -> list[Participant]:
    """All participants by number; raises InputError at the first record that does not belong."""
    everybody = [ParticipantFiles(study, plan, number) for number in range(1, plan.people + 1)]
    planned = {folder for files in everybody for folder in files.folders()}
    for path in sorted((study / PEOPLE).rglob("*")):
        if path.is_dir() and path not in planned:
            raise InputError(f"{path}: the plan has no such participant, condition or task; move the folder away")
    return [_read_participant(files) for files in everybody if any(files.folder.rglob("*.json"))]


def _read_participant(files: ParticipantFiles) -> Participant:
    path, sessions = files.folder / PARTICIPANT_FILE, files.plan.sessions(files.number)
    if files.read(path, Participation).consent is None:
        raise InputError(f"{path}: no consent; the records of this participant must not be used")
    trials, ratings = [], {}
    for session in sessions:
        for task in range(1, len(session.tasks) + 1):
            if (files.of_task(session, task) / TRIAL_FILE).is_file():
                trials.append(_read_trial(files, session, task))
        answers = files.of_session(session) / RATINGS_FILE
        if answers.is_file():
            ratings[session.condition.name] = msgspec.to_builtins(files.read(answers, RatingsRecord).ratings)
    closing = files.folder / CLOSING_FILE
    preferred = files.read(closing, Closing).preferred if closing.is_file() else None
    if preferred is not None and preferred not in files.plan.conditions:
        raise InputError(f"{closing}: preferred: expected {' or '.join(files.plan.conditions)}, got {preferred!r}")
    return Participant(files.number, tuple(trials), ratings, preferred)


def _read_trial(files: ParticipantFiles, session: Session, number: int) -> TrialRecord:
    path, task = files.of_task(session, number) / TRIAL_FILE, session.tasks[number - 1]
    trial = files.read(path, TrialRecord)
    planned = (session.position, session.condition.name, session.task_set, number, task.scene, task.kits)
    written = (trial.position, trial.condition, trial.task_set, trial.task, trial.scene, trial.kits)
    if written != planned:
        raise InputError(f"{path}: is about {written}, but the plan has {planned}; is the file a copy?")
    if [part.part for part in trial.parts] != list(range(task.kits)):
        raise InputError(f"{path}: parts: expected one result for each of the {task.kits} parts, in order")
    return trial
