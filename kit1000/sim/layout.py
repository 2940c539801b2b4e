"""Layouts: the poses of the assembly and of the loose parts, drawn without geometry, then simulated with it.

The table's half y > 0 is for the kits, y < 0 for the parts. A part's rest mode is how it is released: `upright` on its
insertion face, at a random yaw, or `tumbled`, dropped in a uniform rotation (it may then rest on that same face). They
come to rest apart from each other; in a crowded scene they are then pushed together (`kit1000.sim.crowding`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np
from scipy.spatial.distance import pdist

from kit1000.errors import Redraw
from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import length
from kit1000.pose import Pose, random_quaternions
from kit1000.sim.crowding import Crowding, draw_crowding, pushed_together
from kit1000.sim.footprints import footprint, footprint_distance
from kit1000.sim.settle import Release, RestPose, rounded_pose, settle
from kit1000.values import Assembly, Part, Slot

UPRIGHT, TUMBLED = "upright", "tumbled"
PART_UNSTABLE = "part unstable"  # redraw reason: an upright part moves after its release
UPRIGHT_SHARE = 0.6  # of the parts, for any number of parts in a scene

_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
TABLE_SIZE = (1.2, 1.6, 0.04)  # [m] along x, along y, thickness; centred on the origin, its top at z = 0
MIN_GAP = 5e-3  # [m] horizontal, between parts that are apart, and between either half's bodies and the line y = 0
KITS_CENTRE = np.array([0.0, 0.20])  # [m] of the assembly's bounding box, before its random shift
KITS_RADIUS = 0.19  # [m] about KITS_CENTRE: contains the shifted assembly
MAX_KITS_SHIFT = 0.05  # [m] along x and along y
DROP_BOUNDS = np.array([[-0.12, -0.30], [0.12, -0.06]])  # [m] lowest and highest drop point
PARTS_BOUNDS = np.array([[-0.19, -0.345], [0.19, -MIN_GAP]])  # [m] the region of the parts that the cameras see
MAX_PART_RADIUS = 0.0435  # [m] half the diagonal of a cube of 50 mm
MAX_TRIES = 10_000  # draws of all drop points together; about one in thirty separates five parts
TUMBLED_DROP = 5e-3  # [m] initial height of the lowest point of a tumbled part
UPRIGHT_DROP = 2e-4  # [m] initial height of an upright part
MAX_UPRIGHT_SHIFT, MAX_UPRIGHT_ROTATION = 1e-3, np.radians(1)  # an upright part that moves more is unstable


@dataclass(frozen=True, eq=False)
class LayoutDraw:
    """The random numbers of a layout."""

    modes: tuple[str, ...]
    """UPRIGHT or TUMBLED, by part."""
    assembly_yaw: float
    """[rad]"""
    assembly_shift: np.ndarray
    """(2,) in -1..1: fraction of the largest shift that keeps the assembly within KITS_RADIUS."""
    drop_points: np.ndarray
    """(n, 2) [m]: above them the centres of the parts' boxes are released."""
    yaws: np.ndarray
    """(n,) [rad], used for upright parts."""
    tumbled_rotations: np.ndarray
    """(n, 4) quaternions world_from_part, used for tumbled parts."""
    scale: float = 1.0
    """Scale of both halves of the table; the lengths at the head of this module are those at 1."""
    crowding: Crowding | None = None
    """How the parts are pushed together; None: they stay apart."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The poses of the bodies of a scene."""

    world_from_assembly: Pose
    world_from_parts: tuple[Pose, ...]


@cache
def table() -> Mesh:
    """The table as a box, z up, its top at z = 0, centred on the origin."""
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-1.0, 0.0)]) * TABLE_SIZE
    return Mesh(corners, _BOX_FACES)


def draw_rest_modes(rng: np.random.Generator, n: int) -> tuple[str, ...]:
    """The rest modes of n parts. Each is upright with probability UPRIGHT_SHARE; of two or more at least one is."""
    modes = systematic_rest_modes(rng.random(), n)
    return tuple(modes[i] for i in rng.permutation(n))  # so that all pairs of parts are alike


def systematic_rest_modes(offset: float, n: int) -> tuple[str, ...]:
    """The systematic sample at an offset of 0..1 (Madow 1949): n UPRIGHT_SHARE are upright, rounded up or down."""
    counts = np.floor(UPRIGHT_SHARE * np.arange(n + 1) + offset)
    return tuple(UPRIGHT if step else TUMBLED for step in np.diff(counts))


def draw_layout(
    rng: np.random.Generator, modes: Sequence[str], crowded: bool = False, scale: float = 1.0
) -> LayoutDraw:
    """The random numbers of a layout for parts of these rest modes.

    The numbers do not depend on the modes. A crowded layout draws the same numbers first, then extra ones.
    """
    n = len(modes)
    yaw, shift = float(rng.uniform(0, 2 * np.pi)), rng.uniform(-1, 1, 2)
    yaws, tumbles = rng.uniform(0, 2 * np.pi, n), random_quaternions(rng, n)
    drop_points = scale * _draw_drop_points(rng, n)
    crowding = draw_crowding(rng, n) if crowded else None
    return LayoutDraw(tuple(modes), yaw, shift, drop_points, yaws, tumbles, scale, crowding)


def simulate_layout(assembly: Assembly, parts: Sequence[tuple[Part, Slot]], draw: LayoutDraw) -> Layout:
    """Place the assembly as drawn, release the parts, let them settle, and push them together if drawn so.

    Raises Redraw when a part does not come to rest, an upright one is unstable, one leaves its half, or two come to
    rest nearer to each other than MIN_GAP.
    """
    releases = [_release(draw, i, *pair) for i, pair in enumerate(parts)]
    rests = settle(releases)
    for mode, release, rest in zip(draw.modes, releases, rests, strict=True):
        _check_rest(mode, release, rest)
    poses = tuple(rest.world_from_part for rest in rests)
    footprints = [footprint(part.mesh, pose) for (part, _), pose in zip(parts, poses, strict=True)]
    low, high = draw.scale * PARTS_BOUNDS
    if any((outline < low).any() or (outline > high).any() for outline in footprints):
        raise Redraw("part left its half")
    if any(footprint_distance(a, b) < MIN_GAP for a, b in combinations(footprints, 2)):
        raise Redraw("parts touch")
    if draw.crowding is not None:
        shifts = pushed_together(footprints, draw.crowding, draw.scale * PARTS_BOUNDS)
        poses = tuple(
            rounded_pose(Pose(pose.wxyz, pose.xyz + (*shift, 0.0))) for pose, shift in zip(poses, shifts, strict=True)
        )
    return Layout(_place_assembly(assembly.mesh, draw), poses)


def _draw_drop_points(rng: np.random.Generator, n: int) -> np.ndarray:
    """(n, 2) [m]: uniform among all sets of points at which parts cannot touch, whatever their rotations."""
    for _ in range(MAX_TRIES):
        points = rng.uniform(DROP_BOUNDS[0], DROP_BOUNDS[1], (n, 2))
        if pdist(points).min(initial=np.inf) >= 2 * MAX_PART_RADIUS + MIN_GAP:
            return points
    raise Redraw("no room for the parts")


def _release(draw: LayoutDraw, i: int, part: Part, slot: Slot) -> Release:
    """Release part i with the centre of its box above its drop point."""
    upright = draw.modes[i] == UPRIGHT
    yaw = Pose.from_rotvec([0.0, 0.0, draw.yaws[i]])
    rotation = Pose((yaw @ slot.kit_from_part).wxyz if upright else draw.tumbled_rotations[i], np.zeros(3))
    centre = rotation.rotate(part.mesh.bounds.mean(0))[:2]
    height = (UPRIGHT_DROP if upright else TUMBLED_DROP) - rotation.rotate(part.mesh.vertices)[:, 2].min()
    return Release(part.mesh, part.mass, Pose(rotation.wxyz, np.array([*draw.drop_points[i] - centre, height])))


def _check_rest(mode: str, release: Release, rest: RestPose) -> None:
    if not rest.stable:
        raise Redraw("part not at rest")
    motion = release.world_from_part.inverse() @ rest.world_from_part
    shift = length(rest.world_from_part.xyz - release.world_from_part.xyz)
    if mode == UPRIGHT and (shift > MAX_UPRIGHT_SHIFT or motion.angle() > MAX_UPRIGHT_ROTATION):
        raise Redraw(PART_UNSTABLE)


def _place_assembly(mesh: Mesh, draw: LayoutDraw) -> Pose:
    """world_from_assembly: rotated about the centre of its box and shifted, within KITS_RADIUS and on its half."""
    centre = mesh.bounds.mean(0)[:2]
    radius = np.linalg.norm(mesh.vertices[:, :2] - centre, axis=1).max()
    max_shift = np.clip(draw.scale * KITS_RADIUS - radius, 0, draw.scale * MAX_KITS_SHIFT)
    x, y = draw.scale * KITS_CENTRE + max_shift * draw.assembly_shift
    yaw = Pose.from_rotvec([0.0, 0.0, draw.assembly_yaw])
    offset = yaw.rotate([*centre, 0.0])
    return rounded_pose(Pose(yaw.wxyz, np.array([x, max(y, radius + 2 * MIN_GAP), 0.0]) - offset))
