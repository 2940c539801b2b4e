"""Parts and their kits with known poses, as exact volumes and as the method sees them."""

from __future__ import annotations

from functools import cache

import numpy as np
from manifold3d import Manifold

from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.perception.image_kinds import IDEAL
from kit1000.perception.observed.parts import HALF_WIDTH, PartBounds
from kit1000.pose import Pose
from kit1000.queries.motions import apply_error, goal_motion
from kit1000.registration.geometry.cavity import Cavity, find_cavity, plate_grid
from kit1000.registration.part_volume import PartShape
from kit1000.registration.search import Candidate
from kit1000.voxels import Grid, Volume, signed_distance, surface_points
from tests.samples.shapes import Seated, box, cylinder, ell, seated

CLEARANCE = 2.5e-3
UP = np.array([0.0, 0.0, 1.0])
WORLD_FROM_KIT = Pose.from_rotvec((0.4, 0.2, 0.9), (0.3, -0.1, 0.15))
WORLD_FROM_PART = Pose.from_rotvec((1.2, -0.4, 2.0), (-0.1, 0.2, 0.03))
SIZE = np.array([30e-3, 20e-3, 12e-3])  # [m] of a cuboid


def cuboid(size: np.ndarray = SIZE) -> Mesh:
    """[m], about the origin."""
    mesh = mesh_from_solid(box(*size))
    return Mesh(mesh.vertices - mesh.bounds.mean(0), mesh.faces)


def volume_of(mesh: Mesh, pose: Pose | None = None) -> Volume:
    """A volume as the method makes them of parts, about the middle of a body."""
    pose = Pose.identity() if pose is None else pose
    grid = Grid.centred(Pose.from_translation(pose.xyz), (84, 84, 84), 1e-3)
    return signed_distance(grid, [(mesh, pose)], threads=1)


def columns(cell: float, cells: int) -> np.ndarray:
    """(n, n, 2) [m]: positions of the columns of an image."""
    steps = (np.arange(cells) - (cells - 1) / 2) * cell
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)


def known_cavity(heights: np.ndarray, world_from_plate: Pose | None = None, depth: float = 0.01) -> Cavity:
    """A cavity whose heights are known everywhere."""
    known = np.ones(heights.shape, bool)
    place = Pose.identity() if world_from_plate is None else world_from_plate
    return Cavity(place, heights, heights, known, heights < 0, depth, np.zeros((0, 3)), heights, heights)


def known_shape(part: Volume, middle: np.ndarray, bounds: PartBounds | None = None) -> PartShape:
    """A part whose shape is known exactly, or within bounds."""
    return PartShape(bounds or PartBounds(part, part, part), surface_points(part)[::20], middle, HALF_WIDTH)


class Case:
    """A part and its kit in different places, as exact volumes."""

    def __init__(self, known: Seated) -> None:
        self.goal = goal_motion(WORLD_FROM_PART, WORLD_FROM_KIT, known.kit_from_part)
        self.pivot = WORLD_FROM_PART.xyz + [1e-3, -2e-3, 1.5e-3]  # not the centre of the part
        around = Grid.centred(Pose.from_translation(self.pivot), (84, 84, 84), 1e-3)
        self.part: Volume = signed_distance(around, [(known.part.mesh, WORLD_FROM_PART)], threads=1)
        plate = WORLD_FROM_KIT @ Pose.from_rotvec((0, 0, 0.3), (5e-3, -3e-3, 0))
        grid = plate_grid(plate, 0.144)
        self.kit = signed_distance(grid, [(known.kit().mesh, WORLD_FROM_KIT)], threads=1)
        cavity = find_cavity(self.kit, plate, IDEAL.noise)
        assert cavity is not None
        self.cavity = cavity
        self.down_normal = self.goal.inverse().rotate(-WORLD_FROM_KIT.rotate(UP))

    def candidate(self, goal_from_now: Pose) -> Candidate:
        return Candidate(self.cavity, self.cavity.world_from_plate.inverse() @ goal_from_now, self.down_normal, 0.0)

    def error_of(self, plate_from_now: Pose) -> tuple[float, float]:
        """[mm] at the pivot and [degrees] from the goal."""
        error = self.cavity.world_from_plate @ plate_from_now @ self.goal.inverse()
        goal = self.goal.apply(self.pivot)
        return float(np.linalg.norm(error.apply(goal) - goal)) * 1e3, float(np.degrees(error.angle()))


def keyed() -> Manifold:
    return box(34, 22, 14) + box(10, 8, 14, (-6, 14, 0)) - box(8, 8, 40, (13, -9, -10))


def bar() -> Manifold:
    return box(44, 14, 12) + box(6, 6, 12, (-17, 8, 0))


def lever() -> Manifold:
    """A narrow web between eyes of two sizes."""
    eyes = cylinder(18, 12) + cylinder(10, 12).translate((26, 0, 0))
    return (eyes + box(26, 7, 12, (13, 0, 0))).translate((-10, 0, 0))


CASES = {"an L": ell, "a keyed block": keyed, "a bar": bar, "a lever": lever}


@cache
def case(name: str) -> Case:
    return Case(seated(CASES[name]()))


def perturbed(known: Case, seed: int) -> Candidate:
    """1.5 mm and 3 degrees beside the goal."""
    rng = np.random.default_rng(seed)
    shift, axis = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    return known.candidate(apply_error(known.goal, known.pivot, 1.5e-3 * shift, np.radians(3) * axis))
