"""The cavity of a part: what it sweeps when it leaves along z, grown sideways by the clearance; exact, not in stairs.

At height z the swept shadow S(z) is the union of all slices of the part at heights <= z, and the cavity there is S(z)
grown by a disc. Both together are the Minkowski sum of the part's underside with a level disc, swept up to the rim:
a union of prisms over level faces and of one hull for each convex patch of sloping ones. So the walls keep their
distance at every height, slopes stay slopes, and a plate has about a thousand faces. Walls that this leaves too thin
are opened away. Frame: the part stands on z = 0, insertion face down. All lengths are metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold, OpType

from kit1000.kits.sweep import OVER, grown_sweep, shadow_below

BRINK = 0.02e-3  # [m] "just above" and "just below" a ledge: lower steps are floor, not wall
STRIDE = 4e-3  # [m] between probed heights where the shadow changes
SHALLOW = 7e-3  # [m] of seated height: lower parts leave no cavity to speak of
PROUD = 3e-3  # [m] of a part that stands out of its cavity, to be taken by
THIN = 3e-3  # [m] walls, fins and posts thinner than this are opened away
MITER = 2.0  # corners sharper than 60 degrees count as thin
SPECK = 0.05e-6  # [m^2] smaller pieces of thin wall are rounding, not walls
LAP = 0.05e-3  # [m] an opening laps over the cavity beside it, so that no film of wall stays between
NOTHING = 1e-9  # [m^2] area that is rounding error


@dataclass(frozen=True, eq=False)
class Probe:
    """The cavity at one height."""

    z: float
    """[m] above the floor."""
    shadow: CrossSection
    """S(z)"""
    opened: CrossSection
    """Thin walls opened away here and below; empty where there were none."""


@dataclass(frozen=True, eq=False)
class Cavity:
    """A solid to cut out of a plate, from the floor (z = 0) to a little above the rim (z = depth)."""

    depth: float
    solid: Manifold
    probes: tuple[Probe, ...]
    """Heights at which the shadow was looked at, lowest first, the last just below the rim."""
    opened_walls: int
    """Thin walls, fins and posts opened away, counted at the rim."""
    opened_volume: float
    """[m^3] of wall opened away."""
    undercut_volume: float
    """[m^3] below the rim that the part sweeps but does not fill."""

    @property
    def rim(self) -> CrossSection:
        """The swept shadow at the rim."""
        return self.probes[-1].shadow


def insertion_depth(height: float) -> float:
    """Cavity depth [m] for a part of a seated height [m]: 0.6 of it, at most 20 mm, PROUD of it standing out.

    Parts lower than SHALLOW, which no dataset has, sink by 0.6 of their height whatever stands out.
    """
    return min(20e-3, 0.6 * height, height - PROUD if height >= SHALLOW else np.inf)


def cut_cavity(
    standing: Manifold, depth: float, clearance: float, width: tuple[float, float], joined: bool = True
) -> Cavity:
    """The cavity for a solid standing on z = 0 about the origin, in a plate of width (x, y) [m].

    joined: whether nearly convex neighbours may be grown as one, which is faster and up to 0.1 mm wider.
    """
    grown, levels = grown_sweep(standing, depth, clearance, joined)
    ledges = _ledges(levels, depth)
    shadows = _probe_shadows(standing, ledges)
    openings, probes = _open_thin_walls(grown, shadows, depth + OVER, width)
    solid = Manifold.batch_boolean([grown, *openings], OpType.Add) if openings else grown
    opened = (solid - grown).trim_by_plane((0, 0, -1), -depth).volume() if openings else 0.0
    walls = sum(piece.area() > SPECK for piece in probes[-1].opened.decompose())
    filled = standing.trim_by_plane((0, 0, -1), -depth).volume()
    undercut = max(_swept_volume(shadows) - filled, 0.0)
    return Cavity(depth, solid, tuple(probes), walls, opened, undercut)


def _ledges(levels: list[float], depth: float) -> list[float]:
    """Floor, level faces and rim: between them the shadow changes without a jump."""
    return [0.0, *(z for z in levels if THIN / 10 < z < depth - THIN / 10), depth]


def _probe_shadows(standing: Manifold, ledges: list[float]) -> list[tuple[float, CrossSection]]:
    """(z, S(z)) at both ends of each interval between ledges, and at a stride inside where the shadow changes."""
    probes = []
    for low, high in pairwise(ledges):
        ends = [(z, shadow_below(standing, z)) for z in (low + BRINK, high - BRINK)]
        inner: list[tuple[float, CrossSection]] = []
        if abs(ends[0][1].area() - ends[1][1].area()) > NOTHING:
            steps = 2 * int(np.ceil((high - low) / STRIDE))
            inner = [(z, shadow_below(standing, z)) for z in np.linspace(low, high, steps + 1)[1:-1]]
        probes += [ends[0], *inner, ends[1]]
    return probes


def _swept_volume(shadows: list[tuple[float, CrossSection]]) -> float:
    """[m^3] between floor and rim (trapezoids)."""
    z, areas = np.array([s[0] for s in shadows]), np.array([s[1].area() for s in shadows])
    return float(np.trapezoid(areas, z))


def _open_thin_walls(
    grown: Manifold, shadows: list[tuple[float, CrossSection]], top: float, width: tuple[float, float]
) -> tuple[list[Manifold], list[Probe]]:
    """What to cut besides the grown sweep: each probed height's thin walls, from half-way below up through the rim."""
    plate = CrossSection.square(width, center=True)
    openings, probes, opened, below = [], [], CrossSection(), 0.0
    for z, shadow in shadows:
        thin = _thin_walls(plate - grown.slice(z))
        if not thin.is_empty():
            lapped, floor = thin.offset(LAP, JoinType.Miter, MITER), (below + z) / 2 if probes else 0.0
            openings.append(lapped.extrude(top - floor).translate((0, 0, floor)))
            opened = opened + thin
        probes.append(Probe(z, shadow, opened))
        below = z
    return openings, probes


def _thin_walls(walls: CrossSection) -> CrossSection:
    """The parts of the walls in which no disc of diameter THIN fits; corners down to 60 degrees are not thin."""
    core = walls.offset(-THIN / 2, JoinType.Miter, MITER)
    kept = core.offset(THIN / 2 + LAP / 10, JoinType.Miter, MITER)
    pieces = [piece for piece in (walls - kept).decompose() if piece.area() > SPECK]
    return CrossSection.batch_boolean(pieces, OpType.Add) if pieces else CrossSection()
