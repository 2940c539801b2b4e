"""Lowering a part into a cavity as an attacker would: turn, shift and tilt it until nothing is in the way.

From a start beside a base pose, a pattern search lowers the overlap: with the part at the greatest height at which it
would count as seated, how far the points of its underside lie below the kit's height field, summed. Where the overlap
nearly vanishes, the same search lowers the exact height of contact. Kit frame, metres and radians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kit1000.kits.contact import ContactFeatures, ConvexEdges, contact_features, vertical_contact_offset
from kit1000.kits.envelope import lower_envelope
from kit1000.mesh import Mesh
from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import matmul
from kit1000.pose import Pose

MOST_TILT = np.radians(5)  # of a part that goes in upright; tilted farther it is jammed
SPACING = 1.0e-3  # [m] between the points that stand for the part's underside and edges
MARGIN = 3e-3  # [m] above the rim: points of the part that lie higher touch nothing
DEEPEST = 3e-3  # [m] of overlap of one point: deeper ones are in the way all the same
SHIFT_STEP = 1.0e-3  # [m] between the shifts of which the search starts at the best
FIRST_STEPS = np.array([np.radians(1.0), 0.5e-3, 0.5e-3, np.radians(1.0), np.radians(1.0)])  # of yaw, shift, tilt
HALVINGS = 3  # of the steps, where none of them leads lower
NEARLY_CLEAR = 5e-3  # [m] of summed overlap: the height field may err by as much, exact contact decides
TRIED_EXACTLY = 2  # of the poses that the starts lead to, those of least overlap
EXACT_TRIALS = 16  # exact contacts of one pose
TILT_STARTS = np.radians([(0.0, 0.0), (3.0, 0.0), (-3.0, 0.0), (0.0, 3.0), (0.0, -3.0)])
TRIG_SCALE = 2.0**40  # sines and cosines are rounded to its inverse, so that their last bits decide nothing
LENGTH_SCALE = 1e9  # overlaps and heights are compared in whole nanometres


@dataclass(frozen=True, eq=False)
class HeightField:
    """The kit from above, on a grid."""

    heights: np.ndarray
    """(rows, columns) [m] of cells; 0, the top of the plate, beside the kit."""
    origin: np.ndarray
    """(2,) [m] the middle of the first cell."""
    cell: float
    """[m]"""

    @staticmethod
    def of(kit: Mesh, cell: float) -> HeightField:
        """The field of a kit with cells of a size [m]."""
        upside_down = Mesh(kit.vertices * [1, 1, -1], kit.faces[:, ::-1])
        heights, origin = lower_envelope(upside_down, cell)
        return HeightField(np.where(np.isfinite(heights), -heights, 0.0), origin, cell)


@dataclass(frozen=True, eq=False)
class LoweredPart:
    """A part in a base rotation, prepared to be lowered into a cavity."""

    edges: ConvexEdges
    rotation: np.ndarray
    """(3, 3) kit from part."""
    points: np.ndarray
    """(n, 3) [m] of underside and convex edges relative to the part's origin, farthest from it across first."""

    @staticmethod
    def of(edges: ConvexEdges, rotation: np.ndarray, depth: float) -> LoweredPart:
        """A part for a cavity of a depth [m]; its lowest point stands on the floor."""
        vertices = matmul(edges.mesh.vertices, rotation.T)
        heights, corner = lower_envelope(Mesh(vertices, edges.mesh.faces), SPACING)
        i, j = np.nonzero(np.isfinite(heights))
        grid = np.stack([corner[0] + i * SPACING, corner[1] + j * SPACING, heights[i, j]], 1)
        points = np.concatenate([grid, vertices, _points_on(vertices[edges.ends])])
        points = points[points[:, 2] < vertices[:, 2].min() + depth + MARGIN]
        order = np.argsort(-np.hypot(points[:, 0], points[:, 1]), kind="stable")
        return LoweredPart(edges, rotation, np.ascontiguousarray(points[order]))

    def features(self, state: np.ndarray) -> tuple[np.ndarray, ContactFeatures]:
        """(3, 3) kit from part and the contact features, at z = 0, in a state (5,)."""
        rotation = matmul(turned_matrix(state[0], state[3], state[4]), self.rotation)
        return rotation, contact_features(self.edges, rotation, np.array([state[1], state[2], 0.0]), -1.0)


def lowered_fit(
    part: LoweredPart,
    field: HeightField,
    kit: ContactFeatures,
    *,
    start: np.ndarray,
    reach: np.ndarray,
    top: float,
    accepts: Callable[[float], bool],
) -> Pose | None:
    """A kit_from_part pose that touches at an accepted height, or None.

    Args:
        part: in its base rotation.
        field: the kit's height field.
        kit: its contact features from above.
        start: (3,) yaw [rad] beside the base rotation and position x, y [m] of the part's origin.
        reach: (2, 3) the lowest and the highest yaw and position.
        top: [m] the greatest height of the part's origin that counts.
        accepts: whether the part's origin may be at a height [m] when it touches.
    """
    low = np.concatenate([reach[0], [-MOST_TILT, -MOST_TILT]])
    high = np.concatenate([reach[1], [MOST_TILT, MOST_TILT]])
    grid = (part.points, field.heights, *field.origin, field.cell, top)
    found = [_least_overlap(*grid, np.concatenate([start, tilt]), low, high) for tilt in TILT_STARTS]
    for k in np.argsort([overlap for _, overlap in found], kind="stable")[:TRIED_EXACTLY]:
        state, overlap = found[k]
        pose = _exact_fit(part, kit, state, low, high, accepts) if overlap <= NEARLY_CLEAR else None
        if pose is not None:
            return pose
    return None


def _exact_fit(
    part: LoweredPart,
    kit: ContactFeatures,
    state: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    accepts: Callable[[float], bool],
) -> Pose | None:
    """The first pose of a pattern search for the lowest contact that touches at an accepted height."""

    def height(state: np.ndarray) -> tuple[float, np.ndarray]:
        rotation, features = part.features(state)
        return np.round(vertical_contact_offset(features, kit) * LENGTH_SCALE) / LENGTH_SCALE, rotation

    best, rotation = height(state)
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
                lower, turned = height(other)
                if lower < best:
                    state, best, rotation, found = other, lower, turned, True
        if not found:
            steps = steps / 2
    return Pose.from_rotation_matrix(rotation, [state[1], state[2], best]) if accepts(best) else None


def _points_on(edges: np.ndarray) -> np.ndarray:
    """(n, 3) [m] points inside edges (k, 2, 3), at most SPACING apart."""
    along = edges[:, 1] - edges[:, 0]
    counts = np.ceil(np.sqrt(matmul(along**2, np.ones(3))) / SPACING).astype(int) - 1
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
    """[m] how far the points lie below the height field, summed; at least `most` where it is more."""
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
