"""Whether predicted motions seat their parts: the seating test against whole assemblies, with an exact judge at limits.

The closed form decides everywhere (`kit1000.kits.seating.contact_raise`); exact booleans are asked again where it lies
so near to a limit that the two might differ. Goal, axis and turn are those by which the pose errors judge.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property, partial
from typing import NamedTuple, Protocol

import numpy as np
from manifold3d import Manifold
from scipy.spatial import ConvexHull

from kit1000.engines import local
from kit1000.errors import InputError
from kit1000.kits.contact import Ridges, ridges
from kit1000.kits.seating import SEATED, STRICT, UP, Plug, Verdict, contact_raise, verdict
from kit1000.mesh import Mesh, solid_of
from kit1000.metrics.exact_seating import Sweep, Window, passes
from kit1000.metrics.pose_errors import nearest_goal_motions, pose_errors
from kit1000.metrics.targets import Targets, check_poses
from kit1000.pose import Pose
from kit1000.values import Assembly, Part, Truth

BANDS = {"near": 0.1e-3, "all": np.inf, "never": 0.0}
"""[m] By whom the judge is asked about: verdicts of the closed form so near to a limit are put before it."""
SAME_AXIS = 9  # decimals of a part's axis: turns of a goal about its own axis leave rounding in it


class Geometries(Protocol):
    """Where parts and assemblies are found by id: `kit1000.dataset.geometry.Geometry`, or anything alike."""

    def part(self, part_id: str) -> Part:
        """A part."""
        ...

    def assembly(self, assembly_id: str) -> Assembly:
        """An assembly."""
        ...


@dataclass(frozen=True, eq=False)
class Seatings:
    """What the seating test says of n predictions, one row a query; read-only."""

    seated: np.ndarray
    """(n,) bool: in the true slot, contact within min(3 mm, depth/3) of goal height, prediction within 3 mm of it."""
    strict: np.ndarray
    """(n,) bool: the same with 1 mm in place of 3."""
    penetration: np.ndarray
    """(n,) [m] how far the prediction lies below contact; 0 above it."""
    rise: np.ndarray
    """(n,) [m] from the prediction up to contact along the carried axis; -inf where nothing is below."""
    height: np.ndarray
    """(n,) [m] of contact above goal height, along the slot's axis; -inf where nothing is below."""
    judged: np.ndarray
    """(n,) bool: whether the exact judge was asked; its verdict then stands in `seated` and `strict`."""
    differs: np.ndarray
    """(n,) bool: whether it said otherwise than the closed form, in one of the two."""

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).setflags(write=False)


def seatings(
    predicted: Pose, truths: Sequence[Truth], geometry: Geometries, judge: str = "near", workers: int = 1
) -> Seatings:
    """Put predicted motions (n,) goal_from_now through the seating test.

    Args:
        predicted: one for each truth, in their order.
        truths: of n queries.
        geometry: where the parts and assemblies are.
        judge: whom the exact judge is asked about: "near" those within 0.1 mm of a limit, "all", or "never" anybody.
            Rise, height and penetration are always those of the closed form.
        workers: processes; the result does not depend on it.
    """
    check_poses("predicted", predicted, len(truths))
    if judge not in BANDS:
        raise InputError(f"judge: expected {', '.join(BANDS)}, got {judge!r}")
    if workers < 1:
        raise InputError(f"workers: expected 1 or more, got {workers}")
    found: list[_Found | None] = [None] * len(truths)
    with local(workers) as spread:
        for rows, group in spread(_tested, _benches(predicted, truths, geometry, judge)):
            for row, one in zip(rows, group, strict=True):
                found[row] = one
    return _packed([one for one in found if one is not None])


@dataclass(frozen=True)
class _Found:
    """What is said of one prediction."""

    closed: Verdict
    decided: Verdict
    judged: bool

    @property
    def row(self) -> tuple[bool, bool, float, float, float, bool, bool]:
        """In the order of the fields of Seatings."""
        closed, decided = self.closed, self.decided
        differs = (closed.seated, closed.strict) != (decided.seated, decided.strict)
        return decided.seated, decided.strict, closed.penetration, closed.rise, closed.height, self.judged, differs


def _packed(found: Sequence[_Found]) -> Seatings:
    types = (bool, bool, float, float, float, bool, bool)
    columns = zip(*(one.row for one in found), strict=True) if found else [()] * len(types)
    return Seatings(*(np.array(column, dtype) for column, dtype in zip(columns, types, strict=True)))


@dataclass(frozen=True, eq=False)
class _Place:
    """The kit of a part in its assembly."""

    assembly_from_kit: Pose
    extent: np.ndarray
    """(3,) [m] of the plate."""


@dataclass(frozen=True, eq=False)
class _Bench:
    """One assembly with all predictions about it: a job, small enough to be sent to another process."""

    assembly_id: str
    mesh: Mesh
    parts: dict[str, Mesh]
    places: dict[str, _Place]
    """By part."""
    rows: tuple[int, ...]
    predicted: Pose
    truths: tuple[Truth, ...]
    judge: str

    def __str__(self) -> str:
        return f"seating in {self.assembly_id}"


def _benches(predicted: Pose, truths: Sequence[Truth], geometry: Geometries, judge: str) -> Iterator[_Bench]:
    """One job an assembly, its meshes read when it is its turn."""
    groups: dict[str, list[int]] = {}
    for row, truth in enumerate(truths):
        groups.setdefault(truth.assembly_id, []).append(row)
    for assembly_id, rows in groups.items():
        assembly, about = geometry.assembly(assembly_id), tuple(truths[row] for row in rows)
        part_ids = dict.fromkeys(truth.part_id for truth in about)
        parts = {part_id: geometry.part(part_id).mesh for part_id in part_ids}
        places = {part_id: _place(assembly, part_id) for part_id in part_ids}
        yield _Bench(assembly_id, assembly.mesh, parts, places, tuple(rows), predicted[np.array(rows)], about, judge)


def _place(assembly: Assembly, part_id: str) -> _Place:
    mounts = [mount for mount in assembly.mounts if mount.kit.slot.part_id == part_id]
    if len(mounts) != 1:
        raise InputError(f"{assembly.id}: expected one slot for {part_id}, found {len(mounts)}")
    return _Place(mounts[0].assembly_from_kit, mounts[0].kit.extent)


def _tested(bench: _Bench) -> tuple[tuple[int, ...], list[_Found]]:
    """The rows of a job and what is said of each."""
    targets = Targets.of(bench.truths, lambda part_id: _hull(bench.parts[part_id]))
    home = nearest_goal_motions(targets, pose_errors(bench.predicted, targets))
    kit_from_world = Pose.stack([truth.world_from_kit for truth in bench.truths]).inverse()
    assembly_from_kit = Pose.stack([bench.places[truth.part_id].assembly_from_kit for truth in bench.truths])
    poses = kit_from_world @ bench.predicted @ targets.world_from_part
    goals = kit_from_world @ home @ targets.world_from_part
    tries = map(_Try, bench.truths, poses, assembly_from_kit @ poses, goals, goals.inverse().rotate(UP))
    tester = _Tester(bench)
    return bench.rows, [tester.test(one) for one in tries]


def _hull(mesh: Mesh) -> np.ndarray:
    """(v, 3) [m] the vertices of a mesh's convex hull."""
    return mesh.vertices[ConvexHull(mesh.vertices).vertices]


class _Try(NamedTuple):
    """One prediction with the goal that judges it."""

    truth: Truth
    kit_from_part: Pose
    assembly_from_part: Pose
    goal: Pose
    """kit_from_part"""
    axis: np.ndarray
    """(3,) unit, part frame: the direction out of the cavity at that goal."""


class _Tester:
    """The seating test in one assembly; what it needs of meshes is made once."""

    def __init__(self, bench: _Bench) -> None:
        self.bench = bench
        self.edges: Ridges = ridges(bench.mesh)
        self.bodies = {part_id: ridges(mesh) for part_id, mesh in bench.parts.items()}
        self.swept: dict[tuple[str, bytes], Sweep] = {}

    @cached_property
    def solid(self) -> Manifold:
        """The assembly as the judge sees it."""
        return solid_of(self.bench.mesh)

    def test(self, one: _Try) -> _Found:
        """The verdict on one prediction."""
        part_id, depth = one.truth.part_id, one.truth.slot.depth
        plug = Plug(self.bodies[part_id], one.axis)
        rise = contact_raise(plug, self.edges, one.assembly_from_part)
        closed = verdict(rise, plug, one.kit_from_part, one.goal, depth)
        xyz, carried = one.kit_from_part.xyz, one.kit_from_part.rotate(one.axis)
        if not _over_plate(xyz, carried, rise, self.bench.places[part_id].extent):
            closed = Verdict(rise, closed.height, False, False)
            return _Found(closed, closed, False)
        windows = [Window.of(limit, depth, carried[2], xyz[2] - one.goal.xyz[2]) for limit in (SEATED, STRICT)]
        band = BANDS[self.bench.judge]
        if not any(window.near(rise, band) for window in windows):
            return _Found(closed, closed, False)
        clear = cache(partial(self._swept(part_id, one.axis).clear, self.solid, one.assembly_from_part))
        judged = (passes(window, rise, band, clear) for window in windows)
        return _Found(closed, Verdict(rise, closed.height, *judged), True)

    def _swept(self, part_id: str, axis: np.ndarray) -> Sweep:
        key = part_id, (np.round(axis, SAME_AXIS) + 0.0).tobytes()
        if key not in self.swept:
            self.swept[key] = Sweep.of(self.bench.parts[part_id], axis)
        return self.swept[key]


def _over_plate(xyz: np.ndarray, carried: np.ndarray, rise: float, extent: np.ndarray) -> bool:
    """Whether the part's frame is over its own plate at contact: elsewhere it lies in no slot, or in a wrong one.

    xyz, carried: (3,) the pose [m] and its axis in the kit frame; where nothing is below, the pose itself counts.
    """
    contact = xyz + (rise if np.isfinite(rise) else 0.0) * carried
    return bool((np.abs(contact[:2]) <= extent[:2] / 2).all())
