"""The clearance of a finished plate, measured on its mesh: horizontally, from the walls to the part's shadow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.kits.cavity import Cavity, Probe
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.numerics.compiled import compiled

SPACING = 0.5e-3  # [m] between measured points of a wall
HEIGHT_COUNT = 5  # heights at which clearance is measured, spread over the probes of the cavity
HEIGHT_TOLERANCE = (
    0.01e-3  # [m] error allowed in the height of a wall: on a shallow slope a micron up is many microns across
)
ROUNDING = 1 - 1e-9  # of the square of a distance to a box: an edge farther away than the nearest so far is left out
OPENING_MARGIN = 0.1e-3  # [m] wall points this near a removed wall belong to its opening, not to a kept wall


@dataclass(frozen=True)
class Clearance:
    """Horizontal distances between the kept walls and the part's shadow, over all measured points [m]."""

    smallest: float
    largest: float


def measure_clearance(plate: Mesh, cavity: Cavity, heights: int = HEIGHT_COUNT) -> Clearance:
    """The clearance of a plate in the kit frame (rim at z = 0), measured at several heights."""
    solid = solid_from_mesh(plate)
    picks = np.unique(np.linspace(0, len(cavity.probes) - 1, heights).round().astype(int))
    nearest, farthest = [np.inf], [0.0]
    for probe in (cavity.probes[i] for i in picks):
        z, section = probe.shadow
        above = _kept_walls(solid, probe, z + HEIGHT_TOLERANCE - cavity.depth)
        below = _kept_walls(solid, probe, z - HEIGHT_TOLERANCE - cavity.depth)
        nearest.append(distances(above, section).min(initial=np.inf))
        farthest.append(distances(below, section).max(initial=0.0))
    return Clearance(float(min(nearest)), float(max(farthest)))


def _kept_walls(solid: Manifold, probe: Probe, z: float) -> np.ndarray:
    """(n, 2) [m] points on the inner walls of the plate at a height, away from removed walls."""
    outer = np.array(solid.bounding_box()[3:5])
    points = [points_along(loop) for loop in solid.slice(z).to_polygons() if (np.abs(loop).max(0) < outer - 1e-6).all()]
    walls = np.concatenate(points) if points else np.zeros((0, 2))
    return walls if probe.removed_walls.is_empty() else walls[distances(walls, probe.removed_walls) > OPENING_MARGIN]


def points_along(loop: np.ndarray) -> np.ndarray:
    """(n, 2) points along a closed polygon: its corners, and others at most SPACING apart."""
    along = np.roll(loop, -1, axis=0) - loop
    steps = np.maximum(np.ceil(np.hypot(*along.T) / SPACING).astype(int), 1)
    edge = np.repeat(np.arange(len(loop)), steps)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(steps) - steps, steps)
    return loop[edge] + along[edge] * (number / steps[edge])[:, None]


def distances(points: np.ndarray, shape: CrossSection) -> np.ndarray:
    """(n,) [m] from points (n, 2) to a shape; 0 inside it."""
    loops = shape.to_polygons()
    if not loops or not len(points):
        return np.full(len(points), np.inf)
    starts = np.concatenate(loops)
    ends = np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])
    return _distances(np.ascontiguousarray(points), starts, ends)


@compiled
def _distances(points, starts, ends):
    """Distances (n,) of points (n, 2) to polygons with edges from starts to ends (m, 2); 0 for a point inside."""
    found = np.empty(points.shape[0])
    for k in range(points.shape[0]):
        px, py = points[k]
        nearest, inside = np.inf, False
        for e in range(starts.shape[0]):
            ax, ay = starts[e]
            bx, by = ends[e]
            ux, uy = bx - ax, by - ay
            if (ay > py) != (by > py) and px < ax + (py - ay) * (ux / uy):
                inside = not inside
            beside = max(min(ax, bx) - px, px - max(ax, bx), 0.0)
            above = max(min(ay, by) - py, py - max(ay, by), 0.0)
            if (beside * beside + above * above) * ROUNDING > nearest:
                continue
            dx, dy = px - ax, py - ay
            share = min(max((dx * ux + dy * uy) / max(ux * ux + uy * uy, 1e-300), 0.0), 1.0)
            dx, dy = dx - share * ux, dy - share * uy
            nearest = min(nearest, dx * dx + dy * dy)
        found[k] = 0.0 if inside else np.sqrt(nearest)
    return found
