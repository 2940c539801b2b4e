"""The training task of restoration: fresh views to learn from, images of the validation split to measure."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from baselines.training.tasks.restoration.crop_task import CropTask, Recorded, Views
from baselines.training.tasks.restoration.views import SceneViews, recorded_example
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration.restorer import RESTORATION, UNMASKED, Mixture, RestorationConfig, RestorationNet
from kit1000.perception.restoration.rules import JUMP

REACH = 7  # [px] from a jump of the truth, where a pixel counts as beside an edge
FAR = 1.0  # [px] of disparity: a pixel that far from the truth shows another surface

Batch = dict[str, Tensor]


@dataclass
class MixtureTask(CropTask[Views]):
    """Tell the mixture of each pixel of a crop that counts."""

    model: RestorationNet

    def loss(self, batch: Batch) -> Tensor:
        """() mean over the pixels that count of the negative logarithm of the likelihood of the truth."""
        likely, counts = self.mixture(batch).log_likelihood(batch["truth"]), batch["counts"]
        return -(likely * counts).sum() / counts.sum().clamp(min=1)

    def mixture(self, batch: Batch) -> Mixture:
        """What the network tells of a batch."""
        return self.model(*(batch[name] for name in ("disparity", "returned", "labels", "slope", "level")))


@dataclass
class RestorationTask(MixtureTask[SceneViews]):
    """Restore a crop of one image, calibrated by the table."""

    def recorded(self, scene_id: str) -> Recorded:
        """About the slot of the drawn target; without masks, about the part."""
        scene = self.dataset.split(self.split, truth=True).scene(scene_id)
        target = next(query for query in scene.queries if query.drawn)
        image, whole = recorded_example(self.dataset, self.split, scene_id, self.training.labelled)
        slot = scene.truth_of(target.id).world_from_kit.xyz
        return Recorded(image.view, slot if self.training.labelled else target.pivot, whole)

    def measure(self, batch: Batch) -> Batch:
        """(B,) `edge_px`: mean absolute error beside edges; `far_edge`: share of pixels there that are off by FAR px;
        `plain_px`: mean absolute error elsewhere; all where it counts."""
        wrong = (self.mixture(batch).likeliest() - batch["truth"]).abs()
        beside = beside_jumps(batch["truth"])
        edge, plain = batch["counts"] & beside, batch["counts"] & ~beside
        return {
            "edge_px": mean_where(wrong, edge),
            "far_edge": mean_where((wrong > FAR).float(), edge),
            "plain_px": mean_where(wrong, plain),
        }


def beside_jumps(truth: Tensor) -> Tensor:
    """(B, H, W) bool: pixels within REACH px, along rows and columns, of a jump of true disparities (B, H, W) [px]."""
    jumps = torch.zeros_like(truth)
    for axis in (1, 2):
        jump = (truth.diff(dim=axis).abs() > JUMP).to(truth.dtype)
        jumps.narrow(axis, 0, jump.shape[axis]).add_(jump)
    return F.max_pool2d(jumps, 2 * REACH + 1, 1, REACH) > 0


def mean_where(values: Tensor, where: Tensor) -> Tensor:
    """(B,) means over bool (B, H, W); 0 where none is."""
    return (values * where).sum((1, 2)) / where.sum((1, 2)).clamp(min=1)


def restoration_task(dataset: Dataset, preset: str, labelled: bool = True) -> tuple[RestorationTask, RestorationConfig]:
    """The task with new weights, and the config of its network. labelled: whether it reads masks."""
    config = (RESTORATION if labelled else UNMASKED)[preset]
    model = RestorationNet(config).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    scenes = dataset.split("train").scene_ids
    views = SceneViews(
        dataset=dataset,
        scenes=scenes,
        seed=config.views_seed,
        count=config.views,
        labelled=config.labelled,
    )
    return RestorationTask(views, dataset, "val", model), config
