"""Faces whose kit surely fails a trial, told before any kit is cut: the part seats in a wrong pose all the same.

The kit stands for a height field that nowhere lies below its surface, the part for points of its own that nowhere lie
farther apart than a step. Contact found with both is no lower than contact with the kit, up to that step. So what seats
here seats in the kit. What does not is left to the exact trials. Kit frame; all lengths are metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from kit1000.kits.acceptance import is_goal, wrong_poses
from kit1000.kits.cavity import SAGITTA
from kit1000.kits.height_fields import HeightField, grown, lower_envelope
from kit1000.kits.loose_fits import is_near_goal, poses_in_own_slot
from kit1000.kits.prepared import PreparedPart, height_limit
from kit1000.kits.seating import BISECTION_STEP, SEATED_LIMIT
from kit1000.mesh import Mesh
from kit1000.numerics.compiled import compiled
from kit1000.numerics.trigonometry import tangent
from kit1000.pose import Pose
from kit1000.values import Slot

MIN_CELLS, MAX_CELLS = 80, 600  # of the stand-in along the part's longest side
RESOLUTIONS = (10, 20)  # cells in a clearance, tried in turn: a finer stand-in tells more and takes four times as long
DENSE_FACES = 3000  # of a part, above which cutting its kit takes longer than the second stand-in
STEPS_PER_LIMIT = 6  # points this fine leave five sixths of the height below which a part counts as seated
MAX_STEPS = 800  # along the part's longest side: for a part flatter than that nothing is told early
MOST_LEAN = tangent(float(np.radians(20)))  # of the direction in which a tilted part moves
FEW = 61  # one point in so many is tried first: where the part collides, it mostly tells
ROUNDING = 1e-9  # [m]
HALF_DIAGONAL = np.sqrt(0.5)  # of a square: no point is farther from the nearest of a grid


def sure_refusal(part: PreparedPart, slot: Slot) -> str | None:
    """Why the kit with a slot surely fails the trials; None when they have to be made.

    They may fail for another reason before they come to this one.
    """
    finest = np.inf
    for resolution in RESOLUTIONS if len(part.mesh.faces) > DENSE_FACES else RESOLUTIONS[:1]:
        stand_in = _StandIn.of(part, slot, resolution)
        if stand_in is None or stand_in.cell >= finest:
            return None
        finest, refusal = stand_in.cell, stand_in.refusal()
        if refusal is not None:
            return refusal
    return None


@dataclass(frozen=True, eq=False)
class _StandIn:
    """What stands for a kit and its part: columns of the plate, and points of the part."""

    part: PreparedPart
    slot: Slot
    columns: np.ndarray
    """(nx, ny) [m] heights of their tops, which nowhere lie below the plate's surface, and not below its floor."""
    sides: np.ndarray
    """(nx, ny) [m] the lowest top of a column and its neighbours: below it the column's side is hidden."""
    corner: np.ndarray
    """(2,) [m] centre of the first column."""
    cell: float
    """[m] between columns."""
    step: float
    """[m] every point of the part is within this distance of one that stands for it."""

    @staticmethod
    def of(part: PreparedPart, slot: Slot, resolution: int) -> _StandIn | None:
        """The stand-in with so many cells in a clearance, or None where it is too coarse to tell anything."""
        depth, clearance, longest = slot.depth, slot.clearance, float(part.mesh.extents.max())
        cell = float(np.clip(clearance / resolution, longest / MAX_CELLS, longest / MIN_CELLS))
        step = min(height_limit(slot) / STEPS_PER_LIMIT, cell)
        reach = (clearance - SAGITTA) / cell - HALF_DIAGONAL
        if reach < 1 or step < longest / MAX_STEPS:
            return None
        placed = part.mesh.moved(slot.goals[0])
        heights, corner = lower_envelope(placed, cell, clearance + MOST_LEAN * depth + 4 * cell)
        columns = np.maximum(-grown(np.maximum(-heights, 0.0), reach), -depth)
        return _StandIn(part, slot, columns, _lowest_of_neighbours(columns), corner, cell, step)

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
        """(2,) [m] the least and the most along z to first contact of a part that moves along (*lean, 1).

        Where the most is more than `enough` [m], it is some of what is more.
        """
        points, depth = surface_points(self.part.mesh, self.step), self.slot.depth
        field = (self.columns, self.sides, *self.corner, self.cell)
        limit = enough - self.step + ROUNDING
        most, lowest = _offset_to_contact(points, pose.rotation_matrix(), pose.xyz, *field, *lean, depth, limit)
        # contact is no lower than where the lowest point of the part is on the floor
        return np.array([-depth - lowest - self.step, most + self.step])

    def _height_above(self, goal: float) -> float:
        """[m] up to which a part is at a goal of a height [m]."""
        return goal + height_limit(self.slot) - BISECTION_STEP

    def _is_at_height(self, heights: np.ndarray, goal: float) -> bool:
        return bool(np.abs(heights - goal).max() <= height_limit(self.slot) - BISECTION_STEP)


def _lowest_of_neighbours(columns: np.ndarray) -> np.ndarray:
    """(nx, ny) the least of each cell and its neighbours."""
    padded = np.pad(columns, 1, constant_values=np.inf)
    lines = np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
    return np.minimum(np.minimum(lines[:, :-2], lines[:, 1:-1]), lines[:, 2:])


@lru_cache(maxsize=4)
def surface_points(mesh: Mesh, step: float) -> np.ndarray:
    """(n, 3) [m] points on a mesh: every point of it is within a step of one of them."""
    return _spread(mesh.triangles, step)


@compiled
def _spread(triangles, step):
    """Points on triangles, in rows along the longest side of each: rows and the points in them are a step apart."""
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
def _offset_to_contact(points, rotation, shift, tops, sides, x0, y0, cell, lean_x, lean_y, depth, enough):
    """[m] along z that takes moved points to first contact with columns when they move along (lean_x, lean_y, 1).

    Also returns the height [m] of the lowest point; both of fewer points where the contact is above `enough` [m].
    rotation (3, 3), shift (3,): of the points. tops, sides: (nx, ny) [m] of the columns, which reach down to -depth;
    beside them the plate's top is at 0.
    """
    nx, ny = tops.shape
    seen = tops  # the highest point of the columns that is seen along the direction, where it meets z = 0
    most = max(abs(lean_x), abs(lean_y))
    if most > 1e-9:
        seen = np.empty((nx, ny))
        for i in range(nx):
            for j in range(ny):
                seen[i, j] = -depth
        down, right, ahead = cell / (2 * most), lean_x / cell, lean_y / cell
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
                    best = max(best, (seen[i + di, j + dj] if inside else 0.0) - z)
            if best > enough:
                return best, lowest
    return best, lowest
