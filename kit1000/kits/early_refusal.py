"""Faces whose kit surely fails a trial, told before any kit is cut: the part seats in a wrong pose all the same.

The kit stands for a height field that nowhere lies below its surface, the part for points of its own that nowhere lie
farther apart than a step. Contact found with both is no lower than contact with the kit, up to that step. So what seats
here seats in the kit. What does not is left to the exact trials. Kit frame; all lengths are metres.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from kit1000.kits.acceptance import wrong_poses_about
from kit1000.kits.cavity import insertion_depth
from kit1000.kits.envelope import grown, lower_envelope, polar_relief
from kit1000.kits.face import RestingFace
from kit1000.kits.goals import MAX_RELIEF_DIFFERENCE, best_yaw
from kit1000.kits.kit import seated_pose
from kit1000.kits.seating import BISECTION_STEP, SEATED_LIMIT
from kit1000.kits.sweep import SAGITTA
from kit1000.mesh import Mesh
from kit1000.numerics.compiled import compiled
from kit1000.numerics.trigonometry import tangent
from kit1000.values import Part

MIN_CELLS, MAX_CELLS = 80, 300  # along the part's longest side
CELLS_PER_CLEARANCE = 5
STEPS_PER_LIMIT = 3  # points this fine leave two thirds of the height below which a part counts as seated
MAX_STEPS = 400  # along the part's longest side: for a part flatter than that nothing is told early
MOST_LEAN = tangent(float(np.radians(20)))  # of the direction in which a tilted part moves
HALF_DIAGONAL = np.sqrt(0.5)  # of a square: no point is farther from the nearest of a grid


def sure_refusal(part: Part, face: RestingFace, clearance: float) -> str | None:
    """Why the kit on a face surely fails the trials, as they would tell it; None when they have to be made."""
    depth, longest = insertion_depth(face.height), float(part.mesh.extents.max())
    limit, design = min(SEATED_LIMIT, depth / 3), seated_pose(part.mesh, face)
    cell = float(np.clip(clearance / CELLS_PER_CLEARANCE, longest / MAX_CELLS, longest / MIN_CELLS))
    step = min(limit / STEPS_PER_LIMIT, cell)
    reach = (clearance - SAGITTA) / cell - HALF_DIAGONAL
    if reach < 1 or step < longest / MAX_STEPS:
        return None
    placed = part.mesh.moved(design)
    heights, corner = lower_envelope(placed, cell, clearance + MOST_LEAN * depth + 4 * cell)
    tops = -grown(np.maximum(-heights, 0.0), reach)
    points = surface_points(part.mesh, step)
    for name, pose in wrong_poses_about(design, clearance):
        moved = pose.apply(points)
        axis = (pose @ design.inverse()).rotate(np.array([0.0, 0.0, 1.0]))
        above = _highest_offset(moved, tops, *corner, cell, *(axis[:2] / axis[2]), depth) + step
        # contact is no lower than where the lowest point of the part is on the floor
        below = -depth - (moved[:, 2].min() + step)
        heights_of_contact = np.array([below, above]) + pose.xyz[2] - design.xyz[2]
        seats = np.abs(heights_of_contact).max() <= limit - BISECTION_STEP
        seats &= max(abs(below), abs(above)) / axis[2] < SEATED_LIMIT - BISECTION_STEP
        if seats and not _may_be_goal(placed, part.mesh.moved(pose), depth):
            return f"seats when {name}"
    return None


def _may_be_goal(design: Mesh, other: Mesh, depth: float) -> bool:
    """Whether a pose looks as the design pose does, at any yaw: then it may be near a goal."""
    relief, _, weights = polar_relief(design, depth)
    return best_yaw(relief, polar_relief(other, depth)[0], weights)[1] < 2 * MAX_RELIEF_DIFFERENCE


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
def _highest_offset(points, tops, x0, y0, cell, lean_x, lean_y, depth):
    """[m] along z that takes points to first contact with columns when they move along (lean_x, lean_y, 1).

    tops: (nx, ny) [m] of the columns, which reach down to -depth; beside them the plate's top is at 0.
    """
    nx, ny = tops.shape
    seen = np.empty((nx, ny))  # the highest point of the columns that is seen along the direction, where it meets z = 0
    seen[:] = -depth
    most = max(abs(lean_x), abs(lean_y))
    down = cell / (2 * most) if most > 1e-9 else np.inf
    for i in range(nx):
        for j in range(ny):
            top = tops[i, j]
            floor = top  # of the lowest of the neighbours: below it the column's side is hidden
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    if 0 <= i + di < nx and 0 <= j + dj < ny:
                        floor = min(floor, tops[i + di, j + dj])
            z = top
            while True:
                p, q = i + int(np.round(-z * lean_x / cell)), j + int(np.round(-z * lean_y / cell))
                if 0 <= p < nx and 0 <= q < ny and seen[p, q] < z:
                    seen[p, q] = z
                z -= down
                if z <= floor:
                    break
    best = -np.inf
    for k in range(points.shape[0]):
        z = points[k, 2]
        if -z <= best:
            continue
        i = int(np.round((points[k, 0] - z * lean_x - x0) / cell))
        j = int(np.round((points[k, 1] - z * lean_y - y0) / cell))
        for di in range(-1, 2):
            for dj in range(-1, 2):
                inside = 0 <= i + di < nx and 0 <= j + dj < ny
                best = max(best, (seen[i + di, j + dj] if inside else 0.0) - z)
    return best
