"""The cavity of a part: what it sweeps when it leaves along z, grown sideways by the clearance; exact, not in stairs.

At height z the swept shadow S(z) is the union of all slices of the part at heights <= z, and the cavity there is S(z)
grown by a disc. Both together are the Minkowski sum of the part's underside with a level disc, swept up to the rim:
a union of prisms over level faces and of one hull for each convex patch of sloping ones. So the walls keep their
distance at every height, slopes stay slopes, and a plate has about a thousand faces. Walls that this leaves too thin
are opened away. Frame: the part stands on z = 0, insertion face down. All lengths are metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, FillRule, JoinType, Manifold, OpType

from kit1000.kits.patches import convex_patches
from kit1000.mesh import mesh_of

SAGITTA = 0.02e-3  # [m] width of the band that the chords of the disc stay within
OVERSIZE = 0.4 * SAGITTA  # the disc's corners lie this far outside the clearance, its chords 0.6 SAGITTA inside
OVER = 1e-3  # [m] cutters stick out of the rim
STEEP = 2e-4  # down-facing means a unit normal with z below -STEEP; steeper faces are walls: their edges sweep for them
LEVEL = 2e-6  # [m] a face that rises less is level
BRINK = 0.02e-3  # [m] "just above" and "just below" a ledge: lower steps are floor, not wall
HIDE = 0.5e-3  # [m] steps of height at which faces are tested for being hidden from below
STRIDE = 4e-3  # [m] between probed heights where the shadow changes
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
    """Cavity depth [m] for a part of a seated height [m]: 0.6 of it, at most 20 mm."""
    return min(20e-3, 0.6 * height)


def cut_cavity(standing: Manifold, depth: float, clearance: float, width: tuple[float, float]) -> Cavity:
    """The cavity for a solid standing on z = 0 about the origin, in a plate of width (x, y) [m]."""
    sunk = standing.trim_by_plane((0, 0, -1), -depth)
    triangles, level = _underside(sunk)
    grown = _grown_sweep(standing, triangles, level, depth, clearance)
    ledges = _ledges(triangles[level][:, 0, 2], depth)
    shadows = _probe_shadows(standing, ledges)
    openings, probes = _open_thin_walls(grown, shadows, depth + OVER, width)
    solid = Manifold.batch_boolean([grown, *openings], OpType.Add) if openings else grown
    opened = (solid - grown).trim_by_plane((0, 0, -1), -depth).volume() if openings else 0.0
    walls = sum(piece.area() > SPECK for piece in probes[-1].opened.decompose())
    undercut = max(_swept_volume(shadows) - sunk.volume(), 0.0)
    return Cavity(depth, solid, tuple(probes), walls, opened, undercut)


def disc(clearance: float) -> np.ndarray:
    """(n, 2) corners of the polygon that stands for the disc: all within OVERSIZE outside, 0.6 SAGITTA inside."""
    radius = clearance + OVERSIZE
    corners = int(np.ceil(np.pi / np.arccos(1 - min(SAGITTA / radius, 0.5)) / 2)) * 2
    angles = np.arange(corners) * (2 * np.pi / corners)
    return radius * np.stack([np.cos(angles), np.sin(angles)], 1)


def shadow_below(standing: Manifold, z: float) -> CrossSection:
    """S(z): the shadow of everything of a standing solid below a height [m]."""
    return CrossSection(standing.trim_by_plane((0, 0, -1), -z).project().to_polygons(), FillRule.Positive)


def _underside(sunk: Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Down-facing triangles (m, 3, 3) and which of them are level, these pressed flat onto their lowest corner."""
    mesh = mesh_of(sunk)
    triangles = mesh.triangles[mesh.normals[:, 2] < -STEEP].copy()
    level = np.ptp(triangles[..., 2], axis=1) < LEVEL
    heights = np.sort(triangles[level][..., 2].min(1))
    lowest = heights[np.diff(heights, prepend=-np.inf) > LEVEL]
    if len(lowest):
        own = np.searchsorted(lowest, triangles[level][..., 2].min(1), side="right") - 1
        triangles[level] = np.concatenate(
            [triangles[level][..., :2], np.broadcast_to(lowest[own][:, None, None], (len(own), 3, 1))], axis=2
        )
    return triangles, level


def _grown_sweep(
    standing: Manifold, triangles: np.ndarray, level: np.ndarray, depth: float, clearance: float
) -> Manifold:
    """The Minkowski sum of an underside with the disc, swept up through the rim."""
    round_ = disc(clearance)
    flat, top = triangles[level], depth + OVER
    bodies = []
    for z in np.unique(flat[:, 0, 2]):
        outline = _grown_outline(flat[flat[:, 0, 2] == z][..., :2], round_)
        bodies.append(outline.extrude(top - z).translate((0, 0, z)))
    level_disc = np.concatenate([round_, np.zeros((len(round_), 1))], 1)
    for corners in _seen_from_below(standing, convex_patches(triangles[~level])):
        low = (corners[:, None] + level_disc).reshape(-1, 3)
        high = low.copy()
        high[:, 2] = top
        bodies.append(Manifold.hull_points(np.concatenate([low, high])))
    return Manifold.batch_boolean(bodies, OpType.Add)


def _seen_from_below(standing: Manifold, patches: list[np.ndarray]) -> list[np.ndarray]:
    """The patches that the part's own lower faces do not hide entirely."""
    shadows: dict[float, CrossSection] = {}
    seen = []
    for corners in patches:
        z = np.floor(corners[:, 2].min() / HIDE) * HIDE
        if z > 0:
            shadow = shadows.get(z) or shadows.setdefault(z, shadow_below(standing, z))
            if (CrossSection.hull_points(corners[:, :2]) - shadow).area() < NOTHING / 1e3:
                continue
        seen.append(corners)
    return seen


def _grown_outline(triangles: np.ndarray, round_: np.ndarray) -> CrossSection:
    """Level triangles (k, 3, 2) and the disc, as one outline: the union of all, and of the disc along each edge."""
    inner = CrossSection([triangle[::-1] for triangle in triangles], FillRule.Positive)
    edges = [
        CrossSection.hull_points(np.concatenate([a + round_, b + round_]))
        for loop in inner.to_polygons()
        for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True)
    ]
    return CrossSection.batch_boolean([inner, *edges], OpType.Add)


def _ledges(heights: np.ndarray, depth: float) -> list[float]:
    """Floor, level faces and rim: between them the shadow changes without a jump."""
    inside = heights[(heights > THIN / 10) & (heights < depth - THIN / 10)]
    return [0.0, *np.unique(inside).tolist(), depth]


def _probe_shadows(standing: Manifold, ledges: list[float]) -> list[tuple[float, CrossSection]]:
    """(z, S(z)) at both ends of each interval between ledges, and at a stride inside where the shadow changes."""
    probes = []
    for low, high in zip(ledges[:-1], ledges[1:], strict=True):
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
            lapped, floor = thin.offset(LAP, JoinType.Miter, MITER), (below + z) / 2
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
