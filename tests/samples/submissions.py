"""Submissions made for tests: predictions of known errors for the queries of a dataset, or for made-up queries."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmark.queries import ScoredQueries
from kit1000 import Dataset
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.parts.cad import polygon, prism
from kit1000.pose import Pose
from kit1000.queries.motions import goal_motion, goal_pose
from kit1000.queries.tracks import CURVES, TRACKS
from kit1000.submission import Manifest, Predictions, Submission, write_submission
from kit1000.values import FreeAxis, Query, Slot, Truth

Predictor = Callable[[Query, Truth], Pose]
SECONDS = 0.25


def manifest(dataset_id: str, **fields: Any) -> Manifest:
    defaults: dict[str, Any] = {
        "method": "a method",
        "authors": ("A. Name",),
        "description": "Made for a test.",
        "date": "2026-01-31",
        "dataset_id": dataset_id,
        "tracks": (*TRACKS, CURVES),
        "learned": False,
        "uses_true_geometry": True,
    }
    return Manifest(**defaults | fields)


def ground_truth(_: Query, truth: Truth) -> Pose:
    return goal_of(truth)


def goal_of(truth: Truth, goal: int = 0, angle: float = 0.0) -> Pose:
    """goal_from_now of a goal of the slot, rotated about the free axis by an angle [rad]."""
    return goal_motion(truth.world_from_part, truth.world_from_kit, goal_pose(truth.slot, goal, angle))


def predictions(query_ids: Iterable[str], motions: Iterable[Pose], confidence: float = 0.5) -> Predictions:
    ids = tuple(query_ids)
    return Predictions(ids, Pose.stack(list(motions)), np.full(len(ids), confidence), np.full(len(ids), SECONDS))


def predicted(
    folder: Path, dataset: Dataset, predictor: Predictor, splits: tuple[str, ...] = ("test", "curves"), **fields: Any
) -> Submission:
    """A submission with a prediction for every query of the splits, written to a folder."""
    ids, motions = [], []
    for recorded in (recorded for split in splits for recorded in dataset.split(split, truth=True)):
        for query in recorded.queries:
            ids.append(query.id)
            motions.append(predictor(query, recorded.truth_of(query.id)))
    return write_submission(folder, manifest(dataset.id, **fields), predictions(ids, motions))


def corner() -> Mesh:
    """An L of 40 x 30 x 24 mm about its centroid, in metres."""
    mesh = mesh_from_solid(prism(polygon([(0, 0), (40, 0), (40, 9), (14, 9), (14, 30), (0, 30)]), 24.0)).scaled(1e-3)
    return Mesh(mesh.vertices - mesh.centroid, mesh.faces)


class MadeUp:
    """A geometry of one part, the same for every query, without kits or assemblies."""

    def __init__(self) -> None:
        self.mesh = corner()
        self.summary = {"held_out_families": ["gear"]}

    def part(self, part_id: str) -> Any:
        return SimpleNamespace(id=part_id, mesh=self.mesh)


def slots(part_id: str, kind: int) -> Slot:
    """One goal, several, or a free axis."""
    design = Pose.from_rotvec((0.1, -0.2, 0.3), (1e-3, 2e-3, -8e-3))
    goals = [design, Pose.from_rotvec((0, 0, np.pi)) @ design] if kind == 1 else [design]
    axis = FreeAxis(np.array([1e-3, 2e-3, 0.0]), np.array([0.0, 0.0, 1.0])) if kind == 2 else None
    return Slot(part_id, design, 2.5e-3, 12e-3, Pose.stack(goals), axis)


def made_up(n: int = 12, track: str = "snap", seed: int = 0) -> ScoredQueries:
    """Queries about parts at random poses and slots of every symmetry: two per assembly."""
    rng = np.random.default_rng(seed)
    truths = [_made_up_truth(i, track, rng) for i in range(n)]
    scene_ids = tuple(f"test-s{i:04d}" for i in range(n))
    return ScoredQueries(MadeUp(), (track,) * n, scene_ids, tuple(truths))  # type: ignore[arg-type]


def _made_up_truth(i: int, track: str, rng: np.random.Generator) -> Truth:
    now = Pose.from_rotvec(rng.uniform(-2, 2, 3), rng.uniform(-0.2, 0.2, 3))
    tilt = np.radians(7 * i)
    slot = slots(f"part{i % 4}", i % 3)
    world_from_kit = Pose.from_rotvec((tilt, 0, 0), (0.1, 0.2, 0.05))
    return Truth(
        query_id=f"test-s{i:04d}-p0-{track}",
        assembly_id=f"test-{i // 2:04d}",
        part_id=slot.part_id,
        family="gear" if i % 4 == 0 else "bracket",
        rest_mode="upright" if i % 2 else "tumbled",
        kits=2 + i % 3,
        visible=0.5 + 0.04 * i,
        anchor=now.xyz,
        world_from_part=now,
        world_from_kit=world_from_kit,
        slot=slot,
        goal_drawn=goal_motion(now, world_from_kit, slot.goals[0]),
        crowded=i % 6 == 0,
        noise_px=0.05 * (i % 6),
    )
