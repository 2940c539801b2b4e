"""The training task of kit completion: fresh views to learn from, images of the validation split to measure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from baselines.training.tasks.kit_completion.views import Example, KitViews, example_of, mirrored, plane_of
from baselines.training.validation import drawn_targets
from kit1000.dataset.reader import Dataset
from kit1000.perception.completion.kits import (
    KIT_COMPLETION,
    KitCompletionConfig,
    KitCompletionNet,
    kit_loss,
    likely_depths,
)
from kit1000.perception.observed.kits import seen_heights
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.values import ASSEMBLY_LABEL

VALIDATION_SCENES = 20  # spread evenly over the validation split; each with ideal depth and with the d415's
BESIDE = 0.2  # weight of a cell beside the plate

Batch = dict[str, Tensor]


class Key(NamedTuple):
    """A validation example: the kit of the drawn target of a scene, seen by a sensor."""

    scene_id: str
    query_id: str
    sensor: str


@dataclass
class KitCompletionTask:
    """Complete the relief of a plate from one image."""

    training: KitViews
    dataset: Dataset
    split: str
    model: KitCompletionNet
    kept: dict[Key, Example] = field(default_factory=dict)
    """The validation examples, once they are made: an image takes longer to read than to complete."""

    def example(self, rng: np.random.Generator) -> Example:
        """One of the fresh views, or its mirror image."""
        view = self.training[int(rng.integers(len(self.training)))]
        return mirrored(view) if rng.integers(2) else view

    def validation_keys(self) -> Sequence[Key]:
        """The kits of the drawn targets of VALIDATION_SCENES scenes, by both sensors where the dataset has both."""
        targets = drawn_targets(self.dataset, self.split, VALIDATION_SCENES)
        keys = [Key(query.scene_id, query.id, sensor) for query, sensor in targets]
        self.kept = {key: self.kept.get(key) or self._example(key) for key in keys}
        return keys

    def validation_example(self, key: Key) -> Example:
        """The kit as its image shows it; that of the d415 is calibrated by the table and restored."""
        return self.kept.get(key) or self._example(key)

    def _example(self, key: Key) -> Example:
        scene = self.dataset.split(self.split, truth=True).scene(key.scene_id)
        truth = scene.truth_of(key.query_id)
        assembly = self.dataset.geometry.assembly(truth.assembly_id)
        mount = next(mount for mount in assembly.mounts if mount.kit.id == truth.part_id)
        pose = truth.world_from_kit
        sensor = simulated_sensor(key.sensor)
        image = calibrated_image(scene.labelled_depth(key.sensor), sensor)
        restored = self.training.restorer(image, sensor, (ASSEMBLY_LABEL,))
        relief = seen_heights(restored, plane_of(pose), pose.xyz, sensor.kind.best.noise)
        return example_of(relief, assembly, pose @ mount.assembly_from_kit.inverse(), mount)

    def loss(self, batch: Batch) -> Tensor:
        """() cross-entropy of the layers of hidden cells."""
        logits = self.model(batch["least"], batch["seen"], batch["camera"])
        weight = BESIDE + (1 - BESIDE) * batch["plate"].float()
        return kit_loss(logits, batch["least"], batch["seen"], batch["depth"], weight)

    def measure(self, batch: Batch) -> Batch:
        """(B,) `hidden_mm`: mean absolute error of the depth of hidden cells of the plate; 0 where none is."""
        logits = self.model(batch["least"], batch["seen"], batch["camera"])
        depth = torch.maximum(likely_depths(logits), batch["least"])
        hidden = batch["plate"] & ~batch["seen"]
        wrong = ((depth - batch["depth"]).abs() * hidden).sum((1, 2))
        return {"hidden_mm": wrong / hidden.sum((1, 2)).clamp(min=1)}


def kit_completion_task(
    dataset: Dataset, preset: str, restoration: Path
) -> tuple[KitCompletionTask, KitCompletionConfig]:
    """The task with new weights, and the config of its network.

    restoration: stem of the weights of the network that restores images of the d415.
    """
    config = KIT_COMPLETION[preset]
    model = KitCompletionNet(config).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    ids = sorted(id for id, row in dataset.geometry.assemblies.items() if row["split"] == "train")
    views = KitViews(
        dataset.geometry,
        ids,
        seed=config.views_seed,
        count=config.views,
        drawn=config.drawn_kits,
        drawn_share=config.drawn_share,
        stretched_share=config.stretched_share,
        restorer=Restorer(restoration),
    )
    return KitCompletionTask(views, dataset, "val", model), config
