"""The training task of placement: fits of the train split to learn from, fits of the validation split to measure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from baselines.training.tasks.placement.changes import Changes, changed, drawn_changes, no_changes
from baselines.training.tasks.placement.placed_fits import PlacedFit, PlacedFits
from kit1000.dataset.reader import Dataset
from kit1000.perception.placement.network import LEVER, PLACEMENT, PlacementConfig, PlacementNet
from kit1000.registration.predictor import Registration
from kit1000.weights import WEIGHTS

IN_PLATE = slice(2, 5)
"""Yaw and shift of a twist; height and tilt are left as they are."""
MM = np.array([LEVER, 1e3, 1e3], np.float32)
"""Factors of yaw [rad] and shift [m] in the units of the network."""
SOFT = 0.2  # [mm] below which an error counts by its square

Batch = dict[str, Tensor]
Example = dict[str, np.ndarray]


@dataclass
class PlacementTask:
    """Move a fit to its goal."""

    training: PlacedFits
    validation: PlacedFits
    model: PlacementNet

    def example(self, rng: np.random.Generator) -> Example:
        """One of the fits, changed."""
        return _example(self.training.draw(rng), drawn_changes(rng))

    def validation_keys(self) -> Sequence[str]:
        """Ids of the queries whose fit is in the right slot."""
        return [query_id for query_id in self.validation.queries if self.validation.of(query_id) is not None]

    def validation_example(self, key: str) -> Example:
        """The fit as it is."""
        fit = self.validation.of(key)
        assert fit is not None, key
        return _example(fit, no_changes())

    def loss(self, batch: Batch) -> Tensor:
        """() the mean error, squared where it is small."""
        return (self._off(batch).square() + SOFT**2).sqrt().mean()

    def measure(self, batch: Batch) -> Batch:
        """(B,) `across_mm`: how far the placed fit is off in its plate; `yaw_deg`."""
        off = self._off(batch)
        return {
            "across_mm": off[:, 1:].square().sum(1).sqrt(),
            "yaw_deg": torch.rad2deg(off[:, 0].abs() / LEVER),
        }

    def _off(self, batch: Batch) -> Tensor:
        """(B, 3) what is left of moves."""
        changes = Changes(*(batch[name] for name in Changes._fields))
        patch, true = changed(batch["patch"].float(), batch["move"], changes)
        return self.model(patch, changes.mirrored) - true


def _example(fit: PlacedFit, changes: Example) -> Example:
    return {"patch": fit.channels, "move": MM * fit.twist[IN_PLATE], **changes}


def placement_task(
    dataset: Dataset, preset: str, completion: Path, restoration: Path
) -> tuple[PlacementTask, PlacementConfig]:
    """The task with new weights, and the config of its network. completion, restoration: stems of weights."""
    registration = Registration(
        dataset, completion=WEIGHTS / "completion", noisy_completion=completion, restoration=restoration
    )
    folder = dataset.root.with_name(f"{dataset.root.name}.fits")
    training, validation = (PlacedFits(registration, split, folder) for split in ("train", "val"))
    config = PLACEMENT[preset]
    model = PlacementNet(config).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    return PlacementTask(training, validation, model), config
