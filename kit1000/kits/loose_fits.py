"""Search for loose fits: poses of a part, other than its goals, in which a cavity also accepts it.

The part, resting on each of its stable faces in turn, is moved over the kit's height field at all shifts and yaws
(rotations about the insertion axis). The field is the minimum over neighbouring cells, so that the grid misses no fit;
candidates are confirmed by exact contact. In the part's own slot the search finds loose fits, in the slot of a
neighbour it finds parts that would seat in the wrong place. Loose fits just beyond the limits about the goals, between
the yaws of the grid, are found by `insertion_search`. All lengths are metres.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from manifold3d import Manifold

from kit1000.kits.contact import ContactFeatures, ConvexEdges, contact_features, convex_edges, vertical_contact_offset
from kit1000.kits.envelope import lower_envelope
from kit1000.kits.face import RestingFace
from kit1000.kits.goals import nearest_about_axis
from kit1000.kits.insertion_search import HeightField, LoweredPart, lowered_fit
from kit1000.kits.seating import BISECTION_STEP, SEATED_LIMIT, rotation_limit
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.pose import Pose, quaternion_angle
from kit1000.values import Kit, Slot

CELL = 0.5e-3  # [m] of the kit's height field
FINE_CELL = 0.2e-3  # [m] of the field for the search just beyond the limits
UNDERSIDE_CELL = 1.0e-3  # [m] between the points that stand for the part's underside
SHIFT_STEP = 1.0e-3  # [m] between shifts: twice the reach of the minimum over neighbouring cells
YAWS = np.radians(np.arange(0, 360, 5.0))
YAW_BATCHES = 4  # yaws are searched a quarter at a time, widely spaced, so that an easy fit is found early
# A pose nearer to a goal than this and than `rotation_limit` is no other pose; the same for each metre of clearance.
NEAR_GOAL_SHIFT, SHIFT_PER_CLEARANCE = 5e-3, 2.0
TURNED_SHARE = 1.0001  # of the limit: yaw from a goal at which the search just beyond it begins
TURNED_RANGE = np.radians(6)  # a part that seats at a greater yaw also seats at a smaller one, or is found by the grid
BESIDE = 1e-3  # [m] of shift beyond the clearance: a part does not turn about its origin
TRAY_SIDES = np.array([36e-3, 29e-3])  # [m] of a block: most parts, seen along the insertion axis, are no larger
MOST_LIFT = 0.45  # of the depth: the lowest points of a part must be in the cavity
REFINE_STEP = 0.5e-3  # [m] between the shifts tested exactly about a candidate of the grid
REFINED_SHIFTS = REFINE_STEP * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])


class OpenField(NamedTuple):
    """A kit's height field, in which the search moves a part."""

    heights: np.ndarray
    """(nx, ny) float32 [m]"""
    origin: np.ndarray
    """(2,) [m] of the first cell."""
    cell: float
    """[m]"""
    low: np.ndarray
    """(2,) [m] of the smallest rectangle around the cells that are open to half of the depth."""
    high: np.ndarray

    @staticmethod
    def of(heights: np.ndarray, origin: np.ndarray, cell: float, depth: float) -> OpenField:
        """The field of a kit with a cavity of a depth [m]."""
        heights = heights.astype(np.float32)
        cells = np.argwhere(heights < -depth / 2)
        return OpenField(heights, origin, cell, origin + cells.min(0) * cell, origin + cells.max(0) * cell)


class PreparedKit:
    """A kit prepared for the search: its height field and its contact features from above."""

    def __init__(self, kit: Kit) -> None:
        self.slot = kit.slot
        self.features = contact_features(convex_edges(kit.mesh), np.eye(3), np.zeros(3), 1.0)
        self.mesh, field = kit.mesh, HeightField.of(kit.mesh, CELL)
        self.field = OpenField.of(_minimum_filtered(field.heights), field.origin, CELL, kit.slot.depth)

    @cached_property
    def fine_field(self) -> HeightField:
        """Its height field for the search just beyond the limits."""
        return HeightField.of(self.mesh, FINE_CELL)

    @property
    def height_limit(self) -> float:
        """[m] above goal height at which a part still counts as seated."""
        return height_limit(self.slot)


def height_limit(slot: Slot) -> float:
    """[m] above goal height at which a part still counts as seated in a slot."""
    return min(SEATED_LIMIT, slot.depth / 3)


class Candidate(NamedTuple):
    """A pose that the height field allows, with its exact offset to contact."""

    rotation: np.ndarray
    """(3, 3) kit from part."""
    xyz: np.ndarray
    """(3,) [m] of the part's frame, its lowest point on the cavity's floor."""
    contact_offset: float
    """[m] up to contact."""

    @property
    def pose(self) -> Pose:
        """kit_from_part"""
        return Pose.from_rotation_matrix(self.rotation, self.xyz)


class PreparedPart:
    """A part prepared for the search, resting on each of its stable faces."""

    def __init__(self, mesh: Mesh, faces: Sequence[RestingFace]) -> None:
        self.edges = convex_edges(mesh)
        self.resting = [_RestingPart.on(mesh, face) for face in faces]


class _RestingPart(NamedTuple):
    """A part resting on one face, on the plane z = 0."""

    rotation: np.ndarray
    """(3, 3) plane from part."""
    origin_height: float
    """[m] of the part's frame above the plane."""
    underside: np.ndarray
    """(n, 3) [m] points of its underside."""

    @staticmethod
    def on(mesh: Mesh, face: RestingFace) -> _RestingPart:
        rotation = face.plane_from_part.rotation_matrix()
        points = _underside_points(Mesh(matmul(mesh.vertices, rotation.T), mesh.faces))
        low = float(points[:, 2].min())
        return _RestingPart(rotation, -low, points - [0, 0, low])


def find_loose_fit(part: PreparedPart, kit: PreparedKit) -> Pose | None:
    """A kit_from_part pose that is near no goal and seats the part in its own slot, or None."""
    goals, limit = kit.slot.goals.xyz[:, 2], kit.height_limit
    for resting, lift in _faces_near_goals(part, kit.slot):
        for candidate in _candidates(part.edges, resting, kit, lift, away_from_goals=True):
            if np.abs(candidate.xyz[2] + candidate.contact_offset - goals).min() <= limit - BISECTION_STEP:
                return candidate.pose
    return _fit_beyond_goal(part, kit)


def poses_in_own_slot(part: PreparedPart, field: OpenField, slot: Slot) -> Iterator[Pose]:
    """The kit_from_part poses that a height field of the part's own slot allows, its lowest point on the floor."""
    for resting, lift in _faces_near_goals(part, slot):
        for rotation, xyz in _poses_on_floor(resting, field, slot.depth, lift):
            yield Pose.from_rotation_matrix(rotation, xyz)


def _faces_near_goals(part: PreparedPart, slot: Slot) -> Iterator[tuple[_RestingPart, float]]:
    """The part on each face on which it may be at goal height, and how high [m] it may hang above the floor there."""
    goals, limit = slot.goals.xyz[:, 2], height_limit(slot)
    for resting in part.resting:
        if np.abs(goals - (resting.origin_height - slot.depth) - limit / 2).min() > 1.5 * limit:
            continue
        lift = float(goals.max()) + limit - (resting.origin_height - slot.depth)
        yield resting, min(max(lift, limit), MOST_LIFT * slot.depth)


def _fit_beyond_goal(part: PreparedPart, kit: PreparedKit) -> Pose | None:
    """A pose in which the part seats, turned by little more than the limit from the design pose and tilted a little.

    The other goals have the same shadow as the design pose, so the part goes in about each of them alike.
    """
    slot, design = kit.slot, kit.slot.goals[0]
    if turns_freely(slot):
        return None
    goals, limit = slot.goals.xyz[:, 2], kit.height_limit - BISECTION_STEP
    lowered = LoweredPart.of(part.edges, design.rotation_matrix(), slot.depth)
    shift = np.array([0.0, slot.clearance + BESIDE, slot.clearance + BESIDE])
    turned = TURNED_SHARE * near_goal_limits(slot.clearance)[0]
    for sign in (1.0, -1.0):
        yaws = np.sort([sign * turned, sign * (turned + TURNED_RANGE)])
        middle = np.array([0.0, *design.xyz[:2]])
        pose = lowered_fit(
            lowered,
            kit.fine_field,
            kit.features,
            start=middle + [sign * turned, 0.0, 0.0],
            reach=middle + np.stack([-shift, shift]) + np.array([[yaws[0], 0, 0], [yaws[1], 0, 0]]),
            top=float(design.xyz[2]) + limit,
            accepts=lambda height: bool(np.abs(height - goals).min() <= limit),
        )
        if pose is not None and not is_near_goal(pose, slot):
            return pose
    return None


def find_fit_in_other_slot(part: PreparedPart, kit: PreparedKit) -> Pose | None:
    """A kit_from_part pose in which a part rests on the floor of a slot made for another part, or None."""
    for resting in part.resting:
        for candidate in _candidates(part.edges, resting, kit, kit.height_limit):
            if candidate.contact_offset <= kit.height_limit - BISECTION_STEP:
                return candidate.pose
    return None


def accepts_most_parts(kit: PreparedKit) -> bool:
    """Whether a slot is an open tray: even a block as large as most parts rests on its floor."""
    sides = TRAY_SIDES + 2 * kit.slot.clearance
    block = mesh_from_solid(Manifold.cube((*sides, kit.slot.depth), center=True))
    face = RestingFace(np.array([0.0, 0.0, -1.0]), 1.0, kit.slot.depth)
    return find_fit_in_other_slot(PreparedPart(block, [face]), kit) is not None


def turns_freely(slot: Slot) -> bool:
    """Whether a part is at a goal at every yaw: its free axis is the insertion axis."""
    return slot.free_axis is not None and bool(abs(slot.free_axis.direction[2]) > 0.5)


def near_goal_limits(clearance: float) -> tuple[float, float]:
    """The angle [rad] and the shift [m] up to which a pose is near a goal: 10 degrees and 5 mm, more in wide slots.

    clearance: [m] of the slot.
    """
    return rotation_limit(clearance), max(NEAR_GOAL_SHIFT, SHIFT_PER_CLEARANCE * clearance)


def is_near_goal(pose: Pose, slot: Slot, margin: float = 0.0) -> bool:
    """Whether a pose is within both limits of a goal, that of shift widened by a margin [m], up to the free axis."""
    most_angle, most_shift = near_goal_limits(slot.clearance)
    for goal in slot.goals:
        nearest = goal if slot.free_axis is None else nearest_about_axis(pose, goal, slot.free_axis)
        angle = float(quaternion_angle(pose.wxyz, nearest.wxyz))
        if angle < most_angle and length(pose.xyz - nearest.xyz) < most_shift + margin:
            return True
    return False


def _candidates(
    edges: ConvexEdges, resting: _RestingPart, kit: PreparedKit, lift: float, away_from_goals: bool = False
) -> Iterator[Candidate]:
    """Poses of a part on one face that the height field allows, its lowest point on the cavity's floor, and shifts of
    them by REFINE_STEP.

    lift: [m] above the floor at which the height field must be clear.
    away_from_goals: leave out those of which a shift may be near a goal.
    """
    for rotation, middle in _poses_on_floor(resting, kit.field, kit.slot.depth, lift):
        if away_from_goals and is_near_goal(Pose.from_rotation_matrix(rotation, middle), kit.slot, REFINE_STEP):
            continue
        moving = contact_features(edges, rotation, np.zeros(3), -1.0)
        for shift in REFINED_SHIFTS:
            xyz = middle + [*shift, 0]
            shifted = ContactFeatures(moving.vertices + xyz, moving.edges + xyz, moving.faces + xyz)
            yield Candidate(rotation, xyz, vertical_contact_offset(shifted, kit.features))


def _poses_on_floor(
    resting: _RestingPart, field: OpenField, depth: float, lift: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Rotation (3, 3) and shift (3,) [m] of a part on one face, amid all shifts that a height field allows at a yaw."""
    points = resting.underside[resting.underside[:, 2] < depth]
    search = (points, field.heights, *field.origin, field.cell, *field.low, *field.high, depth, lift)
    for batch in range(YAW_BATCHES):
        for yaw, dx, dy in _feasible_shifts(*search, YAWS[batch::YAW_BATCHES]):
            c, s = np.cos(yaw), np.sin(yaw)
            rotation = matmul(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), resting.rotation)
            yield rotation, np.array([dx, dy, resting.origin_height - depth])


def _underside_points(resting: Mesh) -> np.ndarray:
    """(n, 3) [m] the lower envelope on a grid, and all vertices; farthest from the z axis first."""
    heights, corner = lower_envelope(resting, UNDERSIDE_CELL)
    i, j = np.nonzero(np.isfinite(heights))
    grid = np.stack([corner[0] + i * UNDERSIDE_CELL, corner[1] + j * UNDERSIDE_CELL, heights[i, j]], 1)
    points = np.concatenate([grid, resting.vertices])
    order = np.argsort(-np.hypot(points[:, 0], points[:, 1]), kind="stable")
    return np.ascontiguousarray(points[order])


def _minimum_filtered(heights: np.ndarray) -> np.ndarray:
    """The minimum over each cell and its eight neighbours."""
    padded = np.pad(heights, 1)
    rows, columns = heights.shape
    return np.min([padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)], axis=0)


@compiled
def _feasible_shifts(points, heights, x0, y0, cell, low_x, low_y, high_x, high_y, depth, limit, yaws):
    """(k, 3) yaw, dx, dy: for each yaw the mean of all shifts that keep the points above the height field."""
    found = np.empty((yaws.shape[0], 3))
    count = 0
    rotated = np.empty((points.shape[0], 2))
    for yaw in yaws:
        c, s = np.cos(yaw), np.sin(yaw)
        left, right, near, far = np.inf, -np.inf, np.inf, -np.inf
        for p in range(points.shape[0]):
            x, y = c * points[p, 0] - s * points[p, 1], s * points[p, 0] + c * points[p, 1]
            rotated[p, 0], rotated[p, 1] = x, y
            if points[p, 2] < depth / 2 - limit:
                left, right, near, far = min(left, x), max(right, x), min(near, y), max(far, y)
        room_x, room_y = high_x - right - low_x + left, high_y - far - low_y + near
        if not (room_x >= 0 and room_y >= 0):
            continue
        steps_x, steps_y = int(room_x / SHIFT_STEP) + 1, int(room_y / SHIFT_STEP) + 1
        sum_x, sum_y, hits = low_x - left + room_x / 2, low_y - near + room_y / 2, 1
        if _is_clear(points, rotated, heights, x0, y0, cell, sum_x, sum_y, limit - depth):
            steps_x = steps_y = -1  # the middle of the room is enough
        else:
            sum_x, sum_y, hits = 0.0, 0.0, 0
        for i in range(steps_x + 1):
            dx = low_x - left + room_x * i / steps_x
            for j in range(steps_y + 1):
                dy = low_y - near + room_y * j / steps_y
                if _is_clear(points, rotated, heights, x0, y0, cell, dx, dy, limit - depth):
                    sum_x, sum_y, hits = sum_x + dx, sum_y + dy, hits + 1
        if hits:
            found[count, 0], found[count, 1], found[count, 2] = yaw, sum_x / hits, sum_y / hits
            count += 1
    return found[:count]


@compiled
def _is_clear(points, rotated, heights, x0, y0, cell, dx, dy, lift):
    for p in range(points.shape[0]):
        i, j = round((rotated[p, 0] + dx - x0) / cell), round((rotated[p, 1] + dy - y0) / cell)
        if i < 0 or j < 0 or i >= heights.shape[0] or j >= heights.shape[1]:
            continue
        if heights[i, j] > points[p, 2] + lift:
            return False
    return True
