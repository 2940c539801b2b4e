"""Search for loose fits: poses of a part, other than its goals, in which a cavity also accepts it.

The part rests on each of its stable faces in turn and is moved over the kit's height field at all shifts and yaws
(rotations about the insertion axis). Exact contact confirms the candidates. In the part's own slot the search finds
loose fits; in the slot of a neighbour it finds parts that would seat in the wrong place.

A second search lowers the part into its own slot just beyond the limits about a goal, between the yaws of the grid. It
turns, shifts and tilts the part as an attacker would. A pattern search lowers the overlap: the part is held at the
greatest height at which it counts as seated, and the depths of the points of its underside below the kit's height field
are added up. If the overlap nearly vanishes, the same search lowers the exact height of contact.

Kit frame; metres and radians.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from manifold3d import Manifold

from kit1000.kits.contact import ContactFeatures, contact_features, vertical_contact_offset
from kit1000.kits.face import RestingFace
from kit1000.kits.goals import is_near_goal, near_goal_limits
from kit1000.kits.height_fields import HeightField
from kit1000.kits.prepared import PreparedKit, PreparedPart, RestingPart, underside_points
from kit1000.kits.seating import BISECTION_STEP
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import matmul
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.pose import Pose
from kit1000.values import Slot

YAWS = np.radians(np.arange(0, 360, 5.0))
TURNS = np.stack([cosine(YAWS), sine(YAWS)], 1)
YAW_BATCHES = 4  # yaws are searched a quarter at a time, widely spaced, so that an easy fit is found early
SHIFT_STEP = 1.0e-3  # [m] between shifts: twice the reach of the minimum over neighbouring cells
REFINE_STEP = 0.5e-3  # [m] between the shifts tested exactly about a candidate of the grid
REFINED_SHIFTS = REFINE_STEP * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
MOST_LIFT = 0.45  # of the depth: the lowest points of a part must be in the cavity
TRAY_SIDES = np.array([36e-3, 29e-3])  # [m] of a block: most parts, seen along the insertion axis, are no larger

# The search just beyond the limits about a goal. Its state is (yaw, x, y, tilt about x, tilt about y).
TURNED_SHARE = 1.0001  # of the limit: yaw from a goal at which the search begins
TURNED_RANGE = np.radians(6)  # a part that seats at a greater yaw also seats at a smaller one, or is found by the grid
BESIDE = 1e-3  # [m] of shift beyond the clearance: a part does not turn about its origin
MOST_TILT = np.radians(5)  # of a part that goes in upright; tilted farther it is jammed
TILT_STARTS = np.radians([(0.0, 0.0), (3.0, 0.0), (-3.0, 0.0), (0.0, 3.0), (0.0, -3.0)])
FIRST_STEPS = np.array([np.radians(1.0), 0.5e-3, 0.5e-3, np.radians(1.0), np.radians(1.0)])  # of the state
HALVINGS = 3  # of the steps, when none of them leads lower
EDGE_SPACING = 1.0e-3  # [m] between points on the part's convex edges
MARGIN = 3e-3  # [m] above the rim: points of the part that lie higher touch nothing
DEEPEST = 3e-3  # [m] of overlap of one point: a deeper one collides in any case
NEARLY_CLEAR = 5e-3  # [m] of summed overlap: the height field may err by as much, exact contact decides
TRIED_EXACTLY = 2  # of the poses that the starts lead to, those of least overlap
EXACT_TRIALS = 16  # exact contacts of one pose
TRIG_SCALE = 2.0**40  # sines and cosines are rounded to its inverse, so that their last bits decide nothing
LENGTH_SCALE = 1e9  # overlaps and heights are compared in whole nanometres


def find_loose_fit(part: PreparedPart, kit: PreparedKit) -> Pose | None:
    """A kit_from_part pose that is near no goal and seats the part in its own slot, or None."""
    goals, depth, limit = kit.slot.goals.xyz[:, 2], kit.slot.depth, kit.height_limit
    for resting in part.resting:
        height = resting.origin_height - depth  # of the part, its lowest point on the floor
        if np.abs(goals - height - limit / 2).min() > 1.5 * limit:
            continue  # at no goal's height
        highest = float(goals.max()) + limit - height
        lift = min(max(highest, limit), MOST_LIFT * depth)
        for rotation, xyz, offset in _candidates(part.mesh, resting, kit, lift, highest, away_from_goals=True):
            if np.abs(xyz[2] + offset - goals).min() <= limit - BISECTION_STEP:
                return Pose.from_rotation_matrix(rotation, xyz)
    return _fit_beyond_goal(part.mesh, kit)


def seats_in_other_slot(pairs: Sequence[tuple[PreparedPart, PreparedKit]]) -> bool:
    """Whether some part rests on the floor of a slot made for another part, of pairs (part, kit)."""
    batches = product(range(YAW_BATCHES), pairs)  # a quarter of the yaws decides most pairs with a fit
    return any(find_fit_in_other_slot(part, kit, [batch]) is not None for batch, (part, kit) in batches)


def find_fit_in_other_slot(
    part: PreparedPart, kit: PreparedKit, batches: Sequence[int] = range(YAW_BATCHES)
) -> Pose | None:
    """A kit_from_part pose in which a part rests on the floor of a slot made for another part, or None.

    batches: of yaws to search.
    """
    highest = kit.height_limit - BISECTION_STEP
    for resting in part.resting:
        for rotation, xyz, offset in _candidates(part.mesh, resting, kit, kit.height_limit, highest, batches=batches):
            if offset <= highest:
                return Pose.from_rotation_matrix(rotation, xyz)
    return None


def accepts_most_parts(kit: PreparedKit) -> bool:
    """Whether a slot is an open tray: even a block as large as most parts rests on its floor."""
    sides = TRAY_SIDES + 2 * kit.slot.clearance
    block = PreparedPart(mesh_from_solid(Manifold.cube((*sides, kit.slot.depth), center=True)))
    block.faces = [RestingFace(np.array([0.0, 0.0, -1.0]), 1.0, kit.slot.depth)]
    return find_fit_in_other_slot(block, kit) is not None


def turns_freely(slot: Slot) -> bool:
    """Whether a part is at a goal at every yaw: its free axis is the insertion axis."""
    return slot.free_axis is not None and bool(abs(slot.free_axis.direction[2]) > 0.5)


def _candidates(
    mesh: Mesh,
    resting: RestingPart,
    kit: PreparedKit,
    lift: float,
    highest: float,
    *,
    away_from_goals: bool = False,
    batches: Sequence[int] = range(YAW_BATCHES),
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Poses of a part on one face that the height field allows, and shifts of each by REFINE_STEP; with their offsets.

    A pose is a rotation (3, 3), kit from part, and a position (3,) [m]; the part's lowest point is on the floor. The
    offset takes it up to contact [m].

    Args:
        mesh: of the part.
        resting: the part on the face.
        kit: the kit.
        lift: height above the floor at which the height field must be clear [m].
        highest: contact above it is not searched to its end [m].
        away_from_goals: leave out a pose if one of its shifts may be near a goal.
        batches: of yaws to search.
    """
    for rotation, middle in _poses_on_floor(resting, kit.field, lift, batches):
        if away_from_goals and is_near_goal(Pose.from_rotation_matrix(rotation, middle), kit.slot, REFINE_STEP):
            continue
        moving = contact_features(mesh, rotation, np.zeros(3), -1.0)
        for shift in REFINED_SHIFTS:
            xyz = middle + [*shift, 0]
            shifted = ContactFeatures(moving.vertices + xyz, moving.edges + xyz, moving.faces + xyz)
            yield rotation, xyz, vertical_contact_offset(shifted, kit.features, highest)


def _poses_on_floor(
    resting: RestingPart, field: HeightField, lift: float, batches: Sequence[int] = range(YAW_BATCHES)
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """For each yaw with a shift that a height field allows: rotation (3, 3) and the mean of these shifts (3,) [m]."""
    points = resting.underside[resting.underside[:, 2] < field.depth]
    low, high = field.opening
    search = (points, field.heights, *field.origin, field.cell, *low, *high, field.depth, lift)
    for batch in batches:
        turns = TURNS[batch::YAW_BATCHES]
        for k, dx, dy in _feasible_shifts(*search, turns):
            c, s = turns[int(k)]
            rotation = matmul(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), resting.rotation)
            yield rotation, np.array([dx, dy, resting.origin_height - field.depth])


@compiled
def _feasible_shifts(points, heights, x0, y0, cell, low_x, low_y, high_x, high_y, depth, limit, turns):
    """(k, 3) index of the turn, dx, dy: for each turn the mean of all shifts that keep the points above the field.

    turns: (n, 2) cosine and sine of the yaw.
    """
    found = np.empty((turns.shape[0], 3))
    count, hit = 0, 0
    rotated = np.empty((points.shape[0], 2))
    for k in range(turns.shape[0]):
        c, s = turns[k]
        left, right, near, far = np.inf, -np.inf, np.inf, -np.inf
        for p in range(points.shape[0]):
            if points[p, 2] < depth / 2 - limit:
                x, y = c * points[p, 0] - s * points[p, 1], s * points[p, 0] + c * points[p, 1]
                left, right, near, far = min(left, x), max(right, x), min(near, y), max(far, y)
        room_x, room_y = high_x - right - low_x + left, high_y - far - low_y + near
        if not (room_x >= 0 and room_y >= 0):
            continue
        for p in range(points.shape[0]):
            rotated[p, 0] = c * points[p, 0] - s * points[p, 1]
            rotated[p, 1] = s * points[p, 0] + c * points[p, 1]
        steps_x, steps_y = int(room_x / SHIFT_STEP) + 1, int(room_y / SHIFT_STEP) + 1
        sum_x, sum_y, hits = low_x - left + room_x / 2, low_y - near + room_y / 2, 1
        hit = _collision(points, rotated, heights, x0, y0, cell, sum_x, sum_y, limit - depth, hit)
        if hit < 0:
            steps_x = steps_y = -1  # the middle of the room is enough
        else:
            sum_x, sum_y, hits = 0.0, 0.0, 0
        for i in range(steps_x + 1):
            dx = low_x - left + room_x * i / steps_x
            for j in range(steps_y + 1):
                dy = low_y - near + room_y * j / steps_y
                hit = _collision(points, rotated, heights, x0, y0, cell, dx, dy, limit - depth, hit)
                if hit < 0:
                    sum_x, sum_y, hits = sum_x + dx, sum_y + dy, hits + 1
        if hits:
            found[count, 0], found[count, 1], found[count, 2] = k, sum_x / hits, sum_y / hits
            count += 1
    return found[:count]


@compiled
def _collision(points, rotated, heights, x0, y0, cell, dx, dy, lift, last):
    """Index of a point below the height field, -1 if there is none; the `last` one found is tried first."""
    for n in range(-1 if last >= 0 else 0, points.shape[0]):
        p = last if n < 0 else n
        i, j = round((rotated[p, 0] + dx - x0) / cell), round((rotated[p, 1] + dy - y0) / cell)
        if i < 0 or j < 0 or i >= heights.shape[0] or j >= heights.shape[1]:
            continue
        if heights[i, j] > points[p, 2] + lift:
            return p
    return -1


def _fit_beyond_goal(mesh: Mesh, kit: PreparedKit) -> Pose | None:
    """A pose in which the part seats, turned by little more than the limit from the design pose and tilted a little.

    The other goals have the same shadow as the design pose, so the part goes in about each of them alike.
    """
    slot, design, field = kit.slot, kit.slot.goals[0], kit.fine_field
    if turns_freely(slot):
        return None
    goals, limit = slot.goals.xyz[:, 2], kit.height_limit - BISECTION_STEP
    base = design.rotation_matrix()
    grid = (_low_points(mesh, base, slot.depth), field.heights, *field.origin, field.cell, float(design.xyz[2]) + limit)
    beside, turned = slot.clearance + BESIDE, TURNED_SHARE * near_goal_limits(slot.clearance)[0]
    for sign in (1.0, -1.0):
        start = np.array([sign * turned, *design.xyz[:2]])
        yaws = sorted((start[0], sign * (turned + TURNED_RANGE)))
        low = np.array([yaws[0], *(start[1:] - beside), -MOST_TILT, -MOST_TILT])
        high = np.array([yaws[1], *(start[1:] + beside), MOST_TILT, MOST_TILT])
        found = [_least_overlap(*grid, np.concatenate([start, tilt]), low, high) for tilt in TILT_STARTS]
        for state, overlap in sorted(found, key=lambda pair: pair[1])[:TRIED_EXACTLY]:
            if overlap > NEARLY_CLEAR:
                break
            pose = _exact_fit(mesh, base, kit.features, state, low, high, goals, limit)
            if pose is None:
                continue
            if not is_near_goal(pose, slot):
                return pose
            break
    return None


def _low_points(mesh: Mesh, base: np.ndarray, depth: float) -> np.ndarray:
    """Points of the part's underside and of its convex edges that can touch a kit, (n, 3) [m] from the part's origin.

    base: (3, 3) kit from part. The part is lowered into a cavity of a depth [m].
    """
    vertices = matmul(mesh.vertices, base.T)
    points = underside_points(Mesh(vertices, mesh.faces), _points_on(vertices[mesh.convex_edges[0]]))
    return points[points[:, 2] < vertices[:, 2].min() + depth + MARGIN]


def _exact_fit(
    mesh: Mesh,
    base: np.ndarray,
    kit: ContactFeatures,
    state: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    goals: np.ndarray,
    limit: float,
) -> Pose | None:
    """The first pose of a pattern search for the lowest contact that touches within a limit [m] of a goal's height.

    base: (3, 3) kit from part. goals: (n,) their heights [m].
    """

    def height(state: np.ndarray, enough: float) -> tuple[float, np.ndarray]:
        rotation = matmul(turned_matrix(state[0], state[3], state[4]), base)
        features = contact_features(mesh, rotation, np.array([state[1], state[2], 0.0]), -1.0)
        offset = vertical_contact_offset(features, kit, enough + 1 / LENGTH_SCALE)
        return np.round(offset * LENGTH_SCALE) / LENGTH_SCALE, rotation

    def accepts(height: float) -> bool:
        return bool(np.abs(height - goals).min() <= limit)

    best, rotation = height(state, np.inf)
    steps, trials, found = FIRST_STEPS / 2, 1, True
    while not accepts(best) and trials < EXACT_TRIALS:
        found = False
        for k in range(5):
            for sign in (1.0, -1.0):
                other = state.copy()
                other[k] += sign * steps[k]
                if accepts(best) or not (low[k] <= other[k] <= high[k]) or np.hypot(*other[3:]) > MOST_TILT:
                    continue
                trials += 1
                lower, turned = height(other, best)
                if lower < best:
                    state, best, rotation, found = other, lower, turned, True
        if not found:
            steps = steps / 2
    return Pose.from_rotation_matrix(rotation, [state[1], state[2], best]) if accepts(best) else None


def _points_on(edges: np.ndarray) -> np.ndarray:
    """(n, 3) [m] points inside edges (k, 2, 3), at most EDGE_SPACING apart."""
    along = edges[:, 1] - edges[:, 0]
    counts = np.ceil(np.sqrt(matmul(along**2, np.ones(3))) / EDGE_SPACING).astype(int) - 1
    counts = np.maximum(counts, 0)
    edge = np.repeat(np.arange(len(edges)), counts)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    return edges[edge, 0] + ((number + 1) / (counts[edge] + 1))[:, None] * along[edge]


@compiled
def turned_matrix(yaw, tilt_x, tilt_y):
    """(3, 3) a yaw and then a rotation by the vector (tilt_x, tilt_y, 0) [rad]; entries rounded."""
    c, s = round(np.cos(yaw) * TRIG_SCALE) / TRIG_SCALE, round(np.sin(yaw) * TRIG_SCALE) / TRIG_SCALE
    angle = np.sqrt(tilt_x * tilt_x + tilt_y * tilt_y)
    if angle == 0.0:
        return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    x, y = tilt_x / angle, tilt_y / angle
    d, e = round(np.cos(angle) * TRIG_SCALE) / TRIG_SCALE, round(np.sin(angle) * TRIG_SCALE) / TRIG_SCALE
    xx, xy, yy = d + (1 - d) * x * x, (1 - d) * x * y, d + (1 - d) * y * y
    return np.array(
        (
            (xx * c + xy * s, -xx * s + xy * c, e * y),
            (xy * c + yy * s, -xy * s + yy * c, -e * x),
            (-e * y * c + e * x * s, e * y * s + e * x * c, d),
        )
    )


@compiled
def _overlap(points, heights, x0, y0, cell, top, state, most):
    """The depths of the points below the height field, added up [m]; stops when the sum reaches `most`."""
    turned, total = turned_matrix(state[0], state[3], state[4]), 0.0
    for p in range(points.shape[0]):
        a, b, c = points[p]
        x = turned[0, 0] * a + turned[0, 1] * b + turned[0, 2] * c + state[1]
        y = turned[1, 0] * a + turned[1, 1] * b + turned[1, 2] * c + state[2]
        i, j = round((x - x0) / cell), round((y - y0) / cell)
        if i < 0 or j < 0 or i >= heights.shape[0] or j >= heights.shape[1]:
            continue
        deep = heights[i, j] - (turned[2, 0] * a + turned[2, 1] * b + turned[2, 2] * c + top)
        if deep > 0.0:
            total += min(deep, DEEPEST)
            if total >= most:
                break
    return round(total * LENGTH_SCALE) / LENGTH_SCALE


@compiled
def _least_overlap(points, heights, x0, y0, cell, top, start, low, high):
    """The state (5,) of least overlap that a pattern search finds from the best shift of a grid, and its overlap."""
    best, least = start.copy(), _overlap(points, heights, x0, y0, cell, top, start, np.inf)
    steps_x, steps_y = int((high[1] - low[1]) / SHIFT_STEP + 0.5), int((high[2] - low[2]) / SHIFT_STEP + 0.5)
    state = start.copy()
    for i in range(steps_x + 1):
        for j in range(steps_y + 1):
            state[1], state[2] = low[1] + i * SHIFT_STEP, low[2] + j * SHIFT_STEP
            overlap = _overlap(points, heights, x0, y0, cell, top, state, least)
            if overlap < least:
                best, least = state.copy(), overlap
    steps, halvings = FIRST_STEPS.copy(), 0
    while halvings <= HALVINGS and least > 0.0:
        found = False
        for k in range(5):
            for sign in (1.0, -1.0):
                state = best.copy()
                state[k] += sign * steps[k]
                tilted = np.sqrt(state[3] * state[3] + state[4] * state[4]) > MOST_TILT
                if state[k] < low[k] or state[k] > high[k] or tilted:
                    continue
                overlap = _overlap(points, heights, x0, y0, cell, top, state, least)
                if overlap < least:
                    best, least, found = state, overlap, True
        if not found:
            steps /= 2
            halvings += 1
    return best, least
