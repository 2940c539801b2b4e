"""What the training loop needs of either network: its examples, its loss, and how well it has learnt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from baselines.snapnet.examples import Example, PositionExamples, RotationExamples
from baselines.snapnet.position import PositionNet, position_loss, position_of
from baselines.snapnet.rotation import RotationNet, rotation_loss

Batch = dict[str, Tensor]
Examples = TypeVar("Examples", PositionExamples, RotationExamples)


@dataclass
class Examined(Generic[Examples]):
    """Examples of one split to learn from, and of another to check by."""

    learn: Examples
    check: Examples
    checks: int
    """Queries to check by, spread evenly over their split."""

    def example(self, rng: np.random.Generator) -> Example:
        """A part of any scene with a fresh guess."""
        return self.learn.draw(rng)

    def check_examples(self) -> Sequence[str]:
        """Ids of queries."""
        return self.check.keys(self.checks)


@dataclass
class PositionTask(Examined[PositionExamples]):
    """Find where the part goes."""

    model: PositionNet

    def check_example(self, key: str) -> Example:
        """The query with its stored guess."""
        return self.check.check(key)

    def loss(self, batch: Batch) -> Tensor:
        """() cross-entropy over the cells, the mean over those examples that lie in the window."""
        losses = position_loss(self.model(batch["part"], batch["kit"]), batch["offset"], self.model.config)
        return losses.sum() / batch["inside"].sum().clamp(min=1)

    def measure(self, batch: Batch) -> Batch:
        """(B,) `position_mm`: how far the best place lies off."""
        found = position_of(self.model(batch["part"], batch["kit"]), self.model.config)
        return {"position_mm": 1e3 * torch.linalg.norm(found - batch["offset"], dim=1)}


@dataclass
class RotationTask(Examined[RotationExamples]):
    """Tell turned copies of the part apart."""

    model: RotationNet

    def check_example(self, key: str) -> Example:
        """The query with its stored guess, and every candidate."""
        return self.check.check(key, every=True)

    def loss(self, batch: Batch) -> Tensor:
        """() cross-entropy over the candidates that are shown."""
        return rotation_loss(self._logits(batch), batch["nearest"], batch["distances"], self.model.config).mean()

    def measure(self, batch: Batch) -> Batch:
        """(B,) `rotation_deg` of the best candidate from the nearest right turn, and `floor_deg` of the nearest."""
        degrees = torch.rad2deg(batch["distances"])
        best = self._logits(batch).argmax(1, keepdim=True)
        return {"rotation_deg": degrees.gather(1, best)[:, 0], "floor_deg": degrees.amin(1)}

    def _logits(self, batch: Batch) -> Tensor:
        return self.model(batch["part_points"], batch["kit_points"], batch["turns"], batch.get("kit_volume"))
