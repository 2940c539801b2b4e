"""A drag of a body as a function of where the pointer is: slide, lift, turn or tilt, by the modifier that is held."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kit1000.editor import gestures
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
    cloud: np.ndarray
    """(n, 3) [m] that bounds the body where it lies."""
    pivot: np.ndarray
    """(3,) [m] of the body where it lies."""
    eye: Eye
    start: tuple[float, float]
    """On the screen."""
    grabbed: np.ndarray
    """(3,) [m] world: the point of the body under the pointer."""
    plate: Plate
    """On which it stood."""
    modifier: Modifier

    @property
    def turns(self) -> bool:
        """Whether it rotates the body."""
        return self.modifier in ("cmd/ctrl", "alt")

    def motion(self, surface: Surface, screen: tuple[float, float]) -> Pose | None:
        """goal_from_now with the pointer at a place on the screen; None where there is nothing to stand on."""
        before = self.before.goal_from_now
        across, down = (screen[0] - self.start[0]) * self.eye.aspect, screen[1] - self.start[1]
        if self.modifier is None:
            return self._slid(surface, screen)
        if self.modifier == "cmd/ctrl":
            return gestures.rotated(before, self.pivot, self.plate.normal, across * TURN_PER_HEIGHT)
        if self.modifier == "alt":
            right, ahead = screen_axes(self.eye, self.plate)
            tilted = gestures.rotated(before, self.pivot, right, down * TILT_PER_HEIGHT)
            return gestures.rotated(tilted, self.pivot, ahead, across * TILT_PER_HEIGHT)
        distance = length(before.apply(self.pivot) - self.eye.world_from_camera.xyz)
        height = 2 * distance * float(tangent(self.eye.fov / 2))  # [m] of what the screen shows there
        return gestures.shifted(before, -down * height * self.plate.normal)

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
        return gestures.slid(before, self.cloud, self.pivot, plate, support.plate, point)


def screen_axes(eye: Eye | None, plate: Plate) -> tuple[np.ndarray, np.ndarray]:
    """(3,), (3,): on a plate, to the right as the browser's camera sees it, and away from it."""
    right = np.array([1.0, 0.0, 0.0]) if eye is None else eye.world_from_camera.rotate([1.0, 0.0, 0.0])
    right = right - float(matmul(right, plate.normal)) * plate.normal
    right = right / max(length(right), 1e-9)
    return right, np.cross(plate.normal, right)
