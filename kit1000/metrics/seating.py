"""The seating test of predicted motions against whole assemblies, exact where the closed form is near a limit.

The closed form (`kit1000.kits.seating.contact_offset`) decides by default. Where its contact offset lies so near to a
limit that the two could disagree, the exact test by booleans decides (`kit1000.metrics.exact_seating`). The goal and
its angle about the free axis are those of smallest MSSD, as in the pose errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property, partial
from typing import NamedTuple, Protocol

import numpy as np
from manifold3d import Manifold
from scipy.spatial import ConvexHull

from kit1000.errors import InputError
from kit1000.kits.seating import (
    SEATED_LIMIT,
    STRICT_LIMIT,
    UP,
    InsertedPart,
    SeatingResult,
    contact_offset,
    is_rotation_seated,
    seating_result,
)
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.metrics.exact_seating import ContactInterval, SweptVolume, contact_in_interval
from kit1000.metrics.pose_errors import nearest_goal_motions, pose_errors
from kit1000.metrics.targets import Targets, check_poses
from kit1000.parallel import local_engine
from kit1000.pose import Pose
from kit1000.values import Assembly, Part, Truth

EXACT_BANDS = {"near": 0.1e-3, "all": np.inf, "never": 0.0}
"""[m] By mode: the exact test decides where the closed form's contact offset is nearer than this to a limit."""
AXIS_DECIMALS = 9  # to which two axes of a part are equal: rotating a goal about its own axis leaves rounding in it


class GeometrySource(Protocol):
    """Gives parts and assemblies by id: `kit1000.dataset.geometry.Geometry`, or anything with these methods."""

    def part(self, part_id: str) -> Part:
        """A part."""
        ...

    def assembly(self, assembly_id: str) -> Assembly:
        """An assembly."""
        ...


@dataclass(frozen=True, eq=False)
class Seatings:
    """Results of the seating test for n predictions, one row a query; read-only."""

    seated: np.ndarray
    """(n,) bool: in the true slot, contact within min(3 mm, depth/3) of goal height, prediction within 3 mm of it and
    rotated by at most 10 degrees from the nearest goal, or 2.4 degrees for each mm of clearance where that is more."""
    strict: np.ndarray
    """(n,) bool: the same with 1 mm in place of 3 mm."""
    penetration: np.ndarray
    """(n,) [m] how far the predicted pose lies below contact; 0 above it."""
    contact_offset: np.ndarray
    """(n,) [m] signed, from the predicted pose to contact along the part's axis; -inf where nothing is below."""
    contact_height: np.ndarray
    """(n,) [m] signed, from the goal to contact along the slot's axis; -inf where nothing is below."""
    exact: np.ndarray
    """(n,) bool: whether the exact test decided `seated` and `strict`."""
    disagrees: np.ndarray
    """(n,) bool: whether the exact test and the closed form differ in `seated` or `strict`."""

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).setflags(write=False)


def seatings(
    predicted: Pose, truths: Sequence[Truth], geometry: GeometrySource, exact: str = "near", workers: int = 1
) -> Seatings:
    """Test whether predicted motions (n,) goal_from_now seat their parts.

    Args:
        predicted: one for each truth, in their order.
        truths: of n queries.
        geometry: where the parts and assemblies are.
        exact: where the exact test decides: "near" a limit (within 0.1 mm), at "all" predictions, or "never".
            Offset, height and penetration are always those of the closed form.
        workers: processes; the result does not depend on it.
    """
    check_poses("predicted", predicted, len(truths))
    if exact not in EXACT_BANDS:
        raise InputError(f"exact: expected {', '.join(EXACT_BANDS)}, got {exact!r}")
    if workers < 1:
        raise InputError(f"workers: expected 1 or more, got {workers}")
    results: list[SeatingTestResult | None] = [None] * len(truths)
    with local_engine(workers) as run_jobs:
        for rows, group in run_jobs(_test_assembly, _assembly_jobs(predicted, truths, geometry, exact)):
            for row, result in zip(rows, group, strict=True):
                results[row] = result
    return as_seatings([result for result in results if result is not None])


@dataclass(frozen=True)
class SeatingTestResult:
    """The results of one prediction."""

    closed_form: SeatingResult
    final: SeatingResult
    exact: bool

    @property
    def row(self) -> tuple[bool, bool, float, float, float, bool, bool]:
        """In the order of the fields of Seatings."""
        closed, final = self.closed_form, self.final
        lengths = closed.penetration, closed.contact_offset, closed.contact_height
        disagrees = (closed.seated, closed.strict) != (final.seated, final.strict)
        return final.seated, final.strict, *lengths, self.exact, disagrees


def as_seatings(results: Sequence[SeatingTestResult]) -> Seatings:
    """Results of n predictions as one array (n,) a quantity."""
    types = (bool, bool, float, float, float, bool, bool)
    columns = zip(*(result.row for result in results), strict=True) if results else [()] * len(types)
    return Seatings(*(np.array(column, dtype) for column, dtype in zip(columns, types, strict=True)))


@dataclass(frozen=True, eq=False)
class _KitPlacement:
    """Where the kit of a part is in its assembly."""

    assembly_from_kit: Pose
    extent: np.ndarray
    """(3,) [m] of the plate."""


@dataclass(frozen=True, eq=False)
class _AssemblyJob:
    """One assembly with all predictions in it, small enough to be sent to another process."""

    assembly_id: str
    mesh: Mesh
    parts: dict[str, Mesh]
    kits: dict[str, _KitPlacement]
    """Kits by part id."""
    rows: tuple[int, ...]
    predicted: Pose
    truths: tuple[Truth, ...]
    exact: str

    def __str__(self) -> str:
        return f"seating in {self.assembly_id}"


def _assembly_jobs(
    predicted: Pose, truths: Sequence[Truth], geometry: GeometrySource, exact: str
) -> Iterator[_AssemblyJob]:
    """One job an assembly; its meshes are read when the job is taken."""
    groups: dict[str, list[int]] = {}
    for row, truth in enumerate(truths):
        groups.setdefault(truth.assembly_id, []).append(row)
    for assembly_id, rows in groups.items():
        assembly, own_truths = geometry.assembly(assembly_id), tuple(truths[row] for row in rows)
        part_ids = dict.fromkeys(truth.part_id for truth in own_truths)
        parts = {part_id: geometry.part(part_id).mesh for part_id in part_ids}
        kits = {part_id: _kit_placement(assembly, part_id) for part_id in part_ids}
        motions = predicted[np.array(rows)]
        yield _AssemblyJob(assembly_id, assembly.mesh, parts, kits, tuple(rows), motions, own_truths, exact)


def _kit_placement(assembly: Assembly, part_id: str) -> _KitPlacement:
    mounts = [mount for mount in assembly.mounts if mount.kit.slot.part_id == part_id]
    if len(mounts) != 1:
        raise InputError(f"{assembly.id}: expected one slot for {part_id}, found {len(mounts)}")
    return _KitPlacement(mounts[0].assembly_from_kit, mounts[0].kit.extent)


def _test_assembly(job: _AssemblyJob) -> tuple[tuple[int, ...], list[SeatingTestResult]]:
    """The rows of a job and the result of each."""
    targets = Targets.of(job.truths, lambda part_id: _hull_vertices(job.parts[part_id]))
    goal_motions = nearest_goal_motions(targets, pose_errors(job.predicted, targets))
    kit_from_world = Pose.stack([truth.world_from_kit for truth in job.truths]).inverse()
    assembly_from_kit = Pose.stack([job.kits[truth.part_id].assembly_from_kit for truth in job.truths])
    poses = kit_from_world @ job.predicted @ targets.world_from_part
    goals = kit_from_world @ goal_motions @ targets.world_from_part
    trials = map(_SeatingTrial, job.truths, poses, assembly_from_kit @ poses, goals, goals.inverse().rotate(UP))
    tester = _AssemblyTester(job)
    return job.rows, [tester.test(trial) for trial in trials]


def _hull_vertices(mesh: Mesh) -> np.ndarray:
    """(v, 3) [m] the vertices of a mesh's convex hull."""
    return mesh.vertices[ConvexHull(mesh.vertices).vertices]


class _SeatingTrial(NamedTuple):
    """One predicted pose with its nearest goal."""

    truth: Truth
    kit_from_part: Pose
    assembly_from_part: Pose
    goal: Pose
    """kit_from_part"""
    axis: np.ndarray
    """(3,) unit, part frame: the direction out of the cavity at that goal."""


class _AssemblyTester:
    """The seating test in one assembly; what it computes from meshes is kept for all predictions."""

    def __init__(self, job: _AssemblyJob) -> None:
        self.job = job
        self.swept_volumes: dict[tuple[str, bytes], SweptVolume] = {}

    @cached_property
    def solid(self) -> Manifold:
        """The assembly, for the exact test."""
        return solid_from_mesh(self.job.mesh)

    def test(self, trial: _SeatingTrial) -> SeatingTestResult:
        """The seating test of one prediction."""
        part_id, depth = trial.truth.part_id, trial.truth.slot.depth
        part = InsertedPart(self.job.parts[part_id], trial.axis)
        offset = contact_offset(part, self.job.mesh, trial.assembly_from_part)
        closed = seating_result(offset, part, trial.kit_from_part, trial.goal, depth, trial.truth.slot.clearance)
        xyz, axis = trial.kit_from_part.xyz, trial.kit_from_part.rotate(trial.axis)
        if not is_over_plate(xyz, axis, offset, self.job.kits[part_id].extent):
            closed = SeatingResult(offset, closed.contact_height, closed.fits, False, False)
            return SeatingTestResult(closed, closed, False)
        if not is_rotation_seated(trial.kit_from_part, trial.goal, trial.truth.slot.clearance):
            return SeatingTestResult(closed, closed, False)  # no contact would seat it
        height, limits = xyz[2] - trial.goal.xyz[2], (SEATED_LIMIT, STRICT_LIMIT)
        intervals = [ContactInterval.of(limit, depth, axis[2], height) for limit in limits]
        band = EXACT_BANDS[self.job.exact]
        if not any(interval.has_end_within(band, offset) for interval in intervals):
            return SeatingTestResult(closed, closed, False)
        swept = self._swept_volume(part_id, trial.axis)
        is_collision_free = cache(partial(swept.is_collision_free, self.solid, trial.assembly_from_part))
        passed = (contact_in_interval(interval, offset, band, is_collision_free) for interval in intervals)
        return SeatingTestResult(closed, SeatingResult(offset, closed.contact_height, closed.fits, *passed), True)

    def _swept_volume(self, part_id: str, axis: np.ndarray) -> SweptVolume:
        key = part_id, (np.round(axis, AXIS_DECIMALS) + 0.0).tobytes()
        if key not in self.swept_volumes:
            self.swept_volumes[key] = SweptVolume.of(self.job.parts[part_id], axis)
        return self.swept_volumes[key]


def is_over_plate(xyz: np.ndarray, axis: np.ndarray, offset: float, extent: np.ndarray) -> bool:
    """Whether the part's origin is over the plate of its own kit at contact; elsewhere it is in no slot or a wrong one.

    Args:
        xyz: (3,) [m] of the predicted pose in the kit frame.
        axis: (3,) unit, kit frame: the part's axis at that pose.
        offset: [m] to contact; where nothing is below, the predicted pose itself counts.
        extent: (3,) [m] of the plate.
    """
    contact = xyz + (offset if np.isfinite(offset) else 0.0) * axis
    return bool((np.abs(contact[:2]) <= extent[:2] / 2).all())
