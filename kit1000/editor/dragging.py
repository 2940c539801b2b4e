"""What the hand does to a body, as functions of motions: slide on a surface, turn, tilt, raise, stand level.

A motion is a `goal_from_now`; the body turns about the image of its pivot. A `Drag` is one of these as a function of
the position of the pointer, chosen by the modifier key.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from kit1000.editor.keys import FINE_TURN_DEG, STEP_MM, TURN_DEG
from kit1000.editor.pointing import Eye, Surface
from kit1000.editor.seen_plates import Plate
from kit1000.editor.session import PartEdit
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.numerics.trigonometry import tangent
from kit1000.pose import Pose, quaternion_between

Modifier = Literal["shift", "cmd/ctrl", "alt"] | None
NAMES: dict[Modifier, str] = {None: "move", "shift": "lift", "cmd/ctrl": "turn", "alt": "tilt"}
"""Names of the operations in the history."""

TURN_PER_HEIGHT = 2 * np.pi  # [rad] for a drag across the height of the screen
TILT_PER_HEIGHT = np.pi
GATHER = 0.12  # heights of the screen


@dataclass(frozen=True, eq=False)
class Drag:
    """A drag in progress."""

    body: int
    before: PartEdit
    cloud: np.ndarray  # (n, 3) [m] that bounds the body at its recorded pose
    pivot: np.ndarray  # (3,) [m] of the body at its recorded pose
    eye: Eye
    start: tuple[float, float]  # on the screen
    grabbed: np.ndarray  # (3,) [m] world: the point of the body under the pointer
    plate: Plate  # on which it stood
    modifier: Modifier

    @property
    def turns(self) -> bool:
        """Whether it rotates the body."""
        return self.modifier in ("cmd/ctrl", "alt")

    def motion(self, surface: Surface, screen: tuple[float, float]) -> Pose | None:
        """goal_from_now with the pointer at a place on the screen; None if there is nothing to stand on."""
        before = self.before.goal_from_now
        across, down = (screen[0] - self.start[0]) * self.eye.aspect, screen[1] - self.start[1]
        if self.modifier is None:
            return self._slid(surface, screen)
        if self.modifier == "cmd/ctrl":
            return rotated(before, self.pivot, self.plate.normal, across * TURN_PER_HEIGHT)
        if self.modifier == "alt":
            right, ahead = screen_axes(self.eye, self.plate)
            tilted = rotated(before, self.pivot, right, down * TILT_PER_HEIGHT)
            return rotated(tilted, self.pivot, ahead, across * TILT_PER_HEIGHT)
        distance = length(before.apply(self.pivot) - self.eye.world_from_camera.xyz)
        height = 2 * distance * float(tangent(self.eye.fov / 2))  # [m] of what the screen shows there
        return shifted(before, -down * height * self.plate.normal)

    def _slid(self, surface: Surface, screen: tuple[float, float]) -> Pose | None:
        """The point of the surface below the grabbed one comes under the pointer.

        It begins some way from it, as the body has a height; that is made up for over the first GATHER of the drag, so
        that the body neither jumps nor ends up beside the place that is pointed at.
        """
        before, plate = self.before.goal_from_now, self.plate
        below, foot = plate.projected(self.grabbed), plate.projected(before.apply(self.pivot))
        x, y = self.eye.screen(below)
        across, down = (screen[0] - self.start[0]) * self.eye.aspect, screen[1] - self.start[1]
        left = max(0.0, 1 - float(np.hypot(across, down)) / GATHER)
        target = (screen[0] + left * (x - self.start[0]), screen[1] + left * (y - self.start[1]))
        support = surface.support(self.eye, target)
        if support is None:
            return None
        turn = Pose(quaternion_between(plate.normal, support.plate.normal), np.zeros(3))
        point = support.plate.projected(support.point + turn.rotate(foot - below))
        return slid(before, self.cloud, self.pivot, plate, support.plate, point)


@dataclass(frozen=True, eq=False)
class Held:
    """The body in the hand when a key is pressed."""

    motion: Pose  # goal_from_now
    cloud: np.ndarray  # (n, 3) [m] that bounds the body at its recorded pose
    pivot: np.ndarray  # (3,) [m] of the body at its recorded pose
    plate: Plate  # on which it stands
    eye: Eye | None


class KeyMotion(NamedTuple):
    """What a key does to the body in the hand."""

    name: str  # name in the history
    turns: bool  # whether it rotates the body
    motion: Callable[[Held], Pose]


def _raised(millimetres: float) -> Callable[[Held], Pose]:
    return lambda held: shifted(held.motion, millimetres * 1e-3 * held.plate.normal)


def _turned(degrees: float) -> Callable[[Held], Pose]:
    return lambda held: rotated(held.motion, held.pivot, held.plate.normal, np.radians(degrees))


def _tipped(axis: int) -> Callable[[Held], Pose]:
    """By 90° about an axis of `screen_axes`, then stood on the plate."""

    def motion(held: Held) -> Pose:
        tipped = rotated(held.motion, held.pivot, screen_axes(held.eye, held.plate)[axis], -np.pi / 2)
        return stood(tipped, held.cloud, held.plate)

    return motion


KEY_MOTIONS: Mapping[str, KeyMotion] = {
    "raise": KeyMotion("raise", False, _raised(STEP_MM)),
    "lower": KeyMotion("lower", False, _raised(-STEP_MM)),
    "turn-left": KeyMotion("turn", True, _turned(TURN_DEG)),
    "turn-right": KeyMotion("turn", True, _turned(-TURN_DEG)),
    "turn-left-fine": KeyMotion("turn", True, _turned(FINE_TURN_DEG)),
    "turn-right-fine": KeyMotion("turn", True, _turned(-FINE_TURN_DEG)),
    "tip-away": KeyMotion("tip over", True, _tipped(0)),
    "tip-aside": KeyMotion("tip over", True, _tipped(1)),
    "level": KeyMotion("stand level", True, lambda held: levelled(held.motion, held.cloud, held.pivot, held.plate)),
}
"""By verb."""


def screen_axes(eye: Eye | None, plate: Plate) -> tuple[np.ndarray, np.ndarray]:
    """(3,), (3,): on a plate, to the right as the browser's camera sees it, and away from it."""
    right = np.array([1.0, 0.0, 0.0]) if eye is None else eye.world_from_camera.rotate([1.0, 0.0, 0.0])
    right = right - float(matmul(right, plate.normal)) * plate.normal
    right = right / max(length(right), 1e-9)
    return right, np.cross(plate.normal, right)


def slid(motion: Pose, cloud: np.ndarray, pivot: np.ndarray, old: Plate, new: Plate, point: np.ndarray) -> Pose:
    """The part stood on another place: it keeps its rotation to the surface, and touches that.

    Args:
        motion: goal_from_now.
        cloud: (n, 3) [m] points that bound the part at its recorded pose.
        pivot: (3,) [m] of the part at its recorded pose.
        old: the surface on which it stands.
        new: the surface on which it shall stand.
        point: (3,) [m] on that surface, below the pivot.
    """
    rotation = Pose(quaternion_between(old.normal, new.normal), np.zeros(3)) @ Pose(motion.wxyz, np.zeros(3))
    below = float(matmul(rotation.rotate(cloud - pivot), new.normal).min())
    return _about(rotation, pivot, point - below * new.normal)


def rotated(motion: Pose, pivot: np.ndarray, axis: np.ndarray, angle: float) -> Pose:
    """Turned about an axis (3,) of the world through the image of the pivot. angle: [rad]."""
    rotation = Pose.from_rotvec(axis * angle) @ Pose(motion.wxyz, np.zeros(3))
    return _about(rotation, pivot, motion.apply(pivot))


def shifted(motion: Pose, offset: np.ndarray) -> Pose:
    """Moved by an offset (3,) [m] of the world."""
    return Pose(motion.wxyz, motion.xyz + offset)


def levelled(motion: Pose, cloud: np.ndarray, pivot: np.ndarray, plate: Plate) -> Pose:
    """Stood on a plate at its place, on the nearest of the six sides that the part has at its recorded pose."""
    here = motion.inverse().rotate(plate.normal)
    side = np.zeros(3)
    side[np.abs(here).argmax()] = np.sign(here[np.abs(here).argmax()])
    up = motion.rotate(side)
    level = Pose(quaternion_between(up, plate.normal), np.zeros(3)) @ Pose(motion.wxyz, np.zeros(3))
    return stood(_about(level, pivot, motion.apply(pivot)), cloud, plate)


def stood(motion: Pose, cloud: np.ndarray, plate: Plate) -> Pose:
    """Lowered or raised along the plate's normal until it touches the plate."""
    lowest = float(plate.height(motion.apply(cloud)).min())
    return shifted(motion, -lowest * plate.normal)


def _about(rotation: Pose, pivot: np.ndarray, image: np.ndarray) -> Pose:
    """The motion with a rotation that takes the pivot to its image (3,) [m]."""
    return Pose(rotation.wxyz, image - rotation.rotate(pivot))
