"""The training task of the network of centres: fresh views to learn from, images of the validation split to measure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from baselines.restoration.disparity import cropped_evidence
from baselines.restoration.learned import Restorer
from baselines.restoration.views import SENSOR, box_about
from baselines.segmentation.network import CENTRES, OFFSET_UNIT, CentresConfig, CentresNet, Votes
from baselines.segmentation.views import Example, PartViews, recorded_example
from baselines.training.validation import drawn_targets
from kit1000.dataset.reader import Dataset

VALIDATION_SCENES = 30  # spread evenly over the validation split

Batch = dict[str, Tensor]


class Key(NamedTuple):
    """A validation example: a crop about the pivot of a part."""

    scene_id: str
    row: int
    column: int


@dataclass
class CentresTask:
    """Find the middles of the parts in a crop of one image."""

    training: PartViews
    dataset: Dataset
    split: str
    model: CentresNet
    kept: dict[Key, Example] = field(default_factory=dict)
    """The validation examples, once they are made."""

    def example(self, rng: np.random.Generator) -> Example:
        """One of the crops of fresh views."""
        return self.training[int(rng.integers(len(self.training)))]

    def validation_keys(self) -> Sequence[Key]:
        """Crops about the drawn parts of VALIDATION_SCENES scenes."""
        if not self.kept:
            for query, sensor in drawn_targets(self.dataset, self.split, VALIDATION_SCENES):
                if sensor == SENSOR:
                    self._keep(query.scene_id, query.pivot)
        return list(self.kept)

    def validation_example(self, key: Key) -> Example:
        """The crop as the d415 recorded it."""
        self.validation_keys()
        return self.kept[key]

    def _keep(self, scene_id: str, pivot: np.ndarray) -> None:
        """Make the example of a scene."""
        image = self.dataset.split(self.split).scene(scene_id).labelled_depth(SENSOR)
        at = image.view.camera.project(image.view.world_from_camera.inverse().apply(pivot))
        column, row = np.rint(at).astype(int).tolist()
        whole = recorded_example(image, self.training.restorer)
        self.kept[Key(scene_id, row, column)] = cropped_evidence(whole, box_about(row, column))

    def loss(self, batch: Batch) -> Tensor:
        """() cross entropy of showing a part, and the mean error of the votes of parts in units of OFFSET_UNIT."""
        votes, part = self._votes(batch), batch["part"]
        away = (votes.offset - _offsets(batch)).abs().sum(1) / OFFSET_UNIT
        told = F.binary_cross_entropy_with_logits(votes.part, part.to(votes.part.dtype))
        return told + (away * part).sum() / part.sum().clamp(min=1)

    def measure(self, batch: Batch) -> Batch:
        """(B,) `offset_px`: mean distance of the votes of parts from the middle of their part; `part`: share of pixels
        that are wrong about showing a part."""
        votes, part = self._votes(batch), batch["part"]
        away = (votes.offset - _offsets(batch)).square().sum(1).sqrt()
        return {
            "offset_px": (away * part).sum((1, 2)) / part.sum((1, 2)).clamp(min=1),
            "part": ((votes.part > 0) != part).float().mean((1, 2)),
        }

    def _votes(self, batch: Batch) -> Votes:
        return self.model(*(batch[name] for name in ("measured", "restored", "returned", "up")))


def _offsets(batch: Batch) -> Tensor:
    """(B, 2, H, W) [px] the true ones."""
    return torch.stack([batch["across"], batch["down"]], 1)


def centres_task(dataset: Dataset, preset: str, restoration: Path) -> tuple[CentresTask, CentresConfig]:
    """The task with new weights, and the config of its network. restoration: stem of weights, without masks."""
    config = CENTRES[preset]
    model = CentresNet(config).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    scenes = dataset.split("train").scene_ids
    restorer = Restorer(restoration)
    views = PartViews(dataset=dataset, scenes=scenes, seed=config.views_seed, count=config.views, restorer=restorer)
    return CentresTask(views, dataset, "val", model), config
