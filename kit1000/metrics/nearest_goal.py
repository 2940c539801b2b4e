"""Which goal, at which turn about the free axis, a predicted motion comes nearest to: loops over hull vertices.

Nearest means smallest MSSD, the largest distance between where a vertex is taken and where it belongs. A placement is
a rotation (3, 3) and a translation (3,) [m] that take vertices of the part's frame to the world.
"""

from __future__ import annotations

import numpy as np

from kit1000.compiled import compiled

CELLS = 24  # equal angles looked at, the twist angle first
CELL = 2 * np.pi / CELLS
BEST = 3  # cells searched further, one cell to either side
STEPS = 30  # of golden section: a bracket of 30 degrees shrinks to 3e-7 rad
GOLDEN = (np.sqrt(5.0) - 1) / 2


@compiled
def nearest_goals(
    moved_r, moved_t, wanted_r, wanted_t, goal_starts, free, points, directions, twists, hulls, hull_starts, shape
):
    """For n queries the index of the judging goal among their own, its turn [rad] and the MSSD [m]: (n,) each.

    moved: (n, ...) placements as predicted; wanted: (m, ...) placements at the goals; free (n,) bool; points and
    directions (n, 3) of the free axes; twists (m,) [rad] of the prediction about the axis, seen from each goal.
    """
    n = moved_r.shape[0]
    goal, turn, mssd = np.zeros(n, np.int64), np.zeros(n), np.zeros(n)
    for i in range(n):
        vertices = hulls[hull_starts[shape[i]] : hull_starts[shape[i] + 1]]
        best = np.inf
        for g in range(goal_starts[i], goal_starts[i + 1]):
            angle = 0.0
            if free[i]:
                angle, largest = _best_turn(
                    vertices, moved_r[i], moved_t[i], wanted_r[g], wanted_t[g], points[i], directions[i], twists[g]
                )
            else:
                largest = _largest_distance(vertices, moved_r[i], moved_t[i], wanted_r[g], wanted_t[g])
            if largest < best:
                best = largest
                goal[i], turn[i], mssd[i] = g - goal_starts[i], angle, largest
    return goal, turn, mssd


@compiled
def _largest_distance(vertices, moved_r, moved_t, wanted_r, wanted_t):
    """The largest distance [m] between two placements of the same vertices: exact down to rounding."""
    apart, shift = moved_r - wanted_r, moved_t - wanted_t
    largest = 0.0
    for k in range(vertices.shape[0]):
        x, y, z = vertices[k]
        dx = apart[0, 0] * x + apart[0, 1] * y + apart[0, 2] * z + shift[0]
        dy = apart[1, 0] * x + apart[1, 1] * y + apart[1, 2] * z + shift[1]
        dz = apart[2, 0] * x + apart[2, 1] * y + apart[2, 2] * z + shift[2]
        largest = max(largest, dx * dx + dy * dy + dz * dz)
    return np.sqrt(largest)


@compiled
def _best_turn(vertices, moved_r, moved_t, wanted_r, wanted_t, point, direction, twist):
    """The turn of the goal about its axis that makes the largest distance smallest, and that distance.

    The twist angle has the last word: where it does as well, as at the truth, it is exact and the search is not.
    """
    waves = _waves(vertices, moved_r, moved_t - point, wanted_r, wanted_t - point, direction)
    searched = _searched(waves, twist)
    at_twist = _turned_distance(vertices, moved_r, moved_t, wanted_r, wanted_t, point, direction, twist)
    at_best = _turned_distance(vertices, moved_r, moved_t, wanted_r, wanted_t, point, direction, searched)
    return (searched, at_best) if at_best < at_twist else (twist, at_twist)


@compiled
def _waves(vertices, moved_r, moved_t, wanted_r, wanted_t, n):
    """(v, 3): for each vertex a, b, c of its squared distance a + b cos t + c sin t [m^2] at a turn t of the goal.

    With p and g the vertex as predicted and at the goal, both seen from the axis n, and R the turn about n,
    |p - R g|^2 = |p|^2 + |g|^2 - 2 (n.p)(n.g) - 2 cos t (p.g - (n.p)(n.g)) - 2 sin t n.(g x p).
    """
    waves = np.empty((vertices.shape[0], 3))
    for k in range(vertices.shape[0]):
        x, y, z = vertices[k]
        px = moved_r[0, 0] * x + moved_r[0, 1] * y + moved_r[0, 2] * z + moved_t[0]
        py = moved_r[1, 0] * x + moved_r[1, 1] * y + moved_r[1, 2] * z + moved_t[1]
        pz = moved_r[2, 0] * x + moved_r[2, 1] * y + moved_r[2, 2] * z + moved_t[2]
        gx = wanted_r[0, 0] * x + wanted_r[0, 1] * y + wanted_r[0, 2] * z + wanted_t[0]
        gy = wanted_r[1, 0] * x + wanted_r[1, 1] * y + wanted_r[1, 2] * z + wanted_t[1]
        gz = wanted_r[2, 0] * x + wanted_r[2, 1] * y + wanted_r[2, 2] * z + wanted_t[2]
        along = (n[0] * px + n[1] * py + n[2] * pz) * (n[0] * gx + n[1] * gy + n[2] * gz)
        waves[k, 0] = px * px + py * py + pz * pz + gx * gx + gy * gy + gz * gz - 2 * along
        waves[k, 1] = -2 * (px * gx + py * gy + pz * gz - along)
        waves[k, 2] = -2 * (n[0] * (gy * pz - gz * py) + n[1] * (gz * px - gx * pz) + n[2] * (gx * py - gy * px))
    return waves


@compiled
def _height(waves, angle):
    """The largest squared distance [m^2] at a turn."""
    c, s = np.cos(angle), np.sin(angle)
    highest = -np.inf
    for k in range(waves.shape[0]):
        highest = max(highest, waves[k, 0] + waves[k, 1] * c + waves[k, 2] * s)
    return highest


@compiled
def _searched(waves, first):
    """The turn of the lowest height: equal angles from `first` on, then golden section in the best cells."""
    heights = np.empty(CELLS)
    for k in range(CELLS):
        heights[k] = _height(waves, first + k * CELL)
    best, lowest = first, np.inf
    for k in np.argsort(heights)[:BEST]:
        angle = _golden(waves, first + (k - 1) * CELL, first + (k + 1) * CELL)
        height = _height(waves, angle)
        if height < lowest:
            best, lowest = angle, height
    return best


@compiled
def _golden(waves, low, high):
    """The lowest turn between two, by golden section."""
    left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    at_left, at_right = _height(waves, left), _height(waves, right)
    for _ in range(STEPS):
        if at_left <= at_right:
            high, right, at_right = right, left, at_left
            left = high - GOLDEN * (high - low)
            at_left = _height(waves, left)
        else:
            low, left, at_left = left, right, at_right
            right = low + GOLDEN * (high - low)
            at_right = _height(waves, right)
    return left if at_left <= at_right else right


@compiled
def _turned_distance(vertices, moved_r, moved_t, wanted_r, wanted_t, point, n, angle):
    """The largest distance [m] to the goal turned about its axis, without the cancellation of the waves."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array(
        (
            (c + (1 - c) * n[0] * n[0], (1 - c) * n[0] * n[1] - s * n[2], (1 - c) * n[0] * n[2] + s * n[1]),
            ((1 - c) * n[1] * n[0] + s * n[2], c + (1 - c) * n[1] * n[1], (1 - c) * n[1] * n[2] - s * n[0]),
            ((1 - c) * n[2] * n[0] - s * n[1], (1 - c) * n[2] * n[1] + s * n[0], c + (1 - c) * n[2] * n[2]),
        )
    )
    turned_r, turned_t = np.empty((3, 3)), np.empty(3)
    for i in range(3):
        turned_t[i] = point[i]
        for j in range(3):
            turned_t[i] += turn[i, j] * (wanted_t[j] - point[j])
            turned_r[i, j] = turn[i, 0] * wanted_r[0, j] + turn[i, 1] * wanted_r[1, j] + turn[i, 2] * wanted_r[2, j]
    return _largest_distance(vertices, moved_r, moved_t, turned_r, turned_t)
