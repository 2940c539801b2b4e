"""All networks that can be trained, by name: what each learns from, and how it is trained in either size."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import torch

from baselines.snapnet.config import POSITION, ROTATION, Kind
from baselines.snapnet.examples import Guesses, PositionExamples, RotationExamples, Situations
from baselines.snapnet.position import PositionNet
from baselines.snapnet.rotation import RotationNet
from baselines.snapnet.tasks import PositionTask, RotationTask
from baselines.training.batches import Task
from baselines.training.config import TrainConfig
from baselines.training.loop import Trained, train
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean

Preset = Literal["small", "paper"]
CHECKS = {"position": 100, "rotation": 48}  # queries to check by


@dataclass(frozen=True)
class Network:
    """A network by what it is to learn."""

    finds: Literal["position", "rotation"]
    kind: Kind
    guesses: Guesses = "ball"


NETWORKS = {
    "snapnet-gtvol-position": Network("position", "truth"),
    "snapnet-gtvol-rotation": Network("rotation", "truth"),
    "snapnet-partialvol-position": Network("position", "partial"),
    "snapnet-partialvol-rotation": Network("rotation", "partial"),
}
TRAINING = {
    ("position", "small"): TrainConfig(steps=4_000, batch=2, rate=1e-3, warmup=200, average=0.999, check_every=500),
    ("rotation", "small"): TrainConfig(steps=3_000, batch=2, rate=1e-3, warmup=200, average=0.999, check_every=500),
    ("position", "paper"): TrainConfig(steps=20_000, batch=4, rate=1e-4, decay="none"),
    ("rotation", "paper"): TrainConfig(steps=150_000, batch=1, rate=1e-4, decay="none", check_every=500),
}


def train_network(name: str, data: Path, out: Path, preset: Preset, changes: dict[str, Any]) -> Trained:
    """Train a network of NETWORKS on the training split of a dataset, or go on with it.

    Args:
        name: of the network.
        data: dataset folder, with its truth.
        out: folder of the run.
        preset: small or paper.
        changes: fields of the training config that are to be others.
    """
    if name not in NETWORKS:
        raise InputError(f"no network {name!r}; {did_you_mean(name, NETWORKS)}there are {', '.join(NETWORKS)}")
    network = NETWORKS[name]
    training = TrainConfig(**{**asdict(TRAINING[network.finds, preset]), **changes})
    dataset = Dataset(data)
    torch.manual_seed(training.seed)  # of the first weights
    task, sizes = _task(network, dataset, preset)
    about = {"name": name, "preset": preset, "network": asdict(sizes), "dataset_id": dataset.id}
    return train(task, training, out, about)


def _task(network: Network, dataset: Dataset, preset: Preset) -> tuple[Task, Any]:
    """The task of a network, and its sizes."""
    learn, check = (Situations(dataset, split, network.kind, network.guesses) for split in ("train", "val"))
    if network.finds == "position":
        places = POSITION[preset]
        examples = PositionExamples(learn, places), PositionExamples(check, places)
        return PositionTask(*examples, CHECKS["position"], PositionNet(places)), places
    turns = ROTATION[preset]
    shown = RotationExamples(learn, turns), RotationExamples(check, turns)
    return RotationTask(*shown, CHECKS["rotation"], RotationNet(turns)), turns
