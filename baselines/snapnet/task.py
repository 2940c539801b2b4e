"""The training tasks of both networks: their examples, losses and validation measures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from baselines.snapnet.config import POSITION, ROTATION, Source
from baselines.snapnet.examples import Example, PositionExamples, QuerySampler, RotationExamples
from baselines.snapnet.position import PositionNet, position_loss, position_of
from baselines.snapnet.rotation import RotationNet, rotation_loss
from kit1000.dataset.reader import Dataset
from kit1000.perception.completion.kits import KitCompleter
from kit1000.perception.completion.parts import PartCompleter

VALIDATION_QUERIES = {"position": 100, "rotation": 96}  # spread evenly over the validation split

Batch = dict[str, Tensor]
Examples = TypeVar("Examples", PositionExamples, RotationExamples)


@dataclass
class QueryTask(Generic[Examples]):
    """Examples of one split for training, and of another for validation."""

    training: Examples
    validation: Examples
    validation_queries: int

    def example(self, rng: np.random.Generator) -> Example:
        """A part of any scene with a fresh guess."""
        return self.training.draw(rng)

    def validation_keys(self) -> Sequence[str]:
        """Ids of queries, spread evenly over their split."""
        return self.validation.sampler.keys(self.validation_queries)


@dataclass
class PositionTask(QueryTask[PositionExamples]):
    """Predict the position of the part at its goal."""

    model: PositionNet

    def validation_example(self, key: str) -> Example:
        """The query with its stored guess."""
        return self.validation.stored(key)

    def loss(self, batch: Batch) -> Tensor:
        """() cross-entropy over the cells, the mean over those examples that are inside the window."""
        losses = position_loss(self.model(batch["part"], batch["kit"]), batch["offset"], self.model.config)
        return losses.sum() / batch["inside"].sum().clamp(min=1)

    def measure(self, batch: Batch) -> Batch:
        """(B,) `position_mm`: error of the predicted offset."""
        predicted = position_of(self.model(batch["part"], batch["kit"]), self.model.config)
        return {"position_mm": 1e3 * torch.linalg.norm(predicted - batch["offset"], dim=1)}


@dataclass
class RotationTask(QueryTask[RotationExamples]):
    """Score candidate rotations of the part."""

    model: RotationNet

    def validation_example(self, key: str) -> Example:
        """The query with its stored guess, and all candidates."""
        return self.validation.stored(key, every=True)

    def loss(self, batch: Batch) -> Tensor:
        """() cross-entropy over the candidates."""
        return rotation_loss(self._logits(batch), batch["nearest"], batch["angles"], self.model.config).mean()

    def measure(self, batch: Batch) -> Batch:
        """(B,) `rotation_deg`: angle of the best candidate to the nearest correct rotation; `floor_deg`: the least."""
        degrees = torch.rad2deg(batch["angles"])
        best = self._logits(batch).argmax(1, keepdim=True)
        return {"rotation_deg": degrees.gather(1, best)[:, 0], "floor_deg": degrees.amin(1)}

    def _logits(self, batch: Batch) -> Tensor:
        return self.model(batch["part_points"], batch["kit_points"], batch["rotations"], batch.get("kit_volume"))


def position_task(dataset: Dataset, preset: str, source: Source, completion: Path | None = None) -> PositionTask:
    """The task of a position network with new weights.

    completion: stem of the weights of the network that completes parts of depth images; None fills columns.
    """
    config, samplers = POSITION[preset], _samplers(dataset, source, completion)
    training, validation = (PositionExamples(sampler, config) for sampler in samplers)
    return PositionTask(training, validation, VALIDATION_QUERIES["position"], PositionNet(config))


def rotation_task(
    dataset: Dataset, preset: str, source: Source, completion: Path | None = None, kit_completion: Path | None = None
) -> RotationTask:
    """The task of a rotation network with new weights; `completion` as for `position_task`.

    kit_completion: of the network that completes kits; None leaves free what no pixel shows.
    """
    config, samplers = ROTATION[preset], _samplers(dataset, source, completion, kit_completion)
    training, validation = (RotationExamples(sampler, config) for sampler in samplers)
    return RotationTask(training, validation, VALIDATION_QUERIES["rotation"], RotationNet(config))


def _samplers(
    dataset: Dataset, source: Source, completion: Path | None, kit_completion: Path | None = None
) -> Iterator[QuerySampler]:
    """Queries for training and for validation."""
    completer = None if completion is None else PartCompleter(completion)
    kit_completer = None if kit_completion is None else KitCompleter(kit_completion)
    for split in ("train", "val"):
        yield QuerySampler(dataset, split, source, completer=completer, kit_completer=kit_completer)
