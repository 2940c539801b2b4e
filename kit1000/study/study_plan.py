"""The plan of a study, written before anybody clicks: tasks, conditions, orders, and the one main outcome."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import json_bytes, read_json, write_json
from kit1000.study.conditions import DEFAULT, Condition, conditions_of
from kit1000.study.orders import Place, orders
from kit1000.study.tasks import Manages, Task, Tasks, choose_tasks

FORMAT = "kit1000-study/1"
FILE = "plan.json"
MAIN_OUTCOME = "success"
"""Share of a person's parts that the robot seats, named before any data; all other outcomes are secondary."""


class Session(NamedTuple):
    """What one participant does in one condition."""

    position: int
    """From 1."""
    condition: Condition
    task_set: int
    tasks: tuple[Task, ...]


@dataclass(frozen=True)
class StudyPlan:
    """A study."""

    dataset_id: str
    sensor: str
    snap: str
    """The method of the conditions that snap, `module:Object`."""
    conditions: tuple[str, ...]
    people: int
    seed: int
    tasks: Tasks

    def __post_init__(self) -> None:
        conditions_of(self.conditions)
        if len(self.tasks.sets) != len(self.conditions):
            raise InputError(f"tasks: expected {len(self.conditions)} sets, got {len(self.tasks.sets)}")
        orders(len(self.conditions), self.people, self.seed)

    @property
    def id(self) -> str:
        """16 hex digits of the SHA-256 of the plan."""
        return hashlib.sha256(json_bytes(self._content())).hexdigest()[:16]

    def sessions(self, participant: int) -> tuple[Session, ...]:
        """What a participant does, in order. participant: from 1."""
        places = self._orders()[self._checked(participant) - 1]
        conditions = conditions_of(self.conditions)
        return tuple(
            Session(position, conditions[place.condition], place.task_set, self.tasks.sets[place.task_set])
            for position, place in enumerate(places, start=1)
        )

    def as_json(self) -> dict[str, Any]:
        """The contents of plan.json; the orders are there to be read, and follow from the rest."""
        written = [[f"{self.conditions[place.condition]}/{place.task_set}" for place in row] for row in self._orders()]
        return self._content() | {"id": self.id, "orders": written, "main_outcome": MAIN_OUTCOME}

    def _content(self) -> dict[str, Any]:
        return {"format": FORMAT} | asdict(self)

    def _orders(self) -> list[tuple[Place, ...]]:
        return orders(len(self.conditions), self.people, self.seed)

    def _checked(self, participant: int) -> int:
        if not 1 <= participant <= self.people:
            raise InputError(f"participant {participant}: the plan has 1 to {self.people}; plan more with --people")
        return participant


def make_plan(
    dataset: Dataset,
    people: int,
    conditions: Sequence[str] = DEFAULT,
    sensor: str = "ideal",
    snap: str = "none",
    seed: int = 0,
    manages: Manages | None = None,
) -> StudyPlan:
    """Draw a plan; arguments as the fields of StudyPlan and those of `choose_tasks`."""
    chosen = conditions_of(conditions)
    orders(len(chosen), people, seed)  # refuses before the robot is asked
    tasks = choose_tasks(dataset, len(chosen), sensor, seed, manages)
    return StudyPlan(dataset.id, sensor, snap, tuple(conditions), people, seed, tasks)


def write_plan(study: Path, plan: StudyPlan) -> None:
    """Write plan.json."""
    write_json(study / FILE, plan.as_json())


def read_plan(study: Path) -> StudyPlan:
    """The plan of a study; raises InputError where there is none, or where it was changed by hand."""
    path = study / FILE
    if not path.is_file():
        raise InputError(f"{study}: no {FILE}; make one: kit1000 study DATA --people 12 --out {study}")
    row = read_json(path)
    if not isinstance(row, dict) or row.get("format") != FORMAT:
        raise InputError(f"{path}: expected a plan of the format {FORMAT}")
    try:
        tasks = Tasks(_task(row["tasks"]["practice"]), tuple(tuple(map(_task, one)) for one in row["tasks"]["sets"]))
        dataset_id, sensor, snap = (str(row[name]) for name in ("dataset_id", "sensor", "snap"))
        conditions = tuple(map(str, row["conditions"]))
        plan = StudyPlan(dataset_id, sensor, snap, conditions, int(row["people"]), int(row["seed"]), tasks)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: damaged ({type(error).__name__}: {error}); restore it from a copy") from None
    if json_bytes(row) != json_bytes(plan.as_json()):
        raise InputError(f"{path}: differs from what its own seed gives; a plan is not changed once it is made")
    return plan


def orders_text(plan: StudyPlan) -> str:
    """The orders as lines, one a participant."""
    lines = [f"{plan.id}: {plan.people} people, {len(plan.tasks.sets)} sets of {len(plan.tasks.sets[0])} tasks"]
    for number in range(1, plan.people + 1):
        steps = (f"{each.condition.name} (set {each.task_set + 1})" for each in plan.sessions(number))
        lines.append(f"p{number:03d}  " + ", then ".join(steps))
    return "\n".join(lines)


def _task(row: dict[str, Any]) -> Task:
    return Task(str(row["scene"]), int(row["kits"]))
