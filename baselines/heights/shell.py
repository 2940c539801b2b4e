"""The shell of a part: its observed surface, closed down to the table."""

from __future__ import annotations

import numpy as np

from baselines.heights.maps import UNSEEN, HeightMap

WALL_STEP = 2e-3  # [m] between points of a wall, from top to bottom


def shell_points(part: HeightMap) -> np.ndarray:
    """(n, 3) float64 [m] world: the points of a part's map, their projection on the table, and walls at its outline.

    What is hidden below the surface counts as solid. Without it a part that a guess flips over would be open.
    """
    top = part.points()
    seen = np.pad(part.heights > UNSEEN, 1)
    inner = seen[2:, 1:-1] & seen[:-2, 1:-1] & seen[1:-1, 2:] & seen[1:-1, :-2]
    return closed_shell(top, HeightMap(part.corner, part.cell, np.where(inner, UNSEEN, part.heights)).points())


def closed_shell(surface: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """(n, 3) [m] world: points of a surface, their projection on the table z = 0, and walls that hang from its outline.

    surface, outline: (k, 3) and (m, 3) [m] world.
    """
    levels = np.arange(WALL_STEP, outline[:, 2].max(initial=0.0), WALL_STEP)
    walls = np.repeat(outline[:, None], len(levels), axis=1)  # (m, levels, 3)
    walls[..., 2] = levels
    return np.concatenate([surface, surface * (1.0, 1.0, 0.0), walls[levels < outline[:, None, 2]]])
