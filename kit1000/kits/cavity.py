"""The cavity of a part: what the part sweeps when it leaves along z, grown sideways by the clearance; exact, no stairs.

The shadow S(z) is the projection along z, the insertion axis, of all of the part below a height z, and so a section of
what the part sweeps. The cavity at z is S(z) grown by a disc: the Minkowski sum of the part's underside with a level
disc, swept up to the rim, is a union of prisms over level faces and of one hull for each convex patch of sloping ones.
So the walls keep their distance at every height, slopes stay slopes, and a plate has about a thousand faces. Walls that
are too thin are removed by morphological opening. Frame: the part stands on z = 0, insertion face down. All lengths are
metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold, OpType

from kit1000.kits.patches import MERGED, Detail
from kit1000.kits.shadows import PartShadows, Shadow
from kit1000.kits.sweep import RIM_OVERSHOOT, grown_sweep

MIN_SEATED_HEIGHT = 7e-3  # [m] of a seated part: lower ones leave no useful cavity
MIN_PROTRUSION = 3e-3  # [m] of a part above the rim, for a gripper
MIN_WALL = 3e-3  # [m] walls, fins and posts thinner than this are removed
MITER_LIMIT = 2.0  # wall corners sharper than 60 degrees count as thin
MIN_WALL_AREA = 0.05e-6  # [m^2] smaller pieces of thin wall are rounding errors
WALL_OVERLAP = 0.05e-3  # [m] a removed wall is cut so much wider, so that no film stays between it and the cavity


@dataclass(frozen=True, eq=False)
class Probe:
    """The cavity at one height."""

    shadow: Shadow
    """What the part sweeps at this height."""
    removed_walls: CrossSection
    """Sections of thin walls removed here or below; empty where there were none."""


@dataclass(frozen=True, eq=False)
class Cavity:
    """A solid to cut out of a plate, from the floor (z = 0) to a little above the rim (z = depth)."""

    depth: float
    solid: Manifold
    probes: tuple[Probe, ...]
    """The cavity at several heights, lowest first, the last just below the rim."""
    removed_wall_count: int
    """Number of thin walls, fins and posts removed, counted at the rim."""
    grown: Manifold
    """The grown sweep: the solid with its thin walls."""
    part: PartShadows

    @cached_property
    def removed_wall_volume(self) -> float:
        """Volume of the thin walls that were removed. [m^3]"""
        if self.grown is self.solid:
            return 0.0
        return _below(self.solid - self.grown, self.depth).volume()

    @cached_property
    def undercut_volume(self) -> float:
        """[m^3] below the rim that the part sweeps but does not fill."""
        return max(_swept_volume(self.part.shadows) - _below(self.part.standing, self.depth).volume(), 0.0)


def insertion_depth(height: float) -> float:
    """Cavity depth [m] for a part of a seated height [m]: 0.6 of it, at most 20 mm, MIN_PROTRUSION left above the rim.

    Parts lower than MIN_SEATED_HEIGHT, which no dataset has, sink by 0.6 of their height whatever is left.
    """
    return min(20e-3, 0.6 * height, height - MIN_PROTRUSION if height >= MIN_SEATED_HEIGHT else np.inf)


def cut_cavity(part: PartShadows, clearance: float, width: tuple[float, float], detail: Detail = MERGED) -> Cavity:
    """The cavity of a clearance [m] for a standing part, in a plate of width (x, y) [m].

    detail: up to which nearly convex neighbouring faces are grown as one: faster, and up to 0.1 mm wider.
    """
    depth, shadows = part.depth, part.shadows
    grown = grown_sweep(part, clearance, detail)
    thin_walls, probes = _remove_thin_walls(grown, shadows, depth + RIM_OVERSHOOT, width)
    solid = Manifold.batch_boolean([grown, *thin_walls], OpType.Add) if thin_walls else grown
    removed_count = sum(piece.area() > MIN_WALL_AREA for piece in probes[-1].removed_walls.decompose())
    return Cavity(depth, solid, tuple(probes), removed_count, grown, part)


def _below(solid: Manifold, z: float) -> Manifold:
    return solid.trim_by_plane((0, 0, -1), -z)


def _swept_volume(shadows: tuple[Shadow, ...]) -> float:
    """[m^3] that the part sweeps between floor and rim (trapezoid rule)."""
    z, areas = np.array([s.z for s in shadows]), np.array([s.section.area() for s in shadows])
    return float(np.trapezoid(areas, z))


def _remove_thin_walls(
    grown: Manifold, shadows: tuple[Shadow, ...], top: float, width: tuple[float, float]
) -> tuple[list[Manifold], list[Probe]]:
    """Thin walls to cut as well, each from half-way to the probe below up to `top` [m]; and the probes."""
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
    """The parts of the walls in which no disc of diameter MIN_WALL fits; corners down to 60 degrees are not thin."""
    core = walls.offset(-MIN_WALL / 2, JoinType.Miter, MITER_LIMIT)
    kept = core.offset(MIN_WALL / 2 + WALL_OVERLAP / 10, JoinType.Miter, MITER_LIMIT)
    pieces = [piece for piece in (walls - kept).decompose() if piece.area() > MIN_WALL_AREA]
    return CrossSection.batch_boolean(pieces, OpType.Add) if pieces else CrossSection()
