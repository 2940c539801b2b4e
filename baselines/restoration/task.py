"""The training task of restoration: fresh views to learn from, images of the validation split to measure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from baselines.restoration.disparity import cropped_evidence
from baselines.restoration.edges import JUMP
from baselines.restoration.network import RESTORATION, UNMASKED, Mixture, RestorationConfig, RestorationNet
from baselines.restoration.views import Example, SceneViews, box_about, recorded_example
from baselines.training.validation import drawn_targets
from kit1000.dataset.reader import Dataset

VALIDATION_SCENES = 30  # spread evenly over the validation split
REACH = 7  # [px] from a jump of the truth, where a pixel counts as beside an edge
FAR = 1.0  # [px] of disparity: a pixel that far from the truth shows another surface

Batch = dict[str, Tensor]


class Key(NamedTuple):
    """A validation example: a crop about the pivot of a plate."""

    scene_id: str
    row: int
    column: int


@dataclass
class RestorationTask:
    """Restore a crop of one image."""

    training: SceneViews
    dataset: Dataset
    split: str
    model: RestorationNet
    kept: dict[Key, Example] = field(default_factory=dict)
    """The validation examples, once they are made: an image takes longer to read than to restore."""

    def example(self, rng: np.random.Generator) -> Example:
        """One of the crops of fresh views."""
        return self.training[int(rng.integers(len(self.training)))]

    def validation_keys(self) -> Sequence[Key]:
        """Crops about the slots of the drawn targets of VALIDATION_SCENES scenes; without masks, about the parts."""
        if not self.kept:
            scenes = [query.scene_id for query, sensor in drawn_targets(self.dataset, self.split, VALIDATION_SCENES)]
            for scene_id in dict.fromkeys(scenes):
                self._keep(scene_id)
        return list(self.kept)

    def validation_example(self, key: Key) -> Example:
        """The crop as the d415 recorded it, calibrated by the table."""
        if key not in self.kept:
            self._keep(key.scene_id)
        return self.kept[key]

    def _keep(self, scene_id: str) -> None:
        """Make the example of a scene."""
        labelled = self.training.labelled
        scene = self.dataset.split(self.split, truth=True).scene(scene_id)
        target = next(query for query in scene.queries if query.drawn)
        image, whole = recorded_example(self.dataset, self.split, scene_id, labelled)
        place = scene.truth_of(target.id).world_from_kit.xyz if labelled else target.pivot
        at = image.view.camera.project(image.view.world_from_camera.inverse().apply(place))
        column, row = np.rint(at).astype(int).tolist()
        self.kept[Key(scene_id, row, column)] = cropped_evidence(whole, box_about(row, column))

    def loss(self, batch: Batch) -> Tensor:
        """() mean over the pixels that count of the negative logarithm of the likelihood of the truth."""
        likely, counts = self._mixture(batch).log_likelihood(batch["truth"]), batch["counts"]
        return -(likely * counts).sum() / counts.sum().clamp(min=1)

    def measure(self, batch: Batch) -> Batch:
        """(B,) `edge_px`: mean absolute error beside edges; `far_edge`: share of pixels there that are off by FAR px;
        `plain_px`: mean absolute error elsewhere; all where it counts."""
        wrong = (self._mixture(batch).likeliest() - batch["truth"]).abs()
        beside = beside_jumps(batch["truth"])
        edge, plain = batch["counts"] & beside, batch["counts"] & ~beside
        return {
            "edge_px": _mean(wrong, edge),
            "far_edge": _mean((wrong > FAR).float(), edge),
            "plain_px": _mean(wrong, plain),
        }

    def _mixture(self, batch: Batch) -> Mixture:
        return self.model(*(batch[name] for name in ("disparity", "returned", "labels", "slope")))


def beside_jumps(truth: Tensor) -> Tensor:
    """(B, H, W) bool: pixels within REACH px, along rows and columns, of a jump of true disparities (B, H, W) [px]."""
    jumps = torch.zeros_like(truth)
    for axis in (1, 2):
        jump = (truth.diff(dim=axis).abs() > JUMP).to(truth.dtype)
        jumps.narrow(axis, 0, jump.shape[axis]).add_(jump)
    return F.max_pool2d(jumps, 2 * REACH + 1, 1, REACH) > 0


def _mean(values: Tensor, where: Tensor) -> Tensor:
    """(B,) means over bool (B, H, W); 0 where none is."""
    return (values * where).sum((1, 2)) / where.sum((1, 2)).clamp(min=1)


def restoration_task(dataset: Dataset, preset: str, labelled: bool = True) -> tuple[RestorationTask, RestorationConfig]:
    """The task with new weights, and the config of its network. labelled: whether it reads masks."""
    config = (RESTORATION if labelled else UNMASKED)[preset]
    model = RestorationNet(config).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    scenes = dataset.split("train").scene_ids
    views = SceneViews(
        dataset=dataset, scenes=scenes, seed=config.views_seed, count=config.views, labelled=config.labelled
    )
    return RestorationTask(views, dataset, "val", model), config
