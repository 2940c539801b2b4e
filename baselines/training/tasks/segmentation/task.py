"""The training task of the network of centres: fresh views to learn from, images of the validation split to measure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from baselines.training.tasks.restoration.crop_task import CropTask, Recorded
from baselines.training.tasks.restoration.views import SENSOR
from baselines.training.tasks.segmentation.views import PartViews, recorded_example
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.segmentation.part_finder import CENTRES, OFFSET_UNIT, CentresConfig, CentresNet, Votes

Batch = dict[str, Tensor]


@dataclass
class CentresTask(CropTask[PartViews]):
    """Find the middles of the parts in a crop of one image."""

    model: CentresNet

    def recorded(self, scene_id: str) -> Recorded:
        """About the drawn part."""
        scene = self.dataset.split(self.split).scene(scene_id)
        pivot = next(query for query in scene.queries if query.drawn).pivot
        image = scene.labelled_depth(SENSOR)
        return Recorded(image.view, pivot, recorded_example(image, self.training.restorer))

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
    views = PartViews(
        dataset=dataset,
        scenes=scenes,
        seed=config.views_seed,
        count=config.views,
        restorer=restorer,
    )
    return CentresTask(views, dataset, "val", model), config
