"""The plan of a study, fixed before anybody takes part: two conditions, their orders, the tasks, the main outcome.

Every participant meets both conditions, each with its own set of tasks. Both the order of the conditions and the
assignment of the sets are balanced within each block of four participants (counterbalancing).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from kit1000.dataset.reader import Dataset
from kit1000.editor.keys import Interface
from kit1000.errors import InputError, did_you_mean
from kit1000.files import converted, json_bytes, read_json, write_json
from kit1000.rng import stream
from kit1000.study.tasks import SceneTest, Task, Tasks, choose_tasks

FORMAT = "kit1000-study/1"
FILE = "plan.json"
MAIN_OUTCOME = "success"
"""Share of the parts of a participant that the robot seats; all other outcomes are secondary."""
BLOCK = 4  # participants, after which all orders and assignments of sets have occurred equally often


class Condition(NamedTuple):
    """One way to specify where parts go."""

    name: str
    label: str  # name for participants and readers of a report
    interface: Interface
    snaps: bool  # whether a method proposes fits

    @property
    def one_part_an_upload(self) -> bool:
        """Whether the robot carries out each confirmed part by itself, or all parts at once."""
        return self.interface != "scene"


CONDITIONS = {
    condition.name: condition
    for condition in (
        Condition("scene-snap", "Scene editing, snapping", "scene", True),
        Condition("scene", "Scene editing, by hand", "scene", False),
        Condition("hand", "Hand control", "hand", False),
        Condition("hand-bare", "Hand control of the paper", "hand-bare", False),
    )
}
DEFAULT = ("scene-snap", "hand")
"""The comparison of the paper, with the same aids for cups as for parts."""


class Place(NamedTuple):
    """What a participant meets at one position."""

    condition: int  # index of the condition
    task_set: int  # index of the set of tasks


def places(seed: int, participant: int) -> tuple[Place, Place]:
    """What a participant meets first and second. participant: from 1.

    Which number has which order is drawn within a block, so that it cannot be guessed. Further participants change
    nothing for earlier ones.
    """
    pair, member = divmod(participant - 1, 2)
    block, half = divmod(pair, 2)
    first = int(stream(seed, "study-orders", pair).permutation(2)[member])
    shift = int(stream(seed, "study-sets", block).permutation(2)[half])
    return Place(first, shift), Place(1 - first, 1 - shift)


class Session(NamedTuple):
    """What one participant does in one condition."""

    position: int  # 1 or 2
    condition: Condition
    task_set: int
    tasks: tuple[Task, ...]


class StudyPlan(msgspec.Struct, frozen=True):
    """A study."""

    dataset_id: str
    sensor: str
    snap: str  # method of the condition that snaps: of the catalog, or `module:Object`
    conditions: tuple[str, ...]
    people: int
    seed: int
    tasks: Tasks

    def __post_init__(self) -> None:
        for name in self.conditions:
            if name not in CONDITIONS:
                hint = did_you_mean(name, CONDITIONS)
                raise InputError(f"--conditions {name}: {hint}there are {', '.join(CONDITIONS)}")
        if len(self.conditions) != 2 or len({*self.conditions}) != 2:
            raise InputError(f"--conditions: expected two different ones, got {' '.join(self.conditions) or 'none'}")
        if self.people < BLOCK or self.people % BLOCK:
            raise InputError(
                f"--people: expected a multiple of {BLOCK}, so that orders are balanced, got {self.people}"
            )
        if len(self.tasks.sets) != 2:
            raise InputError(f"tasks: expected 2 sets, got {len(self.tasks.sets)}")

    @property
    def id(self) -> str:
        """16 hex digits of the SHA-256 of the plan."""
        return hashlib.sha256(json_bytes(self._content())).hexdigest()[:16]

    def sessions(self, participant: int) -> tuple[Session, ...]:
        """What a participant does, in order. participant: from 1."""
        if not 1 <= participant <= self.people:
            raise InputError(f"participant {participant}: the plan has 1 to {self.people}; plan more with --people")
        return tuple(
            Session(
                position, CONDITIONS[self.conditions[place.condition]], place.task_set, self.tasks.sets[place.task_set]
            )
            for position, place in enumerate(places(self.seed, participant), start=1)
        )

    def as_json(self) -> dict[str, Any]:
        """The contents of plan.json; `orders` can be read there, and follows from the rest."""
        orders = [[f"{each.condition.name}/{each.task_set}" for each in sessions] for sessions in self._all_sessions()]
        return self._content() | {"id": self.id, "orders": orders, "main_outcome": MAIN_OUTCOME}

    def as_text(self) -> str:
        """The orders, a line for each participant."""
        lines = [f"{self.id}: {self.people} people, {len(self.tasks.sets)} sets of {len(self.tasks.sets[0])} tasks"]
        for number, sessions in enumerate(self._all_sessions(), start=1):
            steps = (f"{each.condition.name} (set {each.task_set + 1})" for each in sessions)
            lines.append(f"p{number:03d}  " + ", then ".join(steps))
        return "\n".join(lines)

    def _all_sessions(self) -> list[tuple[Session, ...]]:
        return [self.sessions(number) for number in range(1, self.people + 1)]

    def _content(self) -> dict[str, Any]:
        return {"format": FORMAT} | msgspec.to_builtins(self)


def make_plan(
    dataset: Dataset,
    people: int,
    conditions: Sequence[str] = DEFAULT,
    sensor: str = "ideal",
    snap: str = "none",
    seed: int = 0,
    solvable: SceneTest | None = None,
) -> StudyPlan:
    """Draw a plan. Arguments: the fields of StudyPlan, and those of `choose_tasks`."""
    nothing = Tasks(Task("", 0), ((), ()))
    plan = StudyPlan(
        dataset.id, sensor, snap, tuple(conditions), people, seed, nothing
    )  # checks before the robot works
    return msgspec.structs.replace(plan, tasks=choose_tasks(dataset, sensor, seed, solvable))


def write_plan(study: Path, plan: StudyPlan) -> None:
    """Write plan.json."""
    write_json(study / FILE, plan.as_json())


def read_plan(study: Path) -> StudyPlan:
    """The plan of a study; raises InputError if there is none, or if it was changed by hand."""
    path = study / FILE
    if not path.is_file():
        raise InputError(f"{study}: no {FILE}; make one: kit1000 study DATA --people 12 --out {study}")
    row = read_json(path)
    plan = converted(row, StudyPlan, path)
    if json_bytes(row) != json_bytes(plan.as_json()):
        raise InputError(f"{path}: is no plan of the format {FORMAT} as it was made; a plan must not be changed")
    return plan
