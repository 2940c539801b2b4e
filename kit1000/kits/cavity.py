"""The cavity of a part: what the part sweeps when it leaves along z, grown sideways by the clearance; exact, no stairs.

The cavity at a height z is the shadow S(z) (see `shadows`) grown by a disc. The whole of it is a Minkowski sum: the
underside of the part grown by a level disc and swept up through the rim. It is the union of a prism over the grown
outline of each level face and of one hull for each convex patch of the sloping faces (see `patches`). A patch inside
the sweep of lower faces adds nothing and is left out. So the walls keep their distance at every height, slopes stay
slopes, and a plate has about a thousand faces. Walls that are too thin are removed by morphological opening. Frame: the
part stands on z = 0, insertion face down. All lengths are metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from manifold3d import CrossSection, FillRule, JoinType, Manifold, OpType

from kit1000.errors import Redraw
from kit1000.kits.patches import MERGED, Detail, merged_underside
from kit1000.kits.shadows import LEVEL_TOLERANCE, PartShadows, Shadow, shadow_below
from kit1000.mesh import convex_hull
from kit1000.numerics.trigonometry import cosine, sine

MIN_SEATED_HEIGHT = 7e-3  # [m] of a seated part: lower ones leave no useful cavity
MIN_PROTRUSION = 3e-3  # [m] of a part above the rim, for a gripper
MIN_WALL = 3e-3  # [m] walls, fins and posts thinner than this are removed
MITER_LIMIT = 2.0  # wall corners sharper than 60 degrees count as thin
MIN_WALL_AREA = 0.05e-6  # [m^2] smaller pieces of thin wall are rounding errors
WALL_OVERLAP = 0.05e-3  # [m] a removed wall is cut so much wider, so that no film stays between it and the cavity
SAGITTA = 0.02e-3  # [m] width of the band that the chords of the disc stay within
DISC_OVERSIZE = 0.4 * SAGITTA  # the disc's corners lie this far outside the clearance, its chords 0.6 SAGITTA inside
RIM_OVERSHOOT = 1e-3  # [m] by which cutting solids stick out of the rim
TOP_SPACING = 1e-6  # [m] from the top of one cutting solid to the next
COVERAGE_STEP = 1e-3  # [m] between heights at which the sweep of lower faces is computed
COVERED_AREA = 1e-10  # [m^2] smaller areas are rounding errors


@dataclass(frozen=True, eq=False)
class Probe:
    """The cavity at one height."""

    shadow: Shadow  # the area that the part sweeps at this height
    removed_walls: CrossSection  # sections of the thin walls that were removed here or below; empty if there were none


@dataclass(frozen=True, eq=False)
class Cavity:
    """A solid to cut out of a plate, from the floor (z = 0) to a little above the rim (z = depth)."""

    depth: float
    solid: Manifold
    probes: tuple[Probe, ...]  # the cavity at several heights, lowest first, the last just below the rim
    removed_wall_count: int  # number of thin walls, fins and posts that were removed, counted at the rim
    grown: Manifold  # the grown sweep: the solid with its thin walls
    part: PartShadows

    @cached_property
    def removed_wall_volume(self) -> float:
        """Volume of the thin walls that were removed [m^3]."""
        if self.grown is self.solid:
            return 0.0
        return _below(self.solid - self.grown, self.depth).volume()

    @cached_property
    def undercut_volume(self) -> float:
        """Volume below the rim that the part sweeps but does not fill [m^3]."""
        return max(_swept_volume(self.part.shadows) - _below(self.part.standing, self.depth).volume(), 0.0)


def insertion_depth(height: float) -> float:
    """Depth of the cavity for a part of a seated height [m]: 0.6 of the height and at most 20 mm [m].

    MIN_PROTRUSION is left above the rim. Only parts lower than MIN_SEATED_HEIGHT, which no dataset has, always sink by
    0.6 of their height.
    """
    return min(20e-3, 0.6 * height, height - MIN_PROTRUSION if height >= MIN_SEATED_HEIGHT else np.inf)


def cut_cavity(part: PartShadows, clearance: float, width: tuple[float, float], detail: Detail = MERGED) -> Cavity:
    """The cavity of a clearance [m] for a standing part, in a plate of width (x, y) [m].

    detail: how nearly convex neighbouring faces are to be grown as one, which is faster and up to 0.1 mm wider.
    """
    depth, shadows = part.depth, part.shadows
    grown = grown_sweep(part, clearance, detail)
    thin_walls, probes = _remove_thin_walls(grown, shadows, depth + RIM_OVERSHOOT, width)
    solid = Manifold.batch_boolean([grown, *thin_walls], OpType.Add) if thin_walls else grown
    removed_count = sum(piece.area() > MIN_WALL_AREA for piece in probes[-1].removed_walls.decompose())
    return Cavity(depth, solid, tuple(probes), removed_count, grown, part)


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
        return (shadow - self._area_below(float(patch[:, 2].min()))).area() < COVERED_AREA

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


def _below(solid: Manifold, z: float) -> Manifold:
    return solid.trim_by_plane((0, 0, -1), -z)


def _swept_volume(shadows: tuple[Shadow, ...]) -> float:
    """Volume that the part sweeps between floor and rim, by the trapezoid rule [m^3]."""
    z, areas = np.array([s.z for s in shadows]), np.array([s.section.area() for s in shadows])
    return float(np.trapezoid(areas, z))


def _remove_thin_walls(
    grown: Manifold, shadows: tuple[Shadow, ...], top: float, width: tuple[float, float]
) -> tuple[list[Manifold], list[Probe]]:
    """The thin walls to cut too, each from half-way to the probe below up to `top` [m]; and the probes."""
    plate = CrossSection.square(width, center=True)
    cuts, probes, removed, below = [], [], CrossSection(), 0.0
    for shadow in shadows:
        z = shadow.z
        thin = _thin_walls(plate - grown.slice(z))
        if not thin.is_empty():
            widened, floor = thin.offset(WALL_OVERLAP, JoinType.Miter, MITER_LIMIT), (below + z) / 2 if probes else 0.0
            cuts.append(widened.extrude(top - floor).translate((0, 0, floor)))
            removed = removed + thin
        probes.append(Probe(shadow, removed))
        below = z
    return cuts, probes


def _thin_walls(walls: CrossSection) -> CrossSection:
    """The areas of walls in which no disc of diameter MIN_WALL fits; corners down to 60 degrees are not thin."""
    core = walls.offset(-MIN_WALL / 2, JoinType.Miter, MITER_LIMIT)
    kept = core.offset(MIN_WALL / 2 + WALL_OVERLAP / 10, JoinType.Miter, MITER_LIMIT)
    pieces = [piece for piece in (walls - kept).decompose() if piece.area() > MIN_WALL_AREA]
    return CrossSection.batch_boolean(pieces, OpType.Add) if pieces else CrossSection()
