"""An editing session as values: where each part goes, and the history of operations, each undone bit for bit.

One operation is one gesture of the hand: a drag from press to release, a key, a snap of all parts. It keeps what each
part was before and after, so undoing computes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from kit1000.errors import InputError, checked
from kit1000.numerics.linear_algebra import matmul
from kit1000.pose import Pose

State = Literal["free", "snapped", "unsure", "confirmed"]
SURE, LIKELY = 0.8, 0.5
"""Confidences from which a fit is called sure and likely; below it is not sure."""


@dataclass(frozen=True, eq=False)
class PartEdit:
    """What the hand has done to a part."""

    goal_from_now: Pose  # the motion, in the world, from the recorded pose of the part to where the hand has put it
    snapped: bool = False  # whether it stands at a fit that was taken
    confidence: float = 0.0  # 0 to 1: of the fit that was taken; 0 for a part placed by hand alone
    turned: bool = False  # whether the hand has rotated it: only then does its rotation say anything about the goal
    confirmed: bool = False

    def __post_init__(self) -> None:
        if not 0 <= checked("confidence", self.confidence, ()) <= 1:
            raise InputError(f"confidence: expected 0 to 1, got {self.confidence}")

    @property
    def state(self) -> State:
        """confirmed, snapped onto a likely fit, snapped onto an unsure one, or free."""
        if self.confirmed:
            return "confirmed"
        if not self.snapped:
            return "free"
        return "snapped" if self.confidence >= LIKELY else "unsure"

    def moved(self, goal_from_now: Pose, turned: bool = False) -> PartEdit:
        """Moved by hand: no longer snapped or confirmed."""
        return PartEdit(goal_from_now, turned=self.turned or turned)

    def taken(self, goal_from_now: Pose, confidence: float) -> PartEdit:
        """Snapped onto a fit."""
        return PartEdit(goal_from_now, True, confidence, self.turned)

    def confirm(self) -> PartEdit:
        """Confirmed where it stands."""
        return replace(self, confirmed=True)

    def same_as(self, other: PartEdit) -> bool:
        """Whether both are equal, bit for bit."""
        return same_motion(self.goal_from_now, other.goal_from_now) and self._said() == other._said()

    def _said(self) -> tuple[object, ...]:
        return self.snapped, self.confidence, self.turned, self.confirmed


UNTOUCHED = PartEdit(Pose.identity())


class Change(NamedTuple):
    """What an operation does to one part."""

    before: PartEdit
    after: PartEdit


@dataclass(frozen=True, eq=False)
class Operation:
    """One gesture: a name for the history, and its changes by part."""

    name: str
    changes: Mapping[int, Change]


@dataclass(frozen=True, eq=False)
class Session:
    """The edits of a scene's parts, by index, and the operations that led to them."""

    edits: Mapping[int, PartEdit]
    done: tuple[Operation, ...] = ()  # the history, the latest last
    undone: tuple[Operation, ...] = ()  # what can be redone, the next last

    @classmethod
    def begin(cls, parts: tuple[int, ...]) -> Session:
        """A session in which nothing has moved. parts: their indices."""
        return cls(dict.fromkeys(parts, UNTOUCHED))

    def did(self, name: str, edits: Mapping[int, PartEdit]) -> Session:
        """After an operation that gives some parts new edits; itself if none of them differs."""
        unknown = edits.keys() - self.edits.keys()
        if unknown:
            raise InputError(f"part {min(unknown)}: expected one of {', '.join(map(str, self.edits))}")
        changes = {
            part: Change(self.edits[part], edit)
            for part, edit in sorted(edits.items())
            if not edit.same_as(self.edits[part])
        }
        if not changes:
            return self
        operation = Operation(name, changes)
        return Session(self._with(operation, after=True), (*self.done, operation))

    def undo(self) -> Session:
        """Without the latest operation; itself if there is none."""
        if not self.done:
            return self
        *rest, last = self.done
        return Session(self._with(last, after=False), tuple(rest), (*self.undone, last))

    def redo(self) -> Session:
        """With the operation undone last; itself if there is none."""
        if not self.undone:
            return self
        *rest, last = self.undone
        return Session(self._with(last, after=True), (*self.done, last), tuple(rest))

    def _with(self, operation: Operation, after: bool) -> dict[int, PartEdit]:
        side = {part: change.after if after else change.before for part, change in operation.changes.items()}
        return {**self.edits, **side}


def part_name(part: int) -> str:
    """What the page calls a part: they count from 1, as the keys do."""
    return f"part {part + 1}"


def same_motion(one: Pose, other: Pose) -> bool:
    """Whether two motions are equal, bit for bit."""
    return one.wxyz.tobytes() + one.xyz.tobytes() == other.wxyz.tobytes() + other.xyz.tobytes()


def distance(one: Pose, other: Pose, pivot: np.ndarray) -> tuple[float, float]:
    """How far apart two motions move the pivot [m], and the angle between them [rad]."""
    apart = one.apply(pivot) - other.apply(pivot)
    return float(np.sqrt(matmul(apart, apart))), float((one @ other.inverse()).angle())
