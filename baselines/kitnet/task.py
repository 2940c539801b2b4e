"""The training task of KitNet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from baselines.kitnet.config import KITNET, KitNetConfig
from baselines.kitnet.examples import Example, KitNetExamples
from baselines.kitnet.network import KitNet, rotation_error, rotation_loss
from baselines.training.tasks.goal_draws import QueryDraws
from kit1000.dataset.reader import Dataset
from kit1000.perception.heights.scene_heights import RenderedHeights

VALIDATION_QUERIES = 100  # spread evenly over the validation split
Batch = dict[str, Tensor]


@dataclass
class KitNetTask:
    """Rotate a part into its slot. Validation examples are never trained on, as they are in the release."""

    training: KitNetExamples
    validation: KitNetExamples
    model: KitNet

    def example(self, rng: np.random.Generator) -> Example:
        """A part of any scene, within some 30 degrees of a goal."""
        return self.training.draw(rng)

    def validation_keys(self) -> Sequence[str]:
        """Ids of queries, spread evenly over their split."""
        return self.validation.keys(VALIDATION_QUERIES)

    def validation_example(self, key: str) -> Example:
        """The query as it lies."""
        return self.validation.stored(key)

    def loss(self, batch: Batch) -> Tensor:
        """() the mean of `rotation_loss`."""
        return rotation_loss(self._predicted(batch), batch["goals"], batch["weights"]).mean()

    def measure(self, batch: Batch) -> Batch:
        """(B,) `rotation_deg`: the angle to the nearest goal."""
        return {"rotation_deg": torch.rad2deg(rotation_error(self._predicted(batch), batch["goals"], batch["weights"]))}

    def _predicted(self, batch: Batch) -> Tensor:
        return self.model(batch["part"], batch["cavity"])


def kitnet_task(dataset: Dataset, preset: str) -> tuple[KitNetTask, KitNetConfig]:
    """The task with new weights, and the network's config."""
    config, heights = KITNET[preset], RenderedHeights.beside(dataset)
    training, validation = (KitNetExamples(QueryDraws(dataset, split, heights), config) for split in ("train", "val"))
    return KitNetTask(training, validation, KitNet(config)), config
