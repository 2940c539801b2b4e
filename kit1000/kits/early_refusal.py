"""Early refusal: find out, before a kit is cut, that it surely fails a trial because the part also seats elsewhere.

We replace the kit by columns of a height field that is never below its surface, and the part by sample points of its
surface. If the part seats in this approximation, it also seats in the real kit. If it does not, the exact trials
decide. Kit frame; all lengths are metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kit1000.kits.cavity import SAGITTA
from kit1000.kits.goals import is_goal, is_near_goal
from kit1000.kits.height_fields import HeightField, grown, lower_envelope
from kit1000.kits.loose_fits import poses_in_own_slot
from kit1000.kits.prepared import PreparedPart, height_limit
from kit1000.kits.seating import BISECTION_STEP, SEATED_LIMIT, wrong_poses
from kit1000.numerics.compiled import compiled
from kit1000.numerics.trigonometry import tangent
from kit1000.pose import Pose
from kit1000.values import Slot

DENSE_FACES = 1000  # of a part: with fewer faces, a kit is cut as fast as it is refused early
MIN_CELLS, MAX_CELLS = 80, 600  # of the columns along the part's longest side
CELLS_PER_CLEARANCE = 20  # finer columns find more and take four times as long
STEPS_PER_LIMIT = 6  # points this fine leave five sixths of the height below which a part counts as seated
MAX_STEPS = 800  # along the part's longest side: a part flatter than that is not refused early
MOST_LEAN = tangent(float(np.radians(20)))  # of the direction in which a tilted part moves
FEW = 61  # one point in so many is tried first: if the part collides, it mostly collides there
ROUNDING = 1e-9  # [m]
HALF_DIAGONAL = np.sqrt(0.5)  # of a square: no point is farther from the nearest of a grid


def sure_refusal(part: PreparedPart, slot: Slot) -> str | None:
    """Why the kit with a slot surely fails the trials; None if they have to be made.

    The trials may fail for another reason before they come to this one.
    """
    approximation = _Approximation.of(part, slot) if len(part.mesh.faces) >= DENSE_FACES else None
    return None if approximation is None else approximation.refusal()


@dataclass(frozen=True, eq=False)
class _Approximation:
    """A kit as columns, and a part as points."""

    part: PreparedPart
    slot: Slot
    columns: np.ndarray
    """Heights of their tops, (nx, ny) [m]: nowhere below the plate's surface, and not below its floor."""
    corner: np.ndarray
    """Centre of the first column, (2,) [m]."""
    cell: float
    """Distance between columns [m]."""
    step: float
    """Largest distance from a point of the part to the nearest sample point [m]."""

    @staticmethod
    def of(part: PreparedPart, slot: Slot) -> _Approximation | None:
        """The approximation, or None if it is too coarse to find anything."""
        depth, clearance, longest = slot.depth, slot.clearance, float(part.mesh.extents.max())
        cell = float(np.clip(clearance / CELLS_PER_CLEARANCE, longest / MAX_CELLS, longest / MIN_CELLS))
        step = min(height_limit(slot) / STEPS_PER_LIMIT, cell)
        reach = (clearance - SAGITTA) / cell - HALF_DIAGONAL
        if reach < 1 or step < longest / MAX_STEPS:
            return None
        placed = part.mesh.moved(slot.goals[0])
        heights, corner = lower_envelope(placed, cell, clearance + MOST_LEAN * depth + 4 * cell)
        columns = np.maximum(-grown(np.maximum(-heights, 0.0), reach), -depth)
        return _Approximation(part, slot, columns, corner, cell, step)

    @cached_property
    def points(self) -> np.ndarray:
        """Sample points of the part's surface, (n, 3) [m] in its own frame."""
        return surface_points(self.part.mesh.triangles, self.step)

    @cached_property
    def sides(self) -> np.ndarray:
        """The lowest top of each column and its neighbours, (nx, ny) [m]: below it the column's sides are hidden."""
        padded = np.pad(self.columns, 1, constant_values=np.inf)
        lines = np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
        return np.minimum(np.minimum(lines[:, :-2], lines[:, 1:-1]), lines[:, 2:])

    def refusal(self) -> str | None:
        """Why the kit surely fails the trials, or None."""
        for name, pose in wrong_poses(self.slot):
            if not is_goal(pose, self.slot) and self.seats_from(pose):
                return f"seats when {name}"
        return "loose fit" if self.has_loose_fit() else None

    def seats_from(self, pose: Pose) -> bool:
        """Whether a part that was meant for the design pose surely seats from another one, along its tilted axis."""
        design = self.slot.goals[0]
        axis = (pose @ design.inverse()).rotate(np.array([0.0, 0.0, 1.0]))
        most = min((SEATED_LIMIT - BISECTION_STEP) * axis[2], self._height_above(design.xyz[2]) - pose.xyz[2])
        offsets = self._offsets_to_contact(pose, axis[:2] / axis[2], most)
        is_near = np.abs(offsets).max() / axis[2] < SEATED_LIMIT - BISECTION_STEP
        return bool(is_near and self._is_at_height(offsets + pose.xyz[2], design.xyz[2]))

    def has_loose_fit(self) -> bool:
        """Whether the part surely seats in a pose that is near no goal, resting on one of its faces."""
        field = HeightField(self.columns.astype(np.float32), self.corner, self.cell, self.slot.depth)
        highest = self._height_above(float(self.slot.goals.xyz[:, 2].max()))
        for pose in poses_in_own_slot(self.part, field, self.slot):
            if is_near_goal(pose, self.slot):
                continue
            heights = self._offsets_to_contact(pose, np.zeros(2), highest - pose.xyz[2]) + pose.xyz[2]
            if any(self._is_at_height(heights, z) for z in self.slot.goals.xyz[:, 2]):
                return True
        return False

    def _offsets_to_contact(self, pose: Pose, lean: np.ndarray, enough: float) -> np.ndarray:
        """The least and the greatest possible offset along z to first contact, (2,) [m].

        lean: the part moves along (*lean, 1).
        enough: a contact above it is not searched to its end [m].
        """
        depth, field = self.slot.depth, (self.corner[0], self.corner[1], self.cell)
        tops = self.columns
        if np.abs(lean).max() > 1e-9:
            tops = _sheared(self.columns, self.sides, self.cell, *lean, depth)
        moved = (self.points, pose.rotation_matrix(), pose.xyz)
        most, lowest = _first_contact(*moved, tops, *field, *lean, enough - self.step + ROUNDING)
        # contact is no lower than where the lowest point of the part is on the floor
        return np.array([-depth - lowest - self.step, most + self.step])

    def _height_above(self, goal: float) -> float:
        """The height up to which a part is at a goal of a height [m]."""
        return goal + height_limit(self.slot) - BISECTION_STEP

    def _is_at_height(self, heights: np.ndarray, goal: float) -> bool:
        return bool(np.abs(heights - goal).max() <= height_limit(self.slot) - BISECTION_STEP)


@compiled
def surface_points(triangles, step):
    """(n, 3) points on triangles (m, 3, 3), in rows along the longest side of each.

    Rows and the points in them are at most a step apart.
    """
    points = np.empty((1024, 3))
    count = 0
    for t in range(triangles.shape[0]):
        longest, first = -1.0, 0
        for k in range(3):
            length = 0.0
            for i in range(3):
                length += (triangles[t, (k + 1) % 3, i] - triangles[t, k, i]) ** 2
            if length > longest:
                longest, first = length, k
        longest = np.sqrt(longest)
        a, b, c = first, (first + 1) % 3, (first + 2) % 3
        along, side = 0.0, 0.0
        for i in range(3):
            to_top = triangles[t, c, i] - triangles[t, a, i]
            along += to_top * (triangles[t, b, i] - triangles[t, a, i]) / max(longest, 1e-12)
            side += to_top * to_top
        rows = int(np.ceil(np.sqrt(max(side - along * along, 0.0)) / step))
        for row in range(rows + 1):
            up = row / max(rows, 1)
            columns = int(np.ceil((1 - up) * longest / step))
            if count + columns + 1 > points.shape[0]:
                larger = np.empty((2 * (count + columns + 1), 3))
                larger[:count] = points[:count]
                points = larger
            for column in range(columns + 1):
                share = column / max(columns, 1)
                for i in range(3):
                    start = triangles[t, a, i] + up * (triangles[t, c, i] - triangles[t, a, i])
                    end = triangles[t, b, i] + up * (triangles[t, c, i] - triangles[t, b, i])
                    points[count, i] = start + share * (end - start)
                count += 1
    return points[:count].copy()


@compiled
def _sheared(tops, sides, cell, lean_x, lean_y, depth):
    """(nx, ny) the highest point of the columns that is seen along (lean_x, lean_y, 1), where that line meets z = 0.

    tops, sides: (nx, ny) of the columns, which reach down to -depth.
    """
    nx, ny = tops.shape
    seen = np.full((nx, ny), -depth)
    down, right, ahead = cell / (2 * max(abs(lean_x), abs(lean_y))), lean_x / cell, lean_y / cell
    for i in range(nx):
        for j in range(ny):
            z = tops[i, j]
            while z > -depth:
                p, q = i + round(-z * right), j + round(-z * ahead)
                if 0 <= p < nx and 0 <= q < ny and seen[p, q] < z:
                    seen[p, q] = z
                z -= down
                if z <= sides[i, j]:
                    break
    return seen


@compiled
def _first_contact(points, rotation, shift, tops, x0, y0, cell, lean_x, lean_y, enough):
    """The offset along z that takes moved points to first contact with columns, and the height of the lowest point.

    rotation (3, 3), shift (3,): of the points. tops: (nx, ny) of the columns, sheared if the points move along
    (lean_x, lean_y, 1); beside them the top of the plate is at 0. Both results are those of fewer points if the contact
    is above `enough`.
    """
    nx, ny = tops.shape
    best, lowest = -np.inf, np.inf
    for every in (FEW, 1):
        for k in range(0, points.shape[0], every):
            u, v, w = points[k, 0], points[k, 1], points[k, 2]
            z = rotation[2, 0] * u + rotation[2, 1] * v + rotation[2, 2] * w + shift[2]
            lowest = min(lowest, z)
            if -z <= best:
                continue
            x = rotation[0, 0] * u + rotation[0, 1] * v + rotation[0, 2] * w + shift[0]
            y = rotation[1, 0] * u + rotation[1, 1] * v + rotation[1, 2] * w + shift[1]
            i = round((x - z * lean_x - x0) / cell)
            j = round((y - z * lean_y - y0) / cell)
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    inside = 0 <= i + di < nx and 0 <= j + dj < ny
                    best = max(best, (tops[i + di, j + dj] if inside else 0.0) - z)
            if best > enough:
                return best, lowest
    return best, lowest
