"""The shadows and the underside of a standing part, from which its cavity is made.

The shadow S(z) is the projection, along the insertion axis z, of all of the part below a height z. It is a section of
what the part sweeps when it leaves along z. The underside are the faces that look down. Frame: the part stands on
z = 0, insertion face down. All lengths are metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from manifold3d import CrossSection, FillRule, Manifold

from kit1000.mesh import mesh_from_solid

WALL_COSINE = 2e-4  # faces whose unit normal has a smaller -z are walls: they sweep no more than their edges do
LEVEL_TOLERANCE = 2e-6  # [m] a face of a smaller extent along z is level
LEDGE_OFFSET = 0.02e-3  # [m] of a shadow above or below a ledge: lower steps are floor, not wall
LEAST_STEP = 3e-3 / 10  # [m] of a ledge from floor and rim
SPACING = 4e-3  # [m] at most between heights while the shadow changes
AREA_TOLERANCE = 1e-9  # [m^2] smaller areas are rounding errors


class Shadow(NamedTuple):
    """The shadow below one height."""

    z: float  # [m] above the floor
    section: CrossSection  # S(z), what the part sweeps at this height


@dataclass(frozen=True, eq=False)
class PartShadows:
    """A standing part with its shadows at several heights below the rim of its cavity."""

    standing: Manifold
    depth: float  # [m] of the rim above the floor
    underside: tuple[np.ndarray, np.ndarray]  # its `downward_faces` below the rim
    shadows: tuple[Shadow, ...]  # lowest first, the last just below the rim

    @staticmethod
    def of(standing: Manifold, depth: float) -> PartShadows:
        """The shadows of a part at both ends of each interval between ledges, and inside it if the shadow changes."""
        underside = triangles, level = downward_faces(standing.trim_by_plane((0, 0, -1), -depth))
        levels = np.unique(triangles[level][:, 0, 2]).tolist()
        return PartShadows(standing, depth, underside, tuple(_shadows(standing, _ledges(levels, depth))))

    @property
    def rim(self) -> CrossSection:
        """The shadow at the rim."""
        return self.shadows[-1].section


def shadow_below(standing: Manifold, z: float) -> CrossSection:
    """S(z): the shadow of a standing solid below a height [m], its projection along z."""
    return CrossSection(standing.trim_by_plane((0, 0, -1), -z).project().to_polygons(), FillRule.Positive)


def downward_faces(solid: Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Down-facing triangles (m, 3, 3) and which of them are level, these flattened to their lowest corner."""
    mesh = mesh_from_solid(solid)
    triangles = mesh.triangles[mesh.normals[:, 2] < -WALL_COSINE].copy()
    level = np.ptp(triangles[..., 2], axis=1) < LEVEL_TOLERANCE
    heights = np.sort(triangles[level][..., 2].min(1))
    lowest = heights[np.diff(heights, prepend=-np.inf) > LEVEL_TOLERANCE]
    if len(lowest):
        own = np.searchsorted(lowest, triangles[level][..., 2].min(1), side="right") - 1
        flattened = np.broadcast_to(lowest[own][:, None, None], (len(own), 3, 1))
        triangles[level] = np.concatenate([triangles[level][..., :2], flattened], axis=2)
    return triangles, level


def _ledges(levels: list[float], depth: float) -> list[float]:
    """Heights of floor, level faces and rim: between them the shadow changes continuously."""
    return [0.0, *(z for z in levels if LEAST_STEP < z < depth - LEAST_STEP), depth]


def _shadows(standing: Manifold, ledges: list[float]) -> list[Shadow]:
    """Shadows at both ends of each interval between ledges, and at steps inside it if the shadow changes."""
    shadows = []
    for low, high in pairwise(ledges):
        first, last = (Shadow(z, shadow_below(standing, z)) for z in (low + LEDGE_OFFSET, high - LEDGE_OFFSET))
        inner: list[Shadow] = []
        if abs(first.section.area() - last.section.area()) > AREA_TOLERANCE:
            heights = np.linspace(low, high, 2 * int(np.ceil((high - low) / SPACING)) + 1)[1:-1]
            inner = [Shadow(z, shadow_below(standing, z)) for z in heights]
        shadows += [first, *inner, last]
    return shadows
