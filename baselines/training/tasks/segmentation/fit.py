"""Fits the weights of `merging` to the training split, by logistic regression on the pairs that merging meets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.segmentation.instances import find_bodies, pieces_of
from kit1000.perception.segmentation.pieces import Pieces, best_pairs
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.values import FIRST_PART_LABEL

if TYPE_CHECKING:
    from kit1000.perception.restoration.restorer import Restorer

WHOLE = 300  # [px] from which on a piece counts in full
RIDGE = 1.0  # penalty on the square of weights, each in units of its feature's spread
ROUNDS = 30  # of Newton


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
