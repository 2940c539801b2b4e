"""A scene of five parts with simple depth images, as an argument of the functions that make its queries."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from kit1000.camera import Camera, look_at
from kit1000.dataset.json_rows import Row
from kit1000.dataset.scene_queries import PartInScene, asking_tracks, scene_queries
from kit1000.pose import Pose, random_quaternions
from kit1000.queries.tracks import CURVES, TRACKS
from kit1000.sim.layout import TUMBLED, UPRIGHT
from kit1000.values import FIRST_PART_LABEL, FreeAxis, Slot, View

SCENE = "test-s0007"
CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
TRUE_CAMERA = look_at((0.7, -0.1, 0.6), (0, 0, 0))
MEASURED_CAMERA = Pose.from_rotvec((0.001, 0.002, -0.001), (1e-3, 0, -1e-3)) @ TRUE_CAMERA
PARTS = 5


def tilted(angle_deg: float, azimuth: float = 0.7) -> Pose:
    """world_from_kit of a tilted slot."""
    axis = np.array([-np.sin(azimuth), np.cos(azimuth), 0])
    return Pose.from_rotvec(np.radians(angle_deg) * axis, (0.02, 0.2, 0.06))


def part(index: int, tilt_deg: float = 30.0, mode: str = UPRIGHT, free: bool = False, goals: int = 1) -> PartInScene:
    """A part of a layout: upright with a random yaw, or in a random rotation."""
    rng = np.random.default_rng(100 + index)
    axis = FreeAxis(np.zeros(3), np.array([0.0, 0.0, 1.0])) if free else None
    stacked = Pose(random_quaternions(rng, goals), rng.uniform(-0.02, 0.02, (goals, 3)))
    lying = Pose.from_rotvec((0, 0, rng.uniform(-3, 3))) @ Pose(stacked.wxyz[0], np.zeros(3))
    turn = lying.wxyz if mode == UPRIGHT else random_quaternions(rng, 1)[0]
    world_from_part = Pose(turn, np.array([rng.uniform(-0.2, 0.2), -0.17, 0.015]))
    slot = Slot(f"part{index}", stacked[0], 2.5e-3, 8e-3, stacked, axis)
    return PartInScene(index, mode, world_from_part, tilted(tilt_deg, 0.3 + index), slot, None)


@dataclass(frozen=True)
class SceneArguments:
    """The arguments of `scene_queries`, with defaults."""

    parts: tuple[PartInScene, ...]
    views: dict[str, View]
    labels: np.ndarray
    target: int = 1
    curves: bool = False
    crowded: bool = False
    alone: bool = False
    seed: int = 3
    scene_id: str = SCENE

    def rows(self) -> list[Row]:
        return self.queries_and_truths()[0]

    def queries_and_truths(self) -> tuple[list[Row], dict[str, Row]]:
        asking = asking_tracks(
            self.scene_id, self.seed, tuple(TRACKS), self.parts, crowded=self.crowded, alone=self.alone
        )
        tracks = (*asking, *((CURVES,) if self.curves else ()))
        return scene_queries(self.scene_id, self.seed, tracks, self.views, self.labels, self.parts, self.target)

    def by_id(self) -> dict[str, Row]:
        return {row["id"]: row for row in self.rows()}


@cache
def images() -> tuple[dict[str, View], np.ndarray]:
    """Depth images of the sensors and their masks: a block of pixels for each part."""
    rng = np.random.default_rng(0)
    labels = np.zeros((48, 64), np.uint8)
    for i in range(PARTS):
        labels[10 + i : 20 + 3 * i, 12 * i : 12 * i + 8] = FIRST_PART_LABEL + i
    labels[:5] = 1
    depth = rng.uniform(0.7, 0.9, labels.shape)
    noisy = np.where(rng.random(labels.shape) < 0.2, 0, depth + rng.normal(0, 1e-3, labels.shape))
    measured = View(CAMERA, MEASURED_CAMERA, noisy)
    return {"ideal": View(CAMERA, TRUE_CAMERA, depth), "d415": measured, "photoneo": measured}, labels


def scene_arguments(**changes: Any) -> SceneArguments:
    views, labels = images()
    parts = (
        part(0, 8.0),
        part(1, 40.0, goals=4),
        part(2, 30.0, mode=TUMBLED, goals=2),
        part(3, 12.0, free=True),
        replace(part(4), invisibility="slot turned away"),
    )
    return replace(SceneArguments(parts, views, labels), **changes)
