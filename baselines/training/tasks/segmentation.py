"""The training task of segmentation: crops of new views."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import binary_dilation, binary_opening
from torch import Tensor

from baselines.training.tasks.restoration import (
    CROPS,
    FACTS,
    SENSOR,
    CropTask,
    Example,
    Recorded,
    ViewCrops,
    box_about,
    drawn_pixel,
    fresh_image,
)
from kit1000.dataset.reader import Dataset
from kit1000.perception.networks.unet import UNetConfig
from kit1000.perception.restoration.disparity import cropped_inputs
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.segmentation.instances import find_bodies, on_far_half, points_and_heights
from kit1000.perception.segmentation.part_finder import OFFSET_UNIT, CentresNet, Votes, inputs_between
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

SHARES = {"parts": 0.45, "touching": 0.25, "table": 0.25, "kits": 0.05}
"""Of the crops, by what their middle shows: a part, of whatever size; a place near two parts; a ripple of the table."""
BESIDE = 8  # [px] from both of two parts that touch, at most; from all bodies to a ripple, at least
RIPPLE, RIPPLE_REACH = 1.5e-3, 3  # [m] height and [px] half width of the ripples that look like parts, at least
Batch = dict[str, Tensor]
VIEWS = {"pretraining": (1500, 2030), "small": (2500, 2034), "measured": (30_000, 2050), "hard": (1500, 2060)}
"""Number and seed of the views by preset, each from the weights of the one before."""


@dataclass(frozen=True, kw_only=True)
class PartViews(ViewCrops):
    """Crops of heights, with the middles of parts."""

    STREAM = "segmentation"
    restorer: Restorer
    """Restorer of images without masks."""

    def crops(self, rng: np.random.Generator) -> list[Example]:
        """About pixels of parts, of those near two parts, of the table where it looks like a part, and of the kits."""
        image, _ = fresh_image(self.dataset, rng)
        restored = self.restorer.without_masks(image.view, FACTS)
        whole = _example(image.labels, image.view, restored)
        places = crop_places(image.labels, restored)
        kinds = rng.choice(list(SHARES), CROPS, p=list(SHARES.values()))
        masks = (places[kind][int(rng.integers(len(places[kind])))] for kind in kinds)
        return [cropped_inputs(whole, box_about(*drawn_pixel(mask, rng))) for mask in masks]


def crop_places(labels: np.ndarray, restored: View) -> dict[str, np.ndarray]:
    """By kind of SHARES the masks (n, H, W) bool from which the middles of crops are drawn; those of the parts where
    nothing is of that kind. labels: (H, W) the true masks of the restored view."""
    parts = np.array([labels == number for number in np.unique(labels) if number >= FIRST_PART_LABEL])
    near = np.array([binary_dilation(part, iterations=BESIDE) for part in parts])
    touching = near.sum(0) > 1
    points, heights = points_and_heights(restored)
    table = ~np.asarray(binary_dilation(labels > 0, iterations=BESIDE), bool) & ~on_far_half(points)
    ripple = binary_opening(table & (heights > RIPPLE), iterations=RIPPLE_REACH)
    masks = {"parts": parts, "touching": touching[None], "table": ripple[None], "kits": labels[None] == ASSEMBLY_LABEL}
    return {kind: mask if mask.any() else parts for kind, mask in masks.items()}


def recorded_example(image: LabelledDepth, restorer: Restorer) -> Example:
    """Inputs and truth of a recorded image, calibrated without masks."""
    bodies = find_bodies(image.view, FACTS, restorer)
    return _example(image.labels, bodies.measured, bodies.view)


def _example(labels: np.ndarray, measured: View, restored: View) -> Example:
    """The evidence, and the truth by masks (H, W): `part` bool, `across` and `down` float32 [px], 0 beside parts."""
    part = labels >= FIRST_PART_LABEL
    truth: Example = {"part": part}
    sizes = np.maximum(np.bincount(labels.ravel()), 1)
    for name, places in (("across", np.arange(labels.shape[1])), ("down", np.arange(labels.shape[0])[:, None])):
        here = np.broadcast_to(places, labels.shape)
        means = np.bincount(labels.ravel(), here.ravel().astype(float)) / sizes
        truth[name] = np.where(part, means[labels] - here, 0.0).astype(np.float32)
    return inputs_between(measured, restored) | truth


@dataclass
class CentresTask(CropTask[PartViews]):
    """Find the middles of the parts in a crop of one image."""

    model: CentresNet

    def whole(self, scene_id: str) -> Recorded:
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


def centres_task(dataset: Dataset, preset: str, restoration: Path) -> CentresTask:
    """The task with new weights. restoration: stem of the weights of the network that restores images without masks."""
    count, seed = VIEWS[preset]
    views = PartViews(dataset=dataset, count=count, seed=seed, restorer=Restorer(restoration))
    return CentresTask(views, dataset, "val", CentresNet(UNetConfig()))
