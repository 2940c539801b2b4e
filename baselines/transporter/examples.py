"""The training task of TransporterNet and its examples: maps, and the cells, heights and tilts of the goals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from baselines.heights.scene_heights import RenderedHeights
from baselines.heights.shell import shell_points
from baselines.training.tasks.goal_draws import GoalQuery, QueryDraws
from baselines.training.tasks.split_queries import TRACK_OF, Guesses
from baselines.transporter.config import TRANSPORTER, YAW_STEP, YAWS, TransporterConfig
from baselines.transporter.inputs import Start, search_inputs, start_of
from baselines.transporter.lattice import lattice_of, rotation_from, spread_cells, tilt_and_yaw
from baselines.transporter.network import UNITS, TransporterNet
from baselines.transporter.search import search
from kit1000.dataset.reader import Dataset
from kit1000.pose import Pose
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.values import Query

GUESSED_YAWS = int(np.ceil(MAX_ANGLE / YAW_STEP))
"""Yaws to either side of a guess that its window holds."""
GUESS_YAWS = np.arange(-GUESSED_YAWS, GUESSED_YAWS + 1) % YAWS
MOST_CELLS = 512  # of the goals of an example
MOST_GOALS = 64  # that validation compares with
PARTS = 4096  # whose shells are kept in memory: 0.1 MB each
SLACK = 1e-3  # [m, rad] by which a goal may lie beyond the window of a guess
Example = dict[str, np.ndarray]
VALIDATION_PAIRS = 24  # a query without a guess and one with, spread evenly over the validation split
PAPER = {"place": (41.5, 45.1), "tilt": (15.3, 18.3)}  # [mm, degrees] mean errors of the paper's Table I
ARM = 20e-3  # [m] that an angle is multiplied by to compare it with a distance
Batch = dict[str, Tensor]
SCALAR_WEIGHT = 3.0
"""Weight of the mean Huber loss of the three scalars against the cross-entropy."""


class Goals(NamedTuple):
    """The goals of a query in a work frame; m of them."""

    xyz: np.ndarray
    """(m, 3) [m] of the pivot."""
    tilts: np.ndarray
    """(m, 2) [rad]"""
    yaws: np.ndarray
    """(m,) [rad] from -pi to pi, after the rotation of the start."""


def goals_of(sample: GoalQuery, start: Start) -> Goals:
    """The goals of a query; with a guess those in its window."""
    motions = start.work_from_world @ sample.goals
    rotations = Pose(motions.wxyz, np.zeros_like(motions.xyz)) @ start.work_from_part.inverse()
    tilts, yaws = tilt_and_yaw(rotations)
    xyz, kept = motions.apply(sample.query.pivot), np.arange(len(yaws))
    if sample.guess is not None:
        guessed = sample.guess.apply(sample.query.pivot)
        offsets = np.abs(sample.goals.apply(sample.query.pivot) - guessed).max(-1)
        angles = rotations.angle()
        kept = np.flatnonzero((offsets <= MAX_OFFSET + SLACK) & (angles <= MAX_ANGLE + SLACK))
        kept = kept if len(kept) else np.array([int(angles.argmin())])
    return Goals(xyz[kept], tilts[kept], yaws[kept])


@dataclass
class TransporterTask:
    """Predict the pose of a part at its goal: examples are of a query without a guess, and of one with a guess.

    One of them has `kits` (3, n, n), `part` (3, c, c) float32 maps; `yaws` (Y,) int64 the yaws that are scored;
    `window` (m, m) bool the points that are; `base` (m, m) float32 [m] mean heights about them; `cells` (MOST_CELLS, 3)
    int64 layer and point of the goals' cells, `shares` (MOST_CELLS,) float32 their shares; `point` (2,) int64 the point
    nearest to one goal, `layers` (2,) int64 those about its yaw, `height` () float32 [m] and `tilt` (2,) float32 [rad]
    of it. For validation it has the `yaws` to search and MOST_GOALS goals: `xyz` (MOST_GOALS, 3) float32 [m] of the
    pivot, `wxyz` (MOST_GOALS, 4) float32 after the start's rotation.
    """

    training: QueryDraws
    validation: QueryDraws
    config: TransporterConfig
    model: TransporterNet

    def __post_init__(self) -> None:
        self._shell = lru_cache(PARTS)(shell_points)

    def __reduce__(self) -> tuple[type[TransporterTask], tuple[Any, ...]]:
        return TransporterTask, (self.training, self.validation, self.config, self.model)

    def example(self, rng: np.random.Generator) -> Example:
        """A part without a guess, and one with a guess of either kind."""
        guesses: Guesses = "tilt" if rng.random() < 0.5 else "ball"
        place, guess = self.drawn(rng, "place"), self.drawn(rng, guesses)
        return _named("place", place) | _named("guess", guess)

    def drawn(self, rng: np.random.Generator, guesses: Guesses) -> Example:
        """A query in a work frame of any yaw; without a guess the part is rotated by any yaw too."""
        sample = self.training.draw(rng, guesses)
        start = start_of(sample.heights, sample.query.pivot, sample.guess, rng.uniform(0, 2 * np.pi))
        if not start.guessed:
            start = Start(start.work_from_world, Pose.from_rotvec((0, 0, rng.uniform(0, 2 * np.pi))), False)
        goals = goals_of(sample, start)
        goal = int(rng.integers(len(goals.yaws)))
        return self._maps(sample, start) | self._targets(goals, goal, start, rng)

    def validation_keys(self) -> Sequence[tuple[str, str]]:
        """Pairs of ids of queries: of place and of snap-tilt."""
        keys = [self.validation.queries.keys(TRACK_OF[guesses], VALIDATION_PAIRS) for guesses in ("place", "tilt")]
        return list(zip(*keys, strict=False))

    def validation_example(self, key: tuple[str, str]) -> Example:
        """Both queries as they are stored, along the axes of the world."""
        place, tilt = map(self._stored, key)
        return _named("place", place) | _named("tilt", tilt)

    def _stored(self, key: str) -> Example:
        sample = self.validation.stored(key)
        start = start_of(sample.heights, sample.query.pivot, sample.guess)
        motions = start.work_from_world @ sample.goals
        rotations = Pose(motions.wxyz, np.zeros_like(motions.xyz)) @ start.work_from_part.inverse()
        chosen = np.arange(MOST_GOALS) * len(motions) // MOST_GOALS
        return self._maps(sample, start) | {
            "yaws": searched_yaws(sample.query),
            "xyz": motions.apply(sample.query.pivot)[chosen].astype(np.float32),
            "wxyz": rotations.wxyz[chosen].astype(np.float32),
        }

    def _maps(self, sample: GoalQuery, start: Start) -> Example:
        """The inputs of the network, see `search_inputs`."""
        shell = self._shell(sample.heights.parts[sample.query.part]) - sample.query.pivot
        return search_inputs(sample.heights.kits, shell, start, self.config)

    def _targets(self, goals: Goals, goal: int, start: Start, rng: np.random.Generator) -> Example:
        config, points = self.config, start.points(self.config)
        lattice = lattice_of(goals.xyz[:, :2], points, config.pixel)
        about = int(np.floor(goals.yaws[goal] / YAW_STEP))
        about = min(max(about, -GUESSED_YAWS), GUESSED_YAWS - 1) if start.guessed else about
        yaws = _scored_yaws(about, start.guessed, config.yaws, rng)
        cells, shares = _cells_of(lattice, goals.yaws, yaws, points, config.spread)
        point = np.clip(np.rint(lattice[goal]).astype(np.int64), config.margin, points - 1 - config.margin)
        layers = [int(np.flatnonzero(yaws == (about + k) % YAWS)[0]) for k in (0, 1)]
        return {
            "yaws": yaws,
            "cells": cells,
            "shares": shares,
            "point": point,
            "layers": np.array(layers),
            "height": np.asarray(goals.xyz[goal, 2], np.float32),
            "tilt": goals.tilts[goal].astype(np.float32),
        }

    def loss(self, batch: Batch) -> Tensor:
        """() the mean of `transporter_loss` of the queries without and with a guess."""
        return (
            transporter_loss(self.model, _own("place", batch)) + transporter_loss(self.model, _own("guess", batch))
        ) / 2

    def measure(self, batch: Batch) -> Batch:
        """(B,) errors to the nearest goal, and `of_paper`: their mean as a multiple of the paper's."""
        measured: dict[str, Tensor] = {}
        for name in ("place", "tilt"):
            own = _own(name, batch)
            errors = [
                _errors(self.model, {key: value[i] for key, value in own.items()}) for i in range(len(own["kits"]))
            ]
            measured[f"{name}_mm"], measured[f"{name}_deg"] = torch.tensor(errors).T
        shares = [measured[f"{name}_{unit}"] / PAPER[name][i] for name in PAPER for i, unit in enumerate(("mm", "deg"))]
        return {"of_paper": torch.stack(shares).mean(0), **measured}


def searched_yaws(query: Query) -> np.ndarray:
    """(Y,) int64 yaws to search for a query: all without a guess, else those that its track leaves.

    A guess of snap-tilt is wrong by a tilt alone, so one yaw is left, as in the release.
    """
    if query.guess is None:
        return np.arange(YAWS)
    return np.zeros(1, np.int64) if query.track == "snap-tilt" else GUESS_YAWS


def _scored_yaws(about: int, guessed: bool, count: int, rng: np.random.Generator) -> np.ndarray:
    """(Y,) int64 yaws of a training step: with a guess those of its window, else the correct ones and others."""
    if guessed:
        return GUESS_YAWS
    correct = np.array([about, about + 1]) % YAWS
    others = rng.permutation(np.setdiff1d(np.arange(YAWS), correct))[: count - 2]
    return np.sort(np.concatenate([correct, others]))


def _cells_of(
    lattice: np.ndarray, goal_yaws: np.ndarray, yaws: np.ndarray, points: int, spread: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The cells of goals that are scored, as layer and point, and their shares; padded to MOST_CELLS."""
    found = [spread_cells(point, yaw, spread) for point, yaw in zip(lattice, goal_yaws, strict=True)]
    cells, shares = np.concatenate([cells for cells, _ in found]), np.concatenate([shares for _, shares in found])
    layer = np.full(YAWS, -1)
    layer[yaws] = np.arange(len(yaws))
    cells[:, 0] = layer[cells[:, 0]]
    scored = (cells[:, 0] >= 0) & (cells[:, 1:] >= 0).all(1) & (cells[:, 1:] < points).all(1) & (shares > 0)
    cells, shares = cells[scored][:MOST_CELLS], shares[scored][:MOST_CELLS]
    padded, weights = np.zeros((MOST_CELLS, 3), np.int64), np.zeros(MOST_CELLS, np.float32)
    padded[: len(cells)], weights[: len(cells)] = cells, shares / max(shares.sum(), 1e-9)
    return padded, weights


def transporter_loss(net: TransporterNet, batch: Batch) -> Tensor:
    """() cross-entropy over all cells, plus Huber losses of height and tilt around a goal; the mean over the batch."""
    config, yaws, window = net.config, batch["yaws"], batch["window"]
    features = net.kit_features(batch["kits"], padded=window.shape[-1] > batch["kits"].shape[-1])
    kernels = net.kernels(batch["part"], yaws)
    scores = net.scores(features, kernels).masked_fill(~window[:, None], -torch.inf)
    rows = torch.arange(len(yaws), device=yaws.device)[:, None]
    layer, row, column = batch["cells"].unbind(-1)
    goals = scores[rows, layer, row, column].where(batch["shares"] > 0, 0)
    entropy = torch.logsumexp(scores.flatten(1), 1) - (batch["shares"] * goals).sum(1)
    around = 2 * config.margin + 1
    first = batch["point"] - config.margin
    near = torch.stack([kernels[i, layers] for i, layers in enumerate(batch["layers"])])
    predicted = net.height_and_tilt(features, near, first, around)
    wanted = torch.empty_like(predicted)
    for i, (a, b) in enumerate(first.tolist()):
        wanted[i, 0] = (batch["height"][i] - batch["base"][i, a : a + around, b : b + around]) / UNITS[0]
        wanted[i, 1:] = (batch["tilt"][i] / wanted.new_tensor(UNITS[1:]))[:, None, None, None]
    return entropy.mean() + SCALAR_WEIGHT * F.smooth_l1_loss(predicted, wanted)


def _errors(net: TransporterNet, example: Batch) -> tuple[float, float]:
    """[mm], [degrees] of the prediction to the nearest goal."""
    arrays = {key: example[key].cpu().numpy() for key in ("yaws", "window", "base", "xyz", "wxyz")}
    found = search(net, example["kits"], example["part"], arrays["yaws"], arrays["window"], arrays["base"])
    goals = Pose(arrays["wxyz"].astype(float), np.zeros((len(arrays["wxyz"]), 3)))
    angles = (goals.inverse() @ rotation_from(found.tilt, found.yaw)).angle()
    distances = np.linalg.norm(arrays["xyz"] - found.xyz, axis=1)
    nearest = int((distances + ARM * angles).argmin())
    return 1e3 * float(distances[nearest]), float(np.degrees(angles[nearest]))


def _named(name: str, example: Example) -> Example:
    return {f"{name}_{key}": value for key, value in example.items()}


def _own(name: str, batch: Batch) -> Batch:
    return {key.removeprefix(f"{name}_"): value for key, value in batch.items() if key.startswith(f"{name}_")}


def transporter_task(dataset: Dataset, preset: str) -> TransporterTask:
    """The task with new weights."""
    config, heights = TRANSPORTER[preset], RenderedHeights.beside(dataset)
    training, validation = (QueryDraws(dataset, split, heights) for split in ("train", "val"))
    return TransporterTask(training, validation, config, TransporterNet(config))
