"""The training task of segmentation: crops of new views; and the fit of the weights by which pieces are merged."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from baselines.training.tasks.restoration import (
    CROPS,
    FACTS,
    SENSOR,
    CropTask,
    Example,
    Recorded,
    ViewCrops,
    body_pixel,
    box_about,
    fresh_image,
)
from kit1000.dataset.reader import Dataset
from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.restoration.disparity import cropped_inputs
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.segmentation.instances import find_bodies, pieces_of
from kit1000.perception.segmentation.part_finder import (
    CENTRES,
    OFFSET_UNIT,
    CentresConfig,
    CentresNet,
    Votes,
    inputs_between,
)
from kit1000.perception.segmentation.pieces import Pieces, best_pairs
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View

KITS_SHARE = 0.05  # of the crops: about a pixel of the kits
Batch = dict[str, Tensor]
WHOLE = 300  # [px] from which on a piece counts in full
RIDGE = 1.0  # penalty on the square of weights, each in units of its feature's spread
ROUNDS = 30  # of Newton


@dataclass(frozen=True, kw_only=True)
class PartViews(ViewCrops):
    """Crops of heights, with the middles of parts."""

    STREAM = "segmentation"
    restorer: Restorer
    """Restorer of images without masks."""

    def crops(self, rng: np.random.Generator) -> list[Example]:
        """About pixels of parts, and some of the kits."""
        image, _ = fresh_image(self.dataset, self.scenes, rng)
        whole = _example(image.labels, image.view, self.restorer.without_masks(image.view, FACTS))
        return [cropped_inputs(whole, box_about(*body_pixel(image.labels, KITS_SHARE, rng))) for _ in range(CROPS)]


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


if TYPE_CHECKING:
    from kit1000.perception.restoration.restorer import Restorer


def fitted(data: Path, sensor: str, scenes: int, restorer: Restorer | None = None) -> np.ndarray:
    """(f,) weights of the FEATURES, from the first scenes of the training split."""
    split = Dataset(data).split("train")
    rows: list[tuple[np.ndarray, bool, float]] = []
    for scene_id in split.scene_ids[:scenes]:
        image = split.scene(scene_id).labelled_depth(sensor)
        bodies = find_bodies(image.view, simulated_sensor(sensor), restorer)
        labels, joined, points, box = pieces_of(bodies)
        if labels.max() == 0:
            continue
        counts = np.zeros((int(labels.max()) + 1, 256))
        np.add.at(counts, (labels.ravel(), image.labels[box].ravel()), 1)
        counts[:, :FIRST_PART_LABEL] = 0
        _add_pairs(rows, Pieces.of(labels, joined, points, bodies.kind.segmentation.foot, 1.0), counts.argmax(1))
    features, same, weights = (np.array(column, float) for column in zip(*rows, strict=True))
    return logistic(features, same, weights)


def _add_pairs(rows: list[tuple[np.ndarray, bool, float]], pieces: Pieces, part: np.ndarray) -> None:
    """Add the pairs of each round when only pieces of one part merge, those with the least gap first."""
    while True:
        labels = list(pieces.by_label)
        pairs = [(i, j) for n, i in enumerate(labels) for j in labels[n + 1 :] if pieces.near(i, j)]
        features = [pieces.features(*pair) for pair in pairs]
        same = [bool(part[i] == part[j]) for i, j in pairs]
        for (i, j), row, is_same in zip(pairs, features, same, strict=True):
            size = min(pieces.by_label[i].size, pieces.by_label[j].size)
            rows.append((row, is_same, min(size, WHOLE) / WHOLE))
        scores = np.array([50 - row[1] if is_same else -1.0 for row, is_same in zip(features, same, strict=True)])
        chosen = best_pairs(pairs, scores)
        if not chosen:
            return
        for i, j in chosen:
            pieces.merge(i, j)


def logistic(features: np.ndarray, positive: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(f,) weights of a logistic regression on features (n, f), of which the first is 1."""
    middle, spread = features.mean(0), np.maximum(features.std(0), 1e-9)
    middle[0], spread[0] = 0, 1
    scaled = (features - middle) / spread
    solution = np.zeros(features.shape[1])
    penalty = np.append(0.0, np.full(len(solution) - 1, RIDGE))
    for _ in range(ROUNDS):
        p = 1 / (1 + np.exp(-np.clip(matmul(scaled, solution[:, None])[:, 0], -30, 30)))
        gradient = matmul((weights * (p - positive))[None], scaled)[0] + penalty * solution
        slopes = matmul((scaled * (weights * p * (1 - p))[:, None]).T, scaled) + np.diag(penalty + 1e-9)
        solution -= np.linalg.solve(slopes, gradient)
    own = solution / spread
    own[0] = solution[0] - (own[1:] * middle[1:]).sum()
    return own
