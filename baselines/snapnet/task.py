"""The training tasks of both networks: their examples, losses and validation measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from baselines.snapnet.candidate_rotations import candidates, nearest_candidate
from baselines.snapnet.config import POSITION, ROTATION, PositionConfig, RotationConfig, Source
from baselines.snapnet.examples import QuerySample, QuerySampler
from baselines.snapnet.position import PositionNet, position_loss, position_of
from baselines.snapnet.rotation import RotationNet, rotation_loss
from kit1000.dataset.reader import Dataset
from kit1000.perception.completion.kits import KitCompleter
from kit1000.perception.completion.parts import PartCompleter
from kit1000.pose import Pose
from kit1000.rng import stream

VALIDATION_QUERIES = {"position": 100, "rotation": 96}  # spread evenly over the validation split
HARD = 64  # candidates nearest to the correct one: on the ball those within some 14 degrees
SEED = 0  # of the points and candidates of validation examples

Example = dict[str, np.ndarray]
Batch = dict[str, Tensor]


@dataclass
class PositionTask:
    """Predict the position of the part at its goal.

    Its examples: `part`, `kit` (nx, ny, nz) float32 volumes; `offset` (3,) float32 [m] from the guessed to the correct
    position of the pivot, along working axes; `inside` () bool, whether the window holds the cell nearest to it.
    """

    training: QuerySampler
    validation: QuerySampler
    config: PositionConfig
    model: PositionNet

    def example(self, rng: np.random.Generator) -> Example:
        """A part of any scene with a fresh guess; the same generator gives the same bytes."""
        return self._of(self.training.draw(rng))

    def validation_keys(self) -> Sequence[str]:
        """Ids of queries, spread evenly over their split."""
        return self.validation.keys(VALIDATION_QUERIES["position"])

    def validation_example(self, key: str) -> Example:
        """The query with its stored guess."""
        return self._of(self.validation.stored(key))

    def _of(self, sample: QuerySample) -> Example:
        window = np.array(self.config.window)
        cell = np.floor(sample.residual.offset / (2 * self.config.voxel) + window // 2 + 0.5)
        return sample.volumes.position_inputs(sample.guess, sample.world_from_work, self.config) | {
            "offset": sample.residual.offset.astype(np.float32),
            "inside": np.asarray(((cell >= 0) & (cell < window)).all()),
        }

    def loss(self, batch: Batch) -> Tensor:
        """() cross-entropy over the cells, the mean over those examples that are inside the window."""
        losses = position_loss(self.model(batch["part"], batch["kit"]), batch["offset"], self.config)
        return losses.sum() / batch["inside"].sum().clamp(min=1)

    def measure(self, batch: Batch) -> Batch:
        """(B,) `position_mm`: error of the predicted offset."""
        predicted = position_of(self.model(batch["part"], batch["kit"]), self.config)
        return {"position_mm": 1e3 * torch.linalg.norm(predicted - batch["offset"], dim=1)}


@dataclass
class RotationTask:
    """Score candidate rotations of the part.

    Its examples: `part_points` (P, 3) and `kit_points` (K, 3) float32 [m] along working axes: of the part rotated by
    the guess, about its pivot, and of the kits, about the pivot's correct position plus a jitter; `rotations` (C, 4)
    float64 wxyz candidates on the left of the guess; `nearest` () int64, the one nearest to a correct rotation;
    `angles` (C,) float32 [rad] of each to the nearest correct rotation; with `kit_distance`, `kit_volume` (nx, ny, nz)
    float32. In training C is `config.training_candidates`: the nearest one and negatives, in random order.
    """

    training: QuerySampler
    validation: QuerySampler
    config: RotationConfig
    model: RotationNet

    def example(self, rng: np.random.Generator) -> Example:
        """A part of any scene with a fresh guess; the same generator gives the same bytes."""
        return self._of(self.training.draw(rng), rng, every=False)

    def validation_keys(self) -> Sequence[str]:
        """Ids of queries, spread evenly over their split."""
        return self.validation.keys(VALIDATION_QUERIES["rotation"])

    def validation_example(self, key: str) -> Example:
        """The query with its stored guess, always with the same points and jitter, and all candidates in order."""
        return self._of(self.validation.stored(key), stream(SEED, "check", key), every=True)

    def _of(self, sample: QuerySample, rng: np.random.Generator, every: bool) -> Example:
        config, residual, offered = self.config, sample.residual, candidates("ball")
        jitter = rng.uniform(-config.jitter, config.jitter, 3)
        work = sample.world_from_work @ Pose.from_translation(residual.offset + jitter)
        correct, angles = nearest_candidate(offered, residual.rotations, residual.axis)
        chosen = np.arange(len(angles))
        if not every:
            chosen = training_candidates(rng, angles, config.training_candidates, config.hard_negatives)
        return sample.volumes.rotation_inputs(sample.guess, work, config, rng) | {
            "rotations": offered.wxyz[chosen],
            "nearest": np.asarray(np.flatnonzero(chosen == correct)[0], np.int64),
            "angles": angles[chosen].astype(np.float32),
        }

    def loss(self, batch: Batch) -> Tensor:
        """() cross-entropy over the candidates."""
        return rotation_loss(self._logits(batch), batch["nearest"], batch["angles"], self.config).mean()

    def measure(self, batch: Batch) -> Batch:
        """(B,) `rotation_deg`: angle of the best candidate to the nearest correct rotation; `floor_deg`: the least."""
        degrees = torch.rad2deg(batch["angles"])
        best = self._logits(batch).argmax(1, keepdim=True)
        return {"rotation_deg": degrees.gather(1, best)[:, 0], "floor_deg": degrees.amin(1)}

    def _logits(self, batch: Batch) -> Tensor:
        return self.model(batch["part_points"], batch["kit_points"], batch["rotations"], batch.get("kit_volume"))


def training_candidates(rng: np.random.Generator, angles: np.ndarray, most: int, hard: float = 0.0) -> np.ndarray:
    """Candidates of a training step: the nearest to a correct rotation and negatives, in random order.

    Args:
        rng: source of the draw.
        angles: (n,) [rad] of all candidates to the nearest correct rotation.
        most: how many; all if there are fewer.
        hard: share of the negatives that is drawn among the HARD nearest.

    Returns:
        (most,) indices.
    """
    order = np.argsort(angles, kind="stable")
    negatives = min(most, len(order)) - 1
    near = min(round(hard * negatives), HARD, negatives)
    drawn = rng.choice(order[1 : HARD + 1], near, replace=False) if near else order[:0]
    rest = rng.choice(np.setdiff1d(order[1:], drawn), negatives - near, replace=False)
    return rng.permutation(np.concatenate([order[:1], drawn, rest]))


def position_task(dataset: Dataset, preset: str, source: Source, completion: Path | None = None) -> PositionTask:
    """The task of a position network with new weights.

    completion: stem of the weights of the network that completes parts of depth images; None fills columns.
    """
    config = POSITION[preset]
    return PositionTask(*_samplers(dataset, source, completion), config, PositionNet(config))


def rotation_task(
    dataset: Dataset, preset: str, source: Source, completion: Path | None = None, kit_completion: Path | None = None
) -> RotationTask:
    """The task of a rotation network with new weights; `completion` as for `position_task`.

    kit_completion: of the network that completes kits; None leaves free what no pixel shows.
    """
    config = ROTATION[preset]
    return RotationTask(*_samplers(dataset, source, completion, kit_completion), config, RotationNet(config))


def _samplers(
    dataset: Dataset, source: Source, completion: Path | None, kit_completion: Path | None = None
) -> tuple[QuerySampler, QuerySampler]:
    """Queries for training and for validation."""
    completer = None if completion is None else PartCompleter(completion)
    kit_completer = None if kit_completion is None else KitCompleter(kit_completion)
    networks = completer, kit_completer
    return QuerySampler(dataset, "train", source, *networks), QuerySampler(dataset, "val", source, *networks)
