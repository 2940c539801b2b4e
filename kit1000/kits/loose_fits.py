"""Stray fits: poses of a part, other than its goals, that a cavity also accepts.

A part lying on any of its stable faces is turned and shifted over the cavity's height field (optimistic by one cell,
so that no fit is missed on the grid); what gets through is judged exactly. Run against the part's own slot this finds
loose fits; against a neighbour's slot it finds parts that would seat in the wrong place. All lengths are metres.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from manifold3d import Manifold

from kit1000.compiled import compiled
from kit1000.kits.contact import ContactFeatures, ConvexEdges, vertical_contact_offset, contact_features, convex_edges
from kit1000.kits.envelope import lower_envelope
from kit1000.kits.face import RestingFace
from kit1000.kits.goals import nearest_turn
from kit1000.kits.seating import BISECTION_STEP, SEATED_LIMIT
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pose import Pose, quaternion_angle
from kit1000.values import Kit, Slot

CELL = 0.5e-3  # [m] of the cavity's height field
UNDERSIDE_CELL = 1.0e-3  # [m] between the part's felt points
SHIFT_STEP = 1.0e-3  # [m] between shifts: twice the optimism of the height field
YAWS = np.radians(np.arange(0, 360, 5.0))
YAW_BATCHES = 4  # turns are looked at a quarter at a time, widely spaced, so that an easy fit is soon found
APART_ANGLE, APART_SHIFT = np.radians(10), 5e-3  # a pose this far from every goal is another pose
TRAY_SIDES = np.array([36e-3, 29e-3])  # [m] sides of the shadow that makes an open tray
REFINE_STEP = 0.5e-3  # [m] shifts tried exactly about a fit found on the grid
REFINED_SHIFTS = REFINE_STEP * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])


class PreparedKit:
    """A kit made ready for stray parts: its height field seen from above, and what of it can be touched."""

    def __init__(self, kit: Kit) -> None:
        self.slot = kit.slot
        self.seen = contact_features(convex_edges(kit.mesh), np.eye(3), np.zeros(3), 1.0)
        upside = Mesh(kit.mesh.vertices * [1, 1, -1], kit.mesh.faces[:, ::-1])
        heights, self.corner = lower_envelope(upside, CELL)
        self.heights = _minimum_filtered(np.where(np.isfinite(heights), -heights, 0.0)).astype(np.float32)
        open_cells = np.argwhere(self.heights < -kit.slot.depth / 2)
        self.low = self.corner + open_cells.min(0) * CELL
        self.high = self.corner + open_cells.max(0) * CELL

    @property
    def limit(self) -> float:
        """[m] above the floor at which a part still counts as seated."""
        return min(SEATED_LIMIT, self.slot.depth / 3)


class Candidate(NamedTuple):
    """A part in an upright well, with its exact rise to contact."""

    rotation: np.ndarray
    """(3, 3) kit from part."""
    xyz: np.ndarray
    """(3,) [m] of the part's frame, its lowest point on the cavity's floor."""
    rise: float
    """[m]"""

    @property
    def pose(self) -> Pose:
        """kit_from_part"""
        return Pose.from_rotation_matrix(self.rotation, self.xyz)


class PreparedPart:
    """A part made ready to be held over wells, lying on each of its stable faces."""

    def __init__(self, mesh: Mesh, faces: Sequence[RestingFace]) -> None:
        self.body = convex_edges(mesh)
        self.lying = [_RestingPart.on(mesh, face) for face in faces]


class _RestingPart(NamedTuple):
    """A part on one face."""

    rotation: np.ndarray
    """(3, 3) that lays it so."""
    anchor: float
    """[m] of the part's frame above the plane it lies on."""
    points: np.ndarray
    """(n, 3) [m] felt points of its underside, the plane at z = 0."""

    @staticmethod
    def on(mesh: Mesh, face: RestingFace) -> _RestingPart:
        rotation = face.plane_from_part.rotation_matrix()
        points = _underside_points(Mesh(mesh.vertices @ rotation.T, mesh.faces))
        low = float(points[:, 2].min())
        return _RestingPart(rotation, -low, points - [0, 0, low])


def loose_fit(stray: PreparedPart, well: PreparedKit) -> Pose | None:
    """A kit_from_part pose in which the part seats in its own slot though it is at none of its goals, or None."""
    goals = well.slot.goals.xyz[:, 2]
    for lying in stray.lying:
        if np.abs(goals - (lying.anchor - well.slot.depth) - well.limit / 2).min() > 1.5 * well.limit:
            continue
        for fit in _candidates(stray.body, lying, well, elsewhere=True):
            if np.abs(fit.xyz[2] + fit.rise - goals).min() <= well.limit - BISECTION_STEP:
                return fit.pose
    return None


def fit_in_other_slot(stray: PreparedPart, well: PreparedKit) -> Pose | None:
    """A kit_from_part pose in which a part rests on the floor of a slot made for another part, or None."""
    for lying in stray.lying:
        for fit in _candidates(stray.body, lying, well):
            if fit.rise <= well.limit - BISECTION_STEP:
                return fit.pose
    return None


def accepts_most_parts(well: PreparedKit) -> bool:
    """Whether a slot is an open tray: even a block as large as most parts rests on its floor."""
    sides = TRAY_SIDES + 2 * well.slot.clearance
    block = mesh_from_solid(Manifold.cube((*sides, well.slot.depth), center=True))
    return fit_in_other_slot(PreparedPart(block, [RestingFace(np.array([0.0, 0.0, -1.0]), 1.0, well.slot.depth)]), well) is not None


def near_goal(pose: Pose, slot: Slot, shift: float = APART_SHIFT) -> bool:
    """Whether a pose is within 10 degrees and 5 mm (or another shift [m]) of a goal."""
    for goal in slot.goals:
        turned = goal if slot.free_axis is None else nearest_turn(pose, goal, slot.free_axis)
        angle = float(quaternion_angle(pose.wxyz, turned.wxyz))
        if angle < APART_ANGLE and np.linalg.norm(pose.xyz - turned.xyz) < shift:
            return True
    return False


def _candidates(body: ConvexEdges, lying: _RestingPart, well: PreparedKit, elsewhere: bool = False) -> Iterator[Candidate]:
    """Poses on one face, lowest point on the cavity's floor, that the height field lets through, nudged.

    elsewhere: leave out those that a nudge may leave near a goal.
    """
    depth, points = well.slot.depth, lying.points[lying.points[:, 2] < well.slot.depth]
    bounds = (*well.corner, *well.low, *well.high)
    for batch in range(YAW_BATCHES):
        for turn, dx, dy in _feasible_shifts(points, well.heights, *bounds, depth, well.limit, YAWS[batch::YAW_BATCHES]):
            c, s = np.cos(turn), np.sin(turn)
            rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ lying.rotation
            amid = np.array([dx, dy, lying.anchor - depth])
            if elsewhere and near_goal(Pose.from_rotation_matrix(rotation, amid), well.slot, APART_SHIFT + REFINE_STEP):
                continue
            moving = contact_features(body, rotation, np.zeros(3), -1.0)
            for nudge in REFINED_SHIFTS:
                xyz = amid + [*nudge, 0]
                shifted = ContactFeatures(moving.corners + xyz, moving.edges + xyz, moving.faces + xyz)
                yield Candidate(rotation, xyz, vertical_contact_offset(shifted, well.seen))


def _underside_points(lying: Mesh) -> np.ndarray:
    """(n, 3) points of the underside: a grid of its lower envelope and its corners, farthest from the middle first."""
    heights, corner = lower_envelope(lying, UNDERSIDE_CELL)
    i, j = np.nonzero(np.isfinite(heights))
    grid = np.stack([corner[0] + i * UNDERSIDE_CELL, corner[1] + j * UNDERSIDE_CELL, heights[i, j]], 1)
    points = np.concatenate([grid, lying.vertices])
    order = np.argsort(-np.hypot(points[:, 0], points[:, 1]), kind="stable")
    return np.ascontiguousarray(points[order])


def _minimum_filtered(heights: np.ndarray) -> np.ndarray:
    """The lowest of each cell and its eight neighbours."""
    padded = np.pad(heights, 1)
    rows, columns = heights.shape
    return np.min([padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)], axis=0)


@compiled
def _feasible_shifts(points, heights, x0, y0, low_x, low_y, high_x, high_y, depth, limit, turns):
    """(k, 3) turn, dx, dy: for each turn the shift amid all those at which no felt point meets the height field."""
    found = np.empty((turns.shape[0], 3))
    count = 0
    spun = np.empty((points.shape[0], 2))
    for turn in turns:
        c, s = np.cos(turn), np.sin(turn)
        left, right, near, far = np.inf, -np.inf, np.inf, -np.inf
        for p in range(points.shape[0]):
            x, y = c * points[p, 0] - s * points[p, 1], s * points[p, 0] + c * points[p, 1]
            spun[p, 0], spun[p, 1] = x, y
            if points[p, 2] < depth / 2 - limit:
                left, right, near, far = min(left, x), max(right, x), min(near, y), max(far, y)
        room_x, room_y = high_x - right - low_x + left, high_y - far - low_y + near
        if not (room_x >= 0 and room_y >= 0):
            continue
        steps_x, steps_y = int(room_x / SHIFT_STEP) + 1, int(room_y / SHIFT_STEP) + 1
        sum_x, sum_y, hits = low_x - left + room_x / 2, low_y - near + room_y / 2, 1
        if _is_clear(points, spun, heights, x0, y0, sum_x, sum_y, limit - depth):
            steps_x = steps_y = -1  # the middle of the room will do
        else:
            sum_x, sum_y, hits = 0.0, 0.0, 0
        for i in range(steps_x + 1):
            dx = low_x - left + room_x * i / steps_x
            for j in range(steps_y + 1):
                dy = low_y - near + room_y * j / steps_y
                if _is_clear(points, spun, heights, x0, y0, dx, dy, limit - depth):
                    sum_x, sum_y, hits = sum_x + dx, sum_y + dy, hits + 1
        if hits:
            found[count, 0], found[count, 1], found[count, 2] = turn, sum_x / hits, sum_y / hits
            count += 1
    return found[:count]


@compiled
def _is_clear(points, spun, heights, x0, y0, dx, dy, lift):
    for p in range(points.shape[0]):
        i, j = round((spun[p, 0] + dx - x0) / CELL), round((spun[p, 1] + dy - y0) / CELL)
        if i < 0 or j < 0 or i >= heights.shape[0] or j >= heights.shape[1]:
            continue
        if heights[i, j] > points[p, 2] + lift:
            return False
    return True
