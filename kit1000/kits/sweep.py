"""The underside of a part, grown sideways by a disc and swept up through the rim: an exact Minkowski sum.

It is the union of a prism over the grown outline of each level face and of one hull for each convex patch of the
sloping ones. What lower faces cover after growing cannot show and is left out. Frame: the part stands on z = 0,
insertion face down. All lengths are metres.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from manifold3d import CrossSection, FillRule, Manifold, OpType

from kit1000.errors import Redraw
from kit1000.kits.patches import convex_patches
from kit1000.mesh import convex_hull, mesh_from_solid

SAGITTA = 0.02e-3  # [m] width of the band that the chords of the disc stay within
OVERSIZE = 0.4 * SAGITTA  # the disc's corners lie this far outside the clearance, its chords 0.6 SAGITTA inside
OVER = 1e-3  # [m] cutters stick out of the rim
STAGGER = 1e-6  # [m] from the top of one cutter to the next
STEEP = 2e-4  # down-facing means a unit normal with z below -STEEP; steeper faces are walls: their edges sweep for them
LEVEL = 2e-6  # [m] a face that rises less is level
STOREY = 1e-3  # [m] steps of height at which faces are tested for being covered
NOTHING = 1e-10  # [m^2] area that is rounding error


def disc(clearance: float) -> np.ndarray:
    """(n, 2) corners of the polygon that stands for the disc: all within OVERSIZE outside, 0.6 SAGITTA inside."""
    radius = clearance + OVERSIZE
    corners = int(np.ceil(np.pi / np.arccos(1 - min(SAGITTA / radius, 0.5)) / 2)) * 2
    angles = np.arange(corners) * (2 * np.pi / corners)
    return radius * np.stack([np.cos(angles), np.sin(angles)], 1)


def shadow_below(standing: Manifold, z: float) -> CrossSection:
    """S(z): the shadow of everything of a standing solid below a height [m]."""
    return CrossSection(standing.trim_by_plane((0, 0, -1), -z).project().to_polygons(), FillRule.Positive)


def grown_sweep(
    standing: Manifold, depth: float, clearance: float, joined: bool = True
) -> tuple[Manifold, list[float]]:
    """The part below the rim, grown by the clearance and swept up; and the heights [m] of its level faces."""
    triangles, level = _underside(standing.trim_by_plane((0, 0, -1), -depth))
    round_, flat = disc(clearance), triangles[level]
    levels = np.unique(flat[:, 0, 2])
    outlines = [_grown_outline(flat[flat[:, 0, 2] == z][..., :2], round_) for z in levels]
    footing = _Footing(standing, clearance, levels, outlines)
    sloping = [patch for patch in convex_patches(triangles, joined) if np.ptp(patch[:, 2]) > LEVEL]
    shown = [patch for patch in sloping if not footing.covers(patch, round_)]
    # tops at heights of their own: many coplanar ones would cost most of the time of the union
    tops = iter(depth + OVER + STAGGER * np.arange(len(outlines) + len(shown)))
    prisms = [
        outline.extrude(next(tops) - z).translate((0, 0, z))
        for z, outline in zip(levels, outlines, strict=True)
        if not outline.is_empty()  # a splinter of a face that Clipper rounds away
    ]
    hulls = [convex_hull(_risen(patch, round_, next(tops))) for patch in shown]
    swept = Manifold.batch_boolean(prisms + hulls, OpType.Add)
    if swept.is_empty():
        raise Redraw(f"no underside to sweep ({swept.status().name})")
    return swept, levels.tolist()


class _Footing:
    """What the grown sweep of lower faces covers at a height, a little less at most."""

    def __init__(self, standing: Manifold, clearance: float, levels: np.ndarray, outlines: list[CrossSection]) -> None:
        self.standing, self.clearance = standing, clearance
        self.levels, self.outlines = levels, outlines
        self.storeys: dict[tuple[int, int], CrossSection] = {}

    def covers(self, patch: np.ndarray, round_: np.ndarray) -> bool:
        """Whether the grown shadow of a patch lies in what is swept below the patch already."""
        grown: Any = (patch[:, None, :2] + round_).reshape(-1, 2)
        shadow = CrossSection.hull_points(grown)
        return (shadow - self._at(float(patch[:, 2].min()))).area() < NOTHING

    def _at(self, z: float) -> CrossSection:
        storey, below = int(z / STOREY), int(np.searchsorted(self.levels, z + LEVEL))
        if (storey, below) not in self.storeys:
            area = CrossSection.batch_boolean(self.outlines[:below], OpType.Add) if below else CrossSection()
            if storey:
                area = area + self._grown(storey * STOREY)
            self.storeys[storey, below] = area
        return self.storeys[storey, below]

    def _grown(self, z: float) -> CrossSection:
        """The shadow below a height, grown by a disc inside the one that walls are made with."""
        shadow = shadow_below(self.standing, z)
        return shadow.offset(self.clearance + OVERSIZE - SAGITTA, circular_segments=len(disc(self.clearance)))


def _underside(sunk: Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Down-facing triangles (m, 3, 3) and which of them are level, these pressed flat onto their lowest corner."""
    mesh = mesh_from_solid(sunk)
    triangles = mesh.triangles[mesh.normals[:, 2] < -STEEP].copy()
    level = np.ptp(triangles[..., 2], axis=1) < LEVEL
    heights = np.sort(triangles[level][..., 2].min(1))
    lowest = heights[np.diff(heights, prepend=-np.inf) > LEVEL]
    if len(lowest):
        own = np.searchsorted(lowest, triangles[level][..., 2].min(1), side="right") - 1
        pressed = np.broadcast_to(lowest[own][:, None, None], (len(own), 3, 1))
        triangles[level] = np.concatenate([triangles[level][..., :2], pressed], axis=2)
    return triangles, level


def _risen(patch: np.ndarray, round_: np.ndarray, top: float) -> np.ndarray:
    """(n, 3) corners of a patch, each grown to a level disc, here and at the top."""
    low = (patch[:, None] + np.concatenate([round_, np.zeros((len(round_), 1))], 1)).reshape(-1, 3)
    return np.concatenate([low, np.concatenate([low[:, :2], np.full((len(low), 1), top)], 1)])


def _grown_outline(triangles: np.ndarray, round_: np.ndarray) -> CrossSection:
    """Level triangles (k, 3, 2) and the disc, as one outline: the union of all, and of the disc along each edge."""
    inner = CrossSection([triangle[::-1] for triangle in triangles], FillRule.Positive)
    edges = [
        CrossSection.hull_points(np.concatenate([a + round_, b + round_]))
        for loop in inner.to_polygons()
        for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True)
    ]
    return CrossSection.batch_boolean([inner, *edges], OpType.Add)
