"""The underside of a part, grown sideways by a disc and swept up through the rim: an exact Minkowski sum.

It is the union of a prism over the grown outline of each level face and of one hull for each convex patch of the
sloping ones. Patches inside the sweep of lower faces add nothing and are left out. Frame: the part stands on z = 0,
insertion face down. All lengths are metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from manifold3d import CrossSection, FillRule, Manifold, OpType

from kit1000.errors import Redraw
from kit1000.kits.patches import MERGED, Detail, merged_underside
from kit1000.kits.shadows import PartShadows, shadow_below
from kit1000.kits.underside import LEVEL_TOLERANCE
from kit1000.mesh import convex_hull
from kit1000.numerics.trigonometry import cosine, sine

SAGITTA = 0.02e-3  # [m] width of the band that the chords of the disc stay within
DISC_OVERSIZE = 0.4 * SAGITTA  # the disc's corners lie this far outside the clearance, its chords 0.6 SAGITTA inside
RIM_OVERSHOOT = 1e-3  # [m] by which cutting solids stick out of the rim
TOP_SPACING = 1e-6  # [m] from the top of one cutting solid to the next
COVERAGE_STEP = 1e-3  # [m] between heights at which the sweep of lower faces is computed
AREA_TOLERANCE = 1e-10  # [m^2] smaller areas are rounding errors


def disc_polygon(clearance: float) -> np.ndarray:
    """(n, 2) [m] a polygon for the disc: corners DISC_OVERSIZE outside it, chords at most 0.6 SAGITTA inside."""
    radius = clearance + DISC_OVERSIZE
    corners = int(np.ceil(np.pi / np.arccos(1 - min(SAGITTA / radius, 0.5)) / 2)) * 2
    angles = np.arange(corners) * (2 * np.pi / corners)
    return radius * np.stack([cosine(angles), sine(angles)], 1)


def grown_sweep(part: PartShadows, clearance: float, detail: Detail = MERGED) -> Manifold:
    """The part below the rim, grown by the clearance and swept up."""
    triangles, level = part.underside
    polygon, level_triangles = disc_polygon(clearance), triangles[level]
    levels = np.unique(level_triangles[:, 0, 2])
    outlines = [_grown_outline(level_triangles[level_triangles[:, 0, 2] == z][..., :2], polygon) for z in levels]
    lower = _LowerSweep(part.standing, clearance, levels, outlines)
    exposed = [patch for patch in _grown_patches(triangles, detail, polygon) if not lower.covers(patch)]
    # each top at a height of its own: many coplanar tops would take most of the time of the union
    tops = iter(part.depth + RIM_OVERSHOOT + TOP_SPACING * np.arange(len(outlines) + len(exposed)))
    prisms = [
        outline.extrude(next(tops) - z).translate((0, 0, z))
        for z, outline in zip(levels, outlines, strict=True)
        if not outline.is_empty()  # a sliver of a face that Clipper rounds away
    ]
    hulls = [convex_hull(_swept_corners(patch, next(tops))) for patch in exposed]
    swept = Manifold.batch_boolean(prisms + hulls, OpType.Add)
    if swept.is_empty():
        raise Redraw(f"no underside to sweep ({swept.status().name})")
    return swept


def _grown_patches(triangles: np.ndarray, detail: Detail, polygon: np.ndarray) -> Iterator[np.ndarray]:
    """Convex sloping patches of the underside, each corner grown to a level disc. (k, 3) [m]"""
    for patch in merged_underside(triangles, detail).patches:
        if np.ptp(patch[:, 2]) > LEVEL_TOLERANCE:
            grown = np.repeat(patch, len(polygon), axis=0)
            grown[:, :2] += np.tile(polygon, (len(patch), 1))
            yield grown


class _LowerSweep:
    """The section of the grown sweep of lower faces at a height, from inside: never larger."""

    def __init__(self, standing: Manifold, clearance: float, levels: np.ndarray, outlines: list[CrossSection]) -> None:
        self.standing, self.clearance = standing, clearance
        self.levels, self.outlines = levels, outlines
        self.areas: dict[tuple[int, int], CrossSection] = {}

    def covers(self, patch: Any) -> bool:
        """Whether the shadow of a grown patch (k, 3) lies inside the grown sweep of the faces below it."""
        shadow = CrossSection.hull_points(patch[:, :2])
        return (shadow - self._area_below(float(patch[:, 2].min()))).area() < AREA_TOLERANCE

    def _area_below(self, z: float) -> CrossSection:
        step, below = int(z / COVERAGE_STEP), int(np.searchsorted(self.levels, z + LEVEL_TOLERANCE))
        if (step, below) not in self.areas:
            area = CrossSection.batch_boolean(self.outlines[:below], OpType.Add) if below else CrossSection()
            if step:
                area = area + self._grown(step * COVERAGE_STEP)
            self.areas[step, below] = area
        return self.areas[step, below]

    def _grown(self, z: float) -> CrossSection:
        """The shadow below a height, grown by a disc inside the one that the cavity is made with."""
        shadow = shadow_below(self.standing, z)
        return shadow.offset(
            self.clearance + DISC_OVERSIZE - SAGITTA, circular_segments=len(disc_polygon(self.clearance))
        )


def _swept_corners(patch: np.ndarray, top: float) -> np.ndarray:
    """(2 k, 3) [m] corners of a grown patch (k, 3), at their own height and at the top."""
    above = patch.copy()
    above[:, 2] = top
    return np.concatenate([patch, above])


def _grown_outline(triangles: np.ndarray, polygon: np.ndarray) -> CrossSection:
    """Outline of level triangles (k, 3, 2) grown by the disc: their union with the disc swept along each outer edge."""
    inner = CrossSection([triangle[::-1] for triangle in triangles], FillRule.Positive)
    edges = [
        CrossSection.hull_points(np.concatenate([a + polygon, b + polygon]))
        for loop in inner.to_polygons()
        for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True)
    ]
    return CrossSection.batch_boolean([inner, *edges], OpType.Add)
