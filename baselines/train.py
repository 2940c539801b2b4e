"""Training a network of the catalog by its name."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from baselines.catalog import all_networks, weight_paths
from baselines.training.config import TrainConfig
from baselines.training.loop import TrainingResult, train
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.perception.networks.unet import UNet
from kit1000.perception.networks.weight_files import load_into, load_weights
from kit1000.predictor import resolved


def train_network(
    name: str, data: Path, out: Path, preset: str, changes: dict[str, Any], start: Path | None = None
) -> TrainingResult:
    """Train a network on the training split of a dataset, or resume its run.

    Args:
        name: of the network.
        data: dataset folder, with its ground truth.
        out: folder of the run.
        preset: of the network, such as small or paper.
        changes: values of fields of the training config that replace those of the preset.
        start: weights of this network to start from, NAME.safetensors beside its NAME.json; None: new ones.

    Raises:
        InputError: no such network or preset, an invalid value, or weights of another network.
    """
    networks = all_networks()
    if name not in networks:
        raise InputError(f"no network {name!r}; {did_you_mean(name, networks)}there are {', '.join(networks)}")
    network = networks[name]
    if preset not in network.training:
        presets = ", ".join(network.training)
        raise InputError(f"no preset {preset!r} of {name}; {did_you_mean(preset, network.training)}there are {presets}")
    training = TrainConfig(**{**asdict(network.training[preset]), **changes})
    dataset = Dataset(data)
    torch.manual_seed(training.seed)  # of the initial weights
    task = resolved(network.make_task)(dataset, preset, **network.options, **weight_paths(network.weights))
    if isinstance(task.model, UNet):
        task.model.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    about = {"name": name, "preset": preset, "network": asdict(task.model.config), "dataset_id": dataset.id}
    about["data_version"] = dataset.summary.get("data_version")
    if start is not None:
        tensors, about["start"] = load_weights(start.with_suffix(""))
        load_into(task.model, tensors, start)
    return train(task, training, out, about)
