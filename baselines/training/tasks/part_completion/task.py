"""The training task of the completion network: fresh parts to learn from, parts of the validation split to measure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from baselines.training.tasks.part_completion.sampled_parts import DrawnParts
from baselines.training.tasks.part_completion.views import DrawnViews, Example, example_of
from baselines.training.validation import drawn_targets
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import user_cache
from kit1000.perception.completion.parts import (
    CODE,
    COMPLETION,
    CompletionConfig,
    CompletionNet,
    completion_loss,
    framed,
    scale_of,
)
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.values import FIRST_PART_LABEL

VALIDATION_SCENES = 50  # spread evenly over the validation split; each with ideal depth and with the d415's

Batch = dict[str, Tensor]


class Key(NamedTuple):
    """A validation example: the drawn target of a scene, seen by a sensor."""

    scene_id: str
    part: int
    sensor: str


@dataclass
class CompletionTask:
    """Complete a part from one image."""

    training: DrawnViews
    dataset: Dataset
    split: str
    model: CompletionNet
    kept: dict[Key, Example] = field(default_factory=dict)
    """The validation examples, once they are made: an image takes longer to read than to complete."""

    def example(self, rng: np.random.Generator) -> Example:
        """A fresh view of a fresh part."""
        return self.training.example(rng)

    def validation_keys(self) -> Sequence[Key]:
        """The drawn targets of VALIDATION_SCENES scenes, by the sensors of the training examples."""
        targets = drawn_targets(self.dataset, self.split, VALIDATION_SCENES)
        share = self.training.d415_share
        sensors = [name for name, of_all in (("ideal", 1 - share), ("d415", share)) if of_all > 0]
        keys = [Key(query.scene_id, query.part, sensor) for query, sensor in targets if sensor in sensors]
        self.kept = {key: self.kept.get(key) or self._example(key) for key in keys}
        return keys

    def validation_example(self, key: Key) -> Example:
        """The part as its image shows it; that of the d415 is calibrated by the table."""
        return self.kept.get(key) or self._example(key)

    def _example(self, key: Key) -> Example:
        scene = self.dataset.split(self.split, truth=True).scene(key.scene_id)
        image = calibrated_image(scene.labelled_depth(key.sensor), simulated_sensor(key.sensor))
        mesh, pose = scene.bodies()[2 + key.part]
        label = FIRST_PART_LABEL + key.part
        part = framed(image, label, scale=scale_of(image, label))
        if part is None:
            raise InputError(f"{key.scene_id}: the image shows no pixel of part {key.part}")
        return example_of(part, mesh, pose)

    def loss(self, batch: Batch) -> Tensor:
        """() cross-entropy and soft Jaccard distance of the cells that are not seen free."""
        return completion_loss(self.model(batch["codes"], batch["camera"]), batch["codes"], batch["solid"])

    def measure(self, batch: Batch) -> Batch:
        """(B,) `wrong`: 1 - IoU of the solid at p > 0.5; the same for the hidden cells; and the Brier score."""
        logits = self.model(batch["codes"], batch["camera"]).float().flatten(1)
        codes, share = batch["codes"].flatten(1), batch["solid"].flatten(1).float() / 255
        filled = torch.sigmoid(logits) * (codes < CODE)
        hidden = codes <= -CODE
        brier = (((filled - share) ** 2) * hidden).sum(1) / hidden.sum(1)
        return {
            "wrong": _wrong(filled > 0.5, share > 0.5),
            "wrong_hidden": _wrong((filled > 0.5) & hidden, (share > 0.5) & hidden),
            "brier_hidden": brier,
        }


def _wrong(filled: Tensor, solid: Tensor) -> Tensor:
    """(B,) 1 - IoU of bool (B, n)."""
    return 1 - (filled & solid).sum(1) / (filled | solid).sum(1).clamp(min=1)


def completion_task(dataset: Dataset, preset: str, **changes: Any) -> tuple[CompletionTask, CompletionConfig]:
    """The task with new weights, and the config of its network.

    Args:
        dataset: whose split val is validated on.
        preset: of the network.
        changes: of the config.
    """
    config = replace(COMPLETION[preset], **changes)
    parts = DrawnParts(config.parts_seed, config.parts, user_cache("drawn-parts"))
    model = CompletionNet(config).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    return CompletionTask(DrawnViews(parts, config.d415_share), dataset, "val", model), config
