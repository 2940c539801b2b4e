"""What is wrong with a motion: planted errors are named, whatever the query."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from benchmark.table2 import BOTH, EITHER, KINDS, POSITION, ROTATION, SEATS, WRONG_PLATE, failure_kinds
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.reader import Dataset
from kit1000.metrics import Targets
from kit1000.pose import Pose
from kit1000.values import Assembly, Mount, Part, Truth

ASIDE = Pose.from_translation([0.3, 0.0, 0.0])
SPLITS = ("train", "val", "test")
TILT = Pose.from_rotvec([np.radians(30.0), 0.0, 0.0])  # three times the limit of the seating test


@pytest.fixture(scope="module")
def dataset(mini: Path) -> Dataset:
    """The small generated dataset."""
    return Dataset(mini)


@pytest.fixture(scope="module")
def truths(dataset: Dataset) -> list[Truth]:
    """One of each scene."""
    drawn = [query for split in SPLITS for query in dataset.split(split).queries("snap") if query.drawn]
    return [dataset.truth_of(query) for query in drawn]


def hull(dataset: Dataset, part_id: str) -> np.ndarray:
    vertices = dataset.geometry.part(part_id).mesh.vertices
    return vertices[ConvexHull(vertices).vertices]


def raised(truth: Truth, metres: float) -> Pose:
    """The goal, lifted out of the cavity along its axis."""
    return Pose.from_translation(truth.world_from_kit.rotate(np.array([0, 0, metres]))) @ truth.goal_drawn


def tilted(truth: Truth, motion: Pose) -> Pose:
    """A motion whose result is tilted about the part's middle."""
    middle = Pose.from_translation(motion.apply(truth.anchor))
    return middle @ TILT @ middle.inverse() @ motion


def kinds(dataset: Dataset, truths: list[Truth], motions: list[Pose]) -> set[str]:
    targets = Targets.of(truths, lambda part_id: hull(dataset, part_id))
    return set(failure_kinds(Pose.stack(motions), truths, targets, dataset.geometry))


def test_planted_errors_are_named(dataset: Dataset, truths: list[Truth]) -> None:
    goals = [truth.goal_drawn for truth in truths]
    high = [raised(truth, 0.02) for truth in truths]
    assert kinds(dataset, truths, goals) == {SEATS}
    assert kinds(dataset, truths, high) == {POSITION}
    assert kinds(dataset, truths, [tilted(truth, truth.goal_drawn) for truth in truths]) == {ROTATION}
    assert kinds(dataset, truths, [tilted(*case) for case in zip(truths, high, strict=True)]) == {BOTH}
    assert len(set(KINDS)) == len(KINDS)
    assert {SEATS, WRONG_PLATE, ROTATION, POSITION, EITHER, BOTH} == set(KINDS)


@dataclass(frozen=True)
class Doubled:
    """The shapes of a dataset, with another plate ASIDE from each."""

    geometry: Geometry

    def part(self, part_id: str) -> Part:
        return self.geometry.part(part_id)

    def assembly(self, assembly_id: str) -> Assembly:
        assembly = self.geometry.assembly(assembly_id)
        others = []
        for mount in assembly.mounts:
            slot = replace(mount.kit.slot, part_id="another")
            others.append(Mount(replace(mount.kit, id="another", slot=slot), ASIDE @ mount.assembly_from_kit))
        return replace(assembly, mounts=(*others, *assembly.mounts))


def test_a_part_nearer_to_another_plate_is_at_the_wrong_one(dataset: Dataset, truths: list[Truth]) -> None:
    targets = Targets.of(truths, lambda part_id: hull(dataset, part_id))
    doubled = Doubled(dataset.geometry)
    for share, wrong in ((0.0, False), (0.4, False), (0.6, True), (1.0, True)):
        moved = []
        for truth in truths:
            own = next(m for m in doubled.assembly(truth.assembly_id).mounts if m.kit.id == truth.part_id)
            world_from_assembly = truth.world_from_kit @ own.assembly_from_kit.inverse()
            step = Pose.from_translation(world_from_assembly.rotate(share * ASIDE.xyz))
            moved.append(step @ truth.goal_drawn)
        found = failure_kinds(Pose.stack(moved), truths, targets, doubled)
        assert {kind == WRONG_PLATE for kind in found} == {wrong}
