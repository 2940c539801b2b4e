"""Assemblies: kits tilted against each other on brackets and ribs, and the checks that one is usable.

A side plate is PLATE_GAP away from the base and tilts down about its lower inner edge, so that the gap between them
widens upward and plates never intersect. Assembly frame: z up, flat underside at z = 0, origin below
the centre of the base plate's top face. All lengths are metres, all angles radians.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from manifold3d import Manifold, OpType
from scipy.spatial import ConvexHull

from kit1000.errors import Redraw
from kit1000.kits.brackets import OUTWARD, support_pieces
from kit1000.kits.cavity import MIN_WALL
from kit1000.kits.kit import PLATE_GAP
from kit1000.kits.printable_mesh import printable_mesh
from kit1000.kits.seating import BISECTION_STEP, InsertedPart, contact_offset
from kit1000.mesh import body_count, defect_float32, solid_from_mesh
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.parts.family import DENSITY
from kit1000.pose import Pose
from kit1000.values import Assembly, Kit, Mount, Part

MAX_BASE_TILT = np.radians(20)  # of the base in the world
SIDE_TILT_RANGE = (float(np.radians(10)), float(np.radians(45)))  # of a side plate against the base
MAX_WORLD_TILT = np.radians(45)  # of any plate in the world
GROUND_GAP = 6e-3  # [m] from the ground to the lowest corner of a plate
STABILITY_MARGIN = 5e-3  # [m] least distance from the centre of mass, seen from above, to the edge of the footprint
CAVITY_VOLUME_TOLERANCE = 1e-9  # [m^3] rounding leaves films on the walls of a cavity, up to 0.1 mm^3


@dataclass(frozen=True)
class SidePlate:
    """Where a plate beside the base stands."""

    direction: int  # 0..3: on the base's +x, +y, -x or -y side
    tilt: float  # [rad] against the base, outer edge down


@dataclass(frozen=True)
class AssemblyPlan:
    """The placement of the plates of an assembly."""

    base_tilt: float  # [rad] of the base in the world
    base_azimuth: float  # [rad] from x towards y: the direction in which the base slopes down
    sides: tuple[SidePlate, ...]


def draw_assembly(
    rng: np.random.Generator,
    kits: int,
    level_base: bool = False,
    side_tilt: tuple[float, float] = SIDE_TILT_RANGE,
    brackets: tuple[float, ...] = (),
) -> AssemblyPlan:
    """A plan for 1 to 5 kits, drawn again until no slot is tilted more than MAX_WORLD_TILT.

    side_tilt: [rad] range of a side plate against the base; brackets: [rad] angles to pick from instead.
    """
    while True:
        base_tilt = 0.0 if level_base else rng.uniform(0, MAX_BASE_TILT)
        azimuth = 0.0 if level_base else rng.uniform(0, 2 * np.pi)
        directions, tilts = rng.permutation(4)[: kits - 1], rng.uniform(*side_tilt, size=kits - 1)
        if brackets:
            tilts = rng.choice(brackets, size=kits - 1)
        sides = tuple(SidePlate(int(d), float(t)) for d, t in zip(directions, tilts, strict=True))
        plan = AssemblyPlan(float(base_tilt), float(azimuth), sides)
        if world_tilts(plan).max() <= MAX_WORLD_TILT:
            return plan


def world_tilts(plan: AssemblyPlan) -> np.ndarray:
    """(kits,) [rad] between each slot's axis and the vertical, the base first."""
    base = Pose.from_rotvec(_base_rotvec(plan))
    rotations = [base, *(base @ Pose.from_rotvec(_side_rotvec(side)) for side in plan.sides)]
    axes = np.array([rotation.rotation_matrix()[:, 2] for rotation in rotations])
    return np.arctan2(np.linalg.norm(axes[:, :2], axis=1), axes[:, 2])


def build_assembly(assembly_id: str, kits: Sequence[Kit], plan: AssemblyPlan) -> Assembly:
    """The assembly of kits on brackets and ribs, the first as the base. Raises Redraw when its mesh is unprintable."""
    return join_mounts(assembly_id, place_kits(kits, plan))


def join_mounts(assembly_id: str, mounts: tuple[Mount, ...]) -> Assembly:
    """The assembly of placed kits, the first as the base. Raises Redraw when its mesh is unprintable."""
    plates = [solid_from_mesh(mount.kit.mesh).transform(mount.assembly_from_kit.matrix()[:3]) for mount in mounts]
    solid = Manifold.batch_boolean([*plates, *support_pieces(mounts)], OpType.Add)
    return Assembly(assembly_id, printable_mesh(solid, "assembly"), mounts)


def place_kits(kits: Sequence[Kit], plan: AssemblyPlan) -> tuple[Mount, ...]:
    """The kits placed as planned, the lowest corner of all GROUND_GAP above the ground."""
    world_from_base = Pose.from_rotvec(_base_rotvec(plan))
    extent = kits[0].extent
    base_from_kit = [Pose.identity(), *(_base_from_side(extent, side) for side in plan.sides)]
    world_from_kit = [world_from_base @ pose for pose in base_from_kit]
    corners = np.array([(x, y, -extent[2]) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * (*extent[:2], 1)
    lift = GROUND_GAP - min(pose.apply(corners)[:, 2].min() for pose in world_from_kit)
    raised = Pose.from_translation(np.array([0, 0, lift]))
    return tuple(Mount(kit, raised @ pose) for kit, pose in zip(kits, world_from_kit, strict=True))


def check_assembly(assembly: Assembly, parts: Mapping[str, Part]) -> None:
    """Raise Redraw with a short reason when an assembly is not usable; parts: each slot's part by id."""
    _check_printable(assembly)
    _check_cavities(assembly)
    _check_paths(assembly, parts)
    _check_stability(assembly, parts)


def _base_rotvec(plan: AssemblyPlan) -> np.ndarray:
    """(3,) [rad] rotation vector that tilts the base down towards its azimuth."""
    return plan.base_tilt * np.array([-sine(plan.base_azimuth), cosine(plan.base_azimuth), 0])


def _side_rotvec(side: SidePlate) -> np.ndarray:
    """(3,) [rad] rotation vector that tilts the outer edge of a side plate down, in the frame of the base."""
    outward = OUTWARD[side.direction]
    return side.tilt * np.array([-outward[1], outward[0], 0])


def _base_from_side(extent: np.ndarray, side: SidePlate) -> Pose:
    outward = np.array([*OUTWARD[side.direction], 0])
    half = extent[side.direction % 2] / 2
    hinge = outward * (half + PLATE_GAP) - (0, 0, extent[2])
    rotation = Pose.from_rotvec(_side_rotvec(side))
    return Pose(rotation.wxyz, hinge + rotation.rotate(outward * half + (0, 0, extent[2])))


def _check_printable(assembly: Assembly) -> None:
    fault = defect_float32(assembly.mesh) or ("several bodies" if body_count(assembly.mesh) > 1 else None)
    if fault:
        raise Redraw(f"assembly not printable: {fault}")
    if assembly.mesh.bounds[0, 2] != 0:
        raise Redraw("assembly not printable: underside not at z = 0")


def _check_cavities(assembly: Assembly) -> None:
    """Every cavity is as open as in its kit, and at least MIN_WALL of wall is between any two."""
    boxes = [cavity_box(mount) for mount in assembly.mounts]
    if any(a.min_gap(b, 2 * MIN_WALL) < MIN_WALL for a, b in combinations(boxes, 2)):
        raise Redraw("cavities too close")
    plates = [mount.kit.mesh for mount in assembly.mounts]
    made = sum(float(np.prod(plate.extents)) - plate.volume for plate in plates)
    open_ = (Manifold.compose(boxes) - solid_from_mesh(assembly.mesh)).volume()
    if open_ < made - CAVITY_VOLUME_TOLERANCE:
        raise Redraw("cavity touched")
    if open_ > made + CAVITY_VOLUME_TOLERANCE or assembly.mesh.volume < sum(plate.volume for plate in plates):
        raise Redraw("plate not whole")


def cavity_box(mount: Mount) -> Manifold:
    """The block of a plate within which its cavity lies, in the assembly frame."""
    points, (width, depth, _) = mount.kit.mesh.vertices, mount.kit.extent
    inner = points[(np.abs(points[:, :2]) < np.array((width, depth)) / 2 - MIN_WALL / 2).all(1)]
    low, high = inner.min(0), inner.max(0)
    return Manifold.cube(high - low).translate(low).transform(mount.assembly_from_kit.matrix()[:3])


@dataclass(frozen=True, eq=False)
class _SeatedPart:
    """The part of a slot at the design pose."""

    part: InsertedPart
    assembly_from_part: Pose
    radius: float  # [m] of the ball about the part's origin that contains it


def _seated(mount: Mount, part: Part) -> _SeatedPart:
    kit_from_part = mount.kit.slot.kit_from_part
    radius = float(np.linalg.norm(part.mesh.vertices, axis=1).max())
    return _SeatedPart(InsertedPart.of(part.mesh, kit_from_part), mount.assembly_from_kit @ kit_from_part, radius)


def _check_paths(assembly: Assembly, parts: Mapping[str, Part]) -> None:
    """Every part reaches its slot along the slot's axis while all other parts are seated."""
    seated = [_seated(mount, parts[mount.kit.slot.part_id]) for mount in assembly.mounts]
    if any(contact_offset(one.part, assembly.mesh, one.assembly_from_part) > BISECTION_STEP for one in seated):
        raise Redraw("insertion path blocked")
    if any(_blocks(other, one) for one, other in permutations(seated, 2)):
        raise Redraw("insertion path blocked by a seated part")


def _blocks(other: _SeatedPart, moving: _SeatedPart) -> bool:
    """Whether a seated part blocks the insertion path of another; their bounding balls decide most cases."""
    axis = moving.assembly_from_part.rotate(moving.part.axis)
    apart = other.assembly_from_part.xyz - moving.assembly_from_part.xyz
    aside = apart - max(float(matmul(apart, axis)), 0.0) * axis
    if length(aside) > other.radius + moving.radius:
        return False
    fixed = other.part.mesh.moved(other.assembly_from_part)
    return contact_offset(moving.part, fixed, moving.assembly_from_part) > 0


def _check_stability(assembly: Assembly, parts: Mapping[str, Part]) -> None:
    """The centre of mass is STABILITY_MARGIN inside the footprint, whichever of the parts are seated."""
    mesh, slots = assembly.mesh, [mount.kit.slot for mount in assembly.mounts]
    poses = [mount.assembly_from_kit @ mount.kit.slot.kit_from_part for mount in assembly.mounts]
    masses = np.array([DENSITY * mesh.volume, *(parts[slot.part_id].mass for slot in slots)])
    centres = np.array([mesh.centroid, *(pose.xyz for pose in poses)])
    footprint = ConvexHull(mesh.vertices[mesh.vertices[:, 2] == 0, :2])
    inside = (
        matmul(-centres[:, :2], footprint.equations[:, :2].T) - footprint.equations[:, 2] - STABILITY_MARGIN
    )  # (1 + slots, edges)
    moments = masses[:, None] * inside
    # over each edge the worst load seats exactly the parts that pull towards it
    if (moments[0] + np.minimum(moments[1:], 0).sum(0)).min() < 0:
        raise Redraw("does not stand on its own")
