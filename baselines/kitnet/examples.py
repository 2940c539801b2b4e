"""The training task of KitNet and its examples: two views and the rotations that are correct between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from baselines.heights.maps import HeightMap
from baselines.heights.scene_heights import RenderedHeights
from baselines.heights.shell import shell_points
from baselines.kitnet.config import KITNET, KitNetConfig
from baselines.kitnet.network import KitNet, rotation_error, rotation_loss
from baselines.kitnet.views import CavityView, cavity_image, cavity_view, part_image
from baselines.training.tasks.goal_draws import GoalQuery, QueryDraws
from kit1000.dataset.reader import Dataset
from kit1000.perception.observed.plates import Plane
from kit1000.pose import Pose
from kit1000.rng import stream

MOST_GOALS = 64  # of an example
NEAR = float(np.radians(30))  # from a goal, within which a part without a guess begins: the range of the method
BAND = 0.05  # width of the wiped band, as a share of a view
PARTS = 4096  # whose shells are kept in memory: 0.1 MB each
Example = dict[str, np.ndarray]
VALIDATION_QUERIES = 100  # spread evenly over the validation split
Batch = dict[str, Tensor]


@dataclass
class KitNetTask:
    """Rotate a part into its slot. Validation examples are never trained on, as they are in the release.

    An example has `part`, `cavity` (P, P) float32 views; `goals` (MOST_GOALS, 4) float32 quaternions, `weights`
    (MOST_GOALS,) float32, 1 for a goal and 0 for a row without one.
    """

    training: QueryDraws
    validation: QueryDraws
    config: KitNetConfig
    model: KitNet

    def __post_init__(self) -> None:
        self._cavities: dict[tuple[str, int], CavityView | None] = {}
        self._points = lru_cache(PARTS)(points_of)

    def __reduce__(self) -> tuple[type[KitNetTask], tuple[QueryDraws, QueryDraws, KitNetConfig, KitNet]]:
        return KitNetTask, (self.training, self.validation, self.config, self.model)

    def example(self, rng: np.random.Generator) -> Example:
        """A part within some 30 degrees of a goal, rotated, shifted, with pixels wiped: with a guess, or upright."""
        sample = self.training.draw(rng, "ball" if rng.random() < 0.5 else "place")
        example = self._of(sample, rng, rng.uniform(-1, 1, (2, 2)) * self.config.shift)
        return example | {name: wiped(example[name], self.config.zeroed, rng) for name in ("part", "cavity")}

    def validation_keys(self) -> Sequence[str]:
        """Ids of queries, spread evenly over their split: of snap and of place alternately."""
        each = (self.validation.queries.keys(track, VALIDATION_QUERIES // 2) for track in ("snap", "place"))
        return [key for pair in zip(*each, strict=False) for key in pair]

    def validation_example(self, key: str) -> Example:
        """A stored query with its guess; without one the part begins at a yaw that depends on the id."""
        return self._of(self.validation.stored(key), stream(0, "kitnet", key), np.zeros((2, 2)))

    def _of(self, sample: GoalQuery, rng: np.random.Generator, shifts: np.ndarray) -> Example:
        config = self.config
        cavity, cavity_yaw = self._cavity(sample), rng.uniform(0, 2 * np.pi)
        image = np.zeros((config.pixels, config.pixels), np.float32)
        view_from_world = Pose.from_rotvec((0.0, 0.0, cavity_yaw))
        if cavity is not None:
            image = cavity_image(cavity, cavity_yaw, shifts[1], config.pixels, config.pixel)
            view_from_world = view_from_world @ rotation_of(cavity.world_from_view).inverse()
        goals = view_from_world @ rotation_of(sample.goals)
        if sample.guess is None:
            upright = np.hypot(goals.wxyz[:, 0], goals.wxyz[:, 3])  # 1 for a yaw alone
            w, _, _, z = goals.wxyz[rng.choice(np.flatnonzero(upright > upright.max() - 0.01))]
            yaw = 2 * np.arctan2(z, w) - rng.uniform(-NEAR, NEAR)
            part_from_world = Pose.from_rotvec((0.0, 0.0, yaw))
        else:
            part_from_world = view_from_world @ rotation_of(sample.guess)
        points = self._points(sample.heights.parts[sample.query.part], sample.guess is not None)
        part = part_image(part_from_world.rotate(points), shifts[0], config.pixels, config.pixel)
        rotations = (goals @ part_from_world.inverse()).wxyz[:MOST_GOALS]
        padded, weights = np.zeros((MOST_GOALS, 4), np.float32), np.zeros(MOST_GOALS, np.float32)
        padded[: len(rotations)], weights[: len(rotations)] = rotations, 1
        return {"part": part, "cavity": image, "goals": padded, "weights": weights}

    def _cavity(self, sample: GoalQuery) -> CavityView | None:
        """The cavity of the true slot: in training it is known, in use it is chosen."""
        key, world_from_kit = (sample.query.scene_id, sample.query.part), sample.truth.world_from_kit
        if key not in self._cavities:
            plane = Plane(world_from_kit.rotate((0.0, 0.0, 1.0)), world_from_kit.xyz, 0.0)
            self._cavities[key] = cavity_view(sample.heights.kits, plane)
        return self._cavities[key]

    def loss(self, batch: Batch) -> Tensor:
        """() the mean of `rotation_loss`."""
        return rotation_loss(self._predicted(batch), batch["goals"], batch["weights"]).mean()

    def measure(self, batch: Batch) -> Batch:
        """(B,) `rotation_deg`: the angle to the nearest goal."""
        return {"rotation_deg": torch.rad2deg(rotation_error(self._predicted(batch), batch["goals"], batch["weights"]))}

    def _predicted(self, batch: Batch) -> Tensor:
        return self.model(batch["part"], batch["cavity"])


def points_of(part: HeightMap, any_axis: bool) -> np.ndarray:
    """(n, 3) [m] world: what a view of a part is made of; rotated about the vertical alone it needs no shell."""
    points = part.points()
    if any_axis:
        return shell_points(part)
    return np.concatenate([points, points[:1] * (1.0, 1.0, 0.0)])  # one point on the table: heights count from there


def rotation_of(pose: Pose) -> Pose:
    """A pose without its shift."""
    return Pose(pose.wxyz, np.zeros_like(pose.xyz))


def wiped(view: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """A view with a share of its pixels and one straight band set to 0, as in the release."""
    pixels = len(view)
    middle, angle = rng.uniform(0, pixels, 2), rng.uniform(0, np.pi)
    i, j = np.indices(view.shape)
    across = (i - middle[0]) * np.cos(angle) + (j - middle[1]) * np.sin(angle)
    keep = (rng.random(view.shape) >= share) & (np.abs(across) > BAND * pixels / 2)
    return np.where(keep, view, np.float32(0))


def kitnet_task(dataset: Dataset, preset: str) -> KitNetTask:
    """The task with new weights."""
    config, heights = KITNET[preset], RenderedHeights.beside(dataset)
    training, validation = (QueryDraws(dataset, split, heights) for split in ("train", "val"))
    return KitNetTask(training, validation, config, KitNet(config))
