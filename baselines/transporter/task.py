"""The training task of TransporterNet: each step has a query without a guess and one with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from baselines.training.tasks.goal_draws import QueryDraws
from baselines.training.tasks.split_queries import Guesses
from baselines.transporter.config import TRANSPORTER, TransporterConfig
from baselines.transporter.examples import Example, TransporterExamples
from baselines.transporter.lattice import rotation_from
from baselines.transporter.network import UNITS, TransporterNet
from baselines.transporter.search import search
from kit1000.dataset.reader import Dataset
from kit1000.perception.heights.scene_heights import RenderedHeights
from kit1000.pose import Pose

VALIDATION_PAIRS = 24  # a query without a guess and one with, spread evenly over the validation split
PAPER = {"place": (41.5, 45.1), "tilt": (15.3, 18.3)}  # [mm, degrees] mean errors of the paper's Table I
ARM = 20e-3  # [m] that an angle is multiplied by to compare it with a distance
Batch = dict[str, Tensor]


@dataclass
class TransporterTask:
    """Predict the pose of a part at its goal."""

    training: TransporterExamples
    validation: TransporterExamples
    model: TransporterNet

    def example(self, rng: np.random.Generator) -> Example:
        """A part without a guess, and one with a guess of either kind."""
        guesses: Guesses = "tilt" if rng.random() < 0.5 else "ball"
        place, guess = self.training.draw(rng, "place"), self.training.draw(rng, guesses)
        return _named("place", place) | _named("guess", guess)

    def validation_keys(self) -> Sequence[tuple[str, str]]:
        """Pairs of ids of queries: of place and of snap-tilt."""
        keys = [self.validation.keys(guesses, VALIDATION_PAIRS) for guesses in ("place", "tilt")]
        return list(zip(*keys, strict=False))

    def validation_example(self, key: tuple[str, str]) -> Example:
        """Both queries, as they are stored."""
        place, tilt = map(self.validation.stored, key)
        return _named("place", place) | _named("tilt", tilt)

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


SCALAR_WEIGHT = 3.0
"""Weight of the mean Huber loss of the three scalars against the cross-entropy."""


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


def transporter_task(dataset: Dataset, preset: str) -> tuple[TransporterTask, TransporterConfig]:
    """The task with new weights, and the networks' config."""
    config, heights = TRANSPORTER[preset], RenderedHeights.beside(dataset)
    training, validation = (
        TransporterExamples(QueryDraws(dataset, split, heights), config) for split in ("train", "val")
    )
    return TransporterTask(training, validation, TransporterNet(config)), config
