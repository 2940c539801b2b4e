"""Small solids of known geometry, and slow but simple reference computations of what the package measures.

Solids are drawn in millimetres, standing on z = 0 about the z axis; `standing` and `as_part` convert them to metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from manifold3d import CrossSection, FillRule, Manifold, OpType

from kit1000.kits.cavity import Cavity, cut_cavity, insertion_depth
from kit1000.kits.goals import Design, find_goals
from kit1000.kits.kit import UNIT_PLATE, Plate, plate_mesh
from kit1000.kits.patches import EXACT, MERGED
from kit1000.kits.shadows import PartShadows
from kit1000.mesh import Mesh, mesh_from_solid, solid_from_mesh
from kit1000.pose import Pose
from kit1000.symmetry import Symmetry
from kit1000.values import Kit, Part, Slot

MM = 1e-3
X, Y, Z = np.eye(3)


def box(x: float, y: float, z: float, at: tuple[float, float, float] = (0, 0, 0)) -> Manifold:
    return Manifold.cube((x, y, z), center=True).translate((at[0], at[1], at[2] + z / 2))


def cylinder(d: float, h: float, top: float | None = None, segments: int = 96) -> Manifold:
    """A cylinder, or with another diameter at the top a frustum."""
    return Manifold.cylinder(h, d / 2, (d if top is None else top) / 2, segments)


def lying_cylinder(d: float, length: float) -> Manifold:
    """Along x, on z = 0."""
    return cylinder(d, length).translate((0, 0, -length / 2)).rotate((0, 90, 0)).translate((0, 0, d / 2))


def prism(sides: int, d: float, h: float) -> Manifold:
    """A regular prism of circumscribed diameter d."""
    return cylinder(d, h, segments=sides)


def ell(long: float = 40, short: float = 28, width: float = 12, height: float = 14) -> Manifold:
    """An L seen from above, one leg along x, one along y."""
    leg = box(long, width, height, (long / 2, width / 2, 0))
    return (leg + box(width, short, height, (width / 2, short / 2, 0))).translate((-long / 2, -short / 2, 0))


def ring_plate(hole: float, size: float = 36, height: float = 12, off: float = 0.0) -> Manifold:
    """A square plate with a through-hole, a little or much off its middle."""
    return box(size, size, height) - cylinder(hole, 3 * height).translate((off, 0, -height))


def upturned_tee() -> Manifold:
    """A flange of 30 x 20 x 4 with a stem of 10 x 20 x 16 on it."""
    return box(30, 20, 4) + box(10, 20, 20)


def leaning_prism() -> Manifold:
    """A triangular foot below, a post that leans out over it: sloped walls on all sides."""
    low = np.array([[-8, -8, 0], [8, -8, 0], [0, 10, 0]], dtype=float)
    high = low[[1, 2, 0]] * 1.6 + [9, 3, 26]
    return Manifold.hull_points(np.concatenate([low, high]))


def plug() -> Manifold:
    """A round foot under a square head: only the foot lies below the rim."""
    return cylinder(24, 12) + box(30, 30, 8, (0, 0, 12))


def random_solid(seed: int) -> Manifold:
    """Two to four boxes, cylinders and frusta, randomly rotated and joined, sometimes drilled; one body on z = 0."""
    rng = np.random.default_rng(seed)
    body = _random_piece(rng)
    for _ in range(rng.integers(1, 4)):
        shift = rng.uniform(-9, 9, 3)
        body = body + _random_piece(rng).translate(shift)
    if rng.random() < 0.5:
        body = body - cylinder(rng.uniform(8, 12), 200, segments=32).translate((*rng.uniform(-6, 6, 2), -100))
    body = max(body.decompose(), key=lambda piece: piece.volume())
    low = body.bounding_box()
    return body.translate((-(low[0] + low[3]) / 2, -(low[1] + low[4]) / 2, -low[2]))


def _random_piece(rng: np.random.Generator) -> Manifold:
    size = rng.uniform(9, 30, 3)
    kind = rng.integers(3)
    if kind == 0:
        piece = box(*size)
    elif kind == 1:
        piece = cylinder(size[0], size[2], segments=32)
    else:
        piece = cylinder(size[0], size[2], top=size[1], segments=32)
    return piece.translate((0, 0, -size[2] / 2)).rotate(tuple(rng.choice([0, 0, 90, 30, 55], 3)))


def standing(solid: Manifold) -> Manifold:
    """In metres."""
    return solid.scale((MM, MM, MM))


def as_part(solid: Manifold, symmetry: Symmetry | None = None, name: str = "p") -> Part:
    """In metres about its centroid, axes as drawn."""
    mesh = mesh_from_solid(standing(solid))
    mesh = Mesh(mesh.vertices - mesh.centroid, mesh.faces)
    return Part(name, "test", mesh, symmetry or Symmetry.none(), {}, 0.01)


def cavity_of(solid: Manifold, depth: float, clearance: float = 2.5e-3, joined: bool = True) -> Cavity:
    return cut_cavity(PartShadows.of(standing(solid), depth), clearance, (0.2, 0.2), MERGED if joined else EXACT)


@dataclass(frozen=True, eq=False)
class Seated:
    """A part in the pose it was drawn in, and the cavity for that pose."""

    part: Part
    kit_from_part: Pose
    shadows: PartShadows
    cavity: Cavity

    def kit(self, goals: Pose | None = None, plate: Plate = UNIT_PLATE, clearance: float = 2.5e-3) -> Kit:
        """A kit with the given goals; by default the design pose alone."""
        goals = Pose.stack([self.kit_from_part]) if goals is None else goals
        slot = Slot(self.part.id, self.kit_from_part, clearance, self.cavity.depth, goals)
        return Kit("k", plate_mesh(self.cavity, plate), slot, np.array([*plate.width, plate.thickness]))


def seated(solid: Manifold, symmetry: Symmetry | None = None, depth: float | None = None, clearance: float = 2.5e-3):
    """The part seated as it is drawn, in a cavity of the usual depth."""
    part = as_part(solid, symmetry)
    height = float(part.mesh.extents[2])
    depth = insertion_depth(height) if depth is None else depth
    pose = Pose.from_translation(np.array([0, 0, -depth - part.mesh.bounds[0, 2]]))
    lowered = part.mesh.moved(pose).vertices + [0, 0, depth]
    solid_m = solid_from_mesh(Mesh(lowered, part.mesh.faces))
    shadows = PartShadows.of(solid_m, depth)
    return Seated(part, pose, shadows, cut_cavity(shadows, clearance, UNIT_PLATE.width))


def pair_of(solid: Manifold, symmetry: Symmetry | None = None, clearance: float = 2.5e-3) -> tuple[Part, Kit]:
    """A part and its kit with all goals, inserted as drawn."""
    place = seated(solid, symmetry, clearance=clearance)
    goals, axis = find_goals(Design(place.part.mesh, place.part.symmetry, place.kit_from_part, place.shadows))
    kit = place.kit(goals, clearance=clearance)
    return place.part, replace(kit, slot=replace(kit.slot, free_axis=axis))


def most_yaw(x: float, y: float, clearance: float) -> float:
    """[rad] to which a rectangle [mm] turns in its outline grown by a clearance [mm] with round corners."""
    yaws = np.arange(0, np.pi, 1e-4)
    c, s = np.cos(yaws), np.sin(yaws)
    out = np.zeros_like(yaws)
    for px, py in ((x / 2, y / 2), (-x / 2, y / 2)):
        beyond = np.maximum(np.abs(np.stack([c * px - s * py, s * px + c * py], 1)) - np.array([x, y]) / 2, 0)
        out = np.maximum(out, np.linalg.norm(beyond, axis=1))
    return float(yaws[np.argmax(out > clearance)])


def snail_cam(mirrored: bool = False) -> Manifold:
    """A cam that jams at once when its step turns forward, and late when it turns back."""
    angles = np.radians(np.arange(0, 361, 5.0))
    radii = 14 + 6 * angles / (2 * np.pi)
    outline = np.stack([radii * np.cos(angles), radii * np.sin(angles)], 1)
    return Manifold.extrude(CrossSection([outline[::-1] * [1, -1] if mirrored else outline]), 20)


def slice_union(solid: Manifold, z: float, step: float = 0.2e-3) -> CrossSection:
    """The union of the level sections at all heights up to z [m]: every `step`, and just beside every corner."""
    corners = np.unique(mesh_from_solid(solid).vertices[:, 2].round(9))
    beside = np.concatenate([corners - 1e-7, corners + 1e-7, np.arange(step / 2, z, step), [z]])
    heights = np.unique(beside[(beside > 0) & (beside <= z)])
    return CrossSection.batch_boolean([solid.slice(h) for h in heights], OpType.Add)


def outline_points(loops: list[np.ndarray], spacing: float = 0.25e-3) -> np.ndarray:
    """(n, 2) points along closed polygons."""
    points = []
    for loop in loops:
        for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            n = int(np.linalg.norm(b - a) // spacing) + 1
            points.append(a + (b - a) * (np.arange(n) / n)[:, None])
    return np.concatenate(points) if points else np.zeros((0, 2))


def gaps(points: np.ndarray, shape: CrossSection) -> np.ndarray:
    """(n,) [m] brute-force distance of points to a shape; negative inside (depth), positive outside."""
    loops = shape.to_polygons()
    nearest = np.full(len(points), np.inf)
    winding = np.zeros(len(points))
    for loop in loops:
        for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            share = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-30), 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
            u, v = a - points, b - points
            winding += np.arctan2(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0], (u * v).sum(1))
    return np.where(np.abs(winding) > np.pi, -nearest, nearest)


def polygon(points: list[tuple[float, float]]) -> CrossSection:
    return CrossSection([np.array(points, dtype=float)], FillRule.Positive)
