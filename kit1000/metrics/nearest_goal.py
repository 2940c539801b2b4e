"""The goal of smallest MSSD, with its angle about the free axis: compiled loops over the vertices of convex hulls.

MSSD is the maximum symmetry-aware surface distance: the largest distance between a vertex of the part where the
prediction puts it and where the goal puts it, minimised over the goals and over rotations of the goal about its free
axis. A pose is a rotation (3, 3) and a translation (3,) [m] from the part's frame to the world.
"""

from __future__ import annotations

import numpy as np

from kit1000.numerics.compiled import compiled

ANGLE_SAMPLES = 24  # equally spaced angles that are evaluated, the twist angle first
ANGLE_STEP = 2 * np.pi / ANGLE_SAMPLES
REFINED = 3  # best samples that are refined, each between its two neighbours
GOLDEN_STEPS = 30  # of golden section: a bracket of 30 degrees shrinks to 3e-7 rad
GOLDEN_RATIO = (np.sqrt(5.0) - 1) / 2


@compiled
def nearest_goals(
    predicted_r,
    predicted_t,
    goal_r,
    goal_t,
    goal_starts,
    has_free_axis,
    axis_points,
    axis_directions,
    twists,
    hulls,
    hull_starts,
    hull_index,
):
    """For n queries the index of the nearest goal among their own, its angle [rad] and the MSSD [m]: (n,) each.

    predicted: (n, ...) poses as predicted; goal: (m, ...) poses of the goals; has_free_axis (n,) bool; axis_points and
    axis_directions (n, 3); twists (m,) [rad]: the rotation from each goal to the prediction, projected on the axis.
    """
    n = predicted_r.shape[0]
    goal, angle, mssd = np.zeros(n, np.int64), np.zeros(n), np.zeros(n)
    for i in range(n):
        vertices = hulls[hull_starts[hull_index[i]] : hull_starts[hull_index[i] + 1]]
        best = np.inf
        for g in range(goal_starts[i], goal_starts[i + 1]):
            best_angle = 0.0
            if has_free_axis[i]:
                best_angle, largest = _best_angle(
                    vertices,
                    predicted_r[i],
                    predicted_t[i],
                    goal_r[g],
                    goal_t[g],
                    axis_points[i],
                    axis_directions[i],
                    twists[g],
                )
            else:
                largest = _largest_distance(vertices, predicted_r[i], predicted_t[i], goal_r[g], goal_t[g])
            if largest < best:
                best = largest
                goal[i], angle[i], mssd[i] = g - goal_starts[i], best_angle, largest
    return goal, angle, mssd


@compiled
def _largest_distance(vertices, predicted_r, predicted_t, goal_r, goal_t):
    """The largest distance [m] between the same vertices at two poses: exact down to rounding."""
    change, shift = predicted_r - goal_r, predicted_t - goal_t
    largest = 0.0
    for k in range(vertices.shape[0]):
        x, y, z = vertices[k]
        dx = change[0, 0] * x + change[0, 1] * y + change[0, 2] * z + shift[0]
        dy = change[1, 0] * x + change[1, 1] * y + change[1, 2] * z + shift[1]
        dz = change[2, 0] * x + change[2, 1] * y + change[2, 2] * z + shift[2]
        largest = max(largest, dx * dx + dy * dy + dz * dz)
    return np.sqrt(largest)


@compiled
def _best_angle(vertices, predicted_r, predicted_t, goal_r, goal_t, point, direction, twist):
    """The angle [rad] of the goal about its axis with the smallest largest distance, and that distance [m].

    Where the twist angle does as well, as at the ground truth, it is returned: it is exact and the search is not.
    """
    sinusoids = _distance_sinusoids(vertices, predicted_r, predicted_t - point, goal_r, goal_t - point, direction)
    found = _search_angle(sinusoids, twist)
    at_twist = _largest_distance_at_angle(vertices, predicted_r, predicted_t, goal_r, goal_t, point, direction, twist)
    at_found = _largest_distance_at_angle(vertices, predicted_r, predicted_t, goal_r, goal_t, point, direction, found)
    return (found, at_found) if at_found < at_twist else (twist, at_twist)


@compiled
def _distance_sinusoids(vertices, predicted_r, predicted_t, goal_r, goal_t, n):
    """(v, 3): for each vertex a, b, c of its squared distance a + b cos t + c sin t [m^2] at angle t of the goal.

    With p and g the vertex as predicted and at the goal, both relative to a point on the axis n, and R the rotation by
    t about n,
    |p - R g|^2 = |p|^2 + |g|^2 - 2 (n.p)(n.g) - 2 cos t (p.g - (n.p)(n.g)) - 2 sin t n.(g x p).
    """
    sinusoids = np.empty((vertices.shape[0], 3))
    for k in range(vertices.shape[0]):
        x, y, z = vertices[k]
        px = predicted_r[0, 0] * x + predicted_r[0, 1] * y + predicted_r[0, 2] * z + predicted_t[0]
        py = predicted_r[1, 0] * x + predicted_r[1, 1] * y + predicted_r[1, 2] * z + predicted_t[1]
        pz = predicted_r[2, 0] * x + predicted_r[2, 1] * y + predicted_r[2, 2] * z + predicted_t[2]
        gx = goal_r[0, 0] * x + goal_r[0, 1] * y + goal_r[0, 2] * z + goal_t[0]
        gy = goal_r[1, 0] * x + goal_r[1, 1] * y + goal_r[1, 2] * z + goal_t[1]
        gz = goal_r[2, 0] * x + goal_r[2, 1] * y + goal_r[2, 2] * z + goal_t[2]
        along = (n[0] * px + n[1] * py + n[2] * pz) * (n[0] * gx + n[1] * gy + n[2] * gz)
        sinusoids[k, 0] = px * px + py * py + pz * pz + gx * gx + gy * gy + gz * gz - 2 * along
        sinusoids[k, 1] = -2 * (px * gx + py * gy + pz * gz - along)
        sinusoids[k, 2] = -2 * (n[0] * (gy * pz - gz * py) + n[1] * (gz * px - gx * pz) + n[2] * (gx * py - gy * px))
    return sinusoids


@compiled
def _largest_squared_distance(sinusoids, angle):
    """The largest squared distance [m^2] of any vertex at an angle [rad] of the goal."""
    c, s = np.cos(angle), np.sin(angle)
    largest = -np.inf
    for k in range(sinusoids.shape[0]):
        largest = max(largest, sinusoids[k, 0] + sinusoids[k, 1] * c + sinusoids[k, 2] * s)
    return largest


@compiled
def _search_angle(sinusoids, first):
    """The angle of smallest largest distance: equally spaced samples from `first` on, the best refined."""
    values = np.empty(ANGLE_SAMPLES)
    for k in range(ANGLE_SAMPLES):
        values[k] = _largest_squared_distance(sinusoids, first + k * ANGLE_STEP)
    best, smallest = first, np.inf
    for k in np.argsort(values)[:REFINED]:
        angle = _golden_section(sinusoids, first + (k - 1) * ANGLE_STEP, first + (k + 1) * ANGLE_STEP)
        value = _largest_squared_distance(sinusoids, angle)
        if value < smallest:
            best, smallest = angle, value
    return best


@compiled
def _golden_section(sinusoids, low, high):
    """The angle of smallest largest distance between two angles, by golden section."""
    left, right = high - GOLDEN_RATIO * (high - low), low + GOLDEN_RATIO * (high - low)
    at_left, at_right = _largest_squared_distance(sinusoids, left), _largest_squared_distance(sinusoids, right)
    for _ in range(GOLDEN_STEPS):
        if at_left <= at_right:
            high, right, at_right = right, left, at_left
            left = high - GOLDEN_RATIO * (high - low)
            at_left = _largest_squared_distance(sinusoids, left)
        else:
            low, left, at_left = left, right, at_right
            right = low + GOLDEN_RATIO * (high - low)
            at_right = _largest_squared_distance(sinusoids, right)
    return left if at_left <= at_right else right


@compiled
def _largest_distance_at_angle(vertices, predicted_r, predicted_t, goal_r, goal_t, point, n, angle):
    """The largest distance [m] to the goal at an angle about its axis, without the cancellation of the sinusoids."""
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array(
        (
            (c + (1 - c) * n[0] * n[0], (1 - c) * n[0] * n[1] - s * n[2], (1 - c) * n[0] * n[2] + s * n[1]),
            ((1 - c) * n[1] * n[0] + s * n[2], c + (1 - c) * n[1] * n[1], (1 - c) * n[1] * n[2] - s * n[0]),
            ((1 - c) * n[2] * n[0] - s * n[1], (1 - c) * n[2] * n[1] + s * n[0], c + (1 - c) * n[2] * n[2]),
        )
    )
    rotated_r, rotated_t = np.empty((3, 3)), np.empty(3)
    for i in range(3):
        rotated_t[i] = point[i]
        for j in range(3):
            rotated_t[i] += rotation[i, j] * (goal_t[j] - point[j])
            rotated_r[i, j] = (
                rotation[i, 0] * goal_r[0, j] + rotation[i, 1] * goal_r[1, j] + rotation[i, 2] * goal_r[2, j]
            )
    return _largest_distance(vertices, predicted_r, predicted_t, rotated_r, rotated_t)
