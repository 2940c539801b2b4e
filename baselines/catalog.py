"""Which reference methods and networks there are: each folder declares its own, in tables METHODS and NETWORKS.

A new method is a folder and a line of FOLDERS. Tables name code as `module:Object`, so reading them loads no network.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from baselines.training.config import TrainConfig
from kit1000.prediction import catalog, making
from kit1000.prediction.catalog import Method, merged
from kit1000.prediction.predict import RunConfig
from kit1000.weights import WEIGHTS as LIBRARY_WEIGHTS

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of the networks of the baselines."""
METHOD_TABLES = (
    "baselines.controls",
    "baselines.icp",
    "baselines.kitnet",
    *catalog.TABLES,
    "baselines.registration_three",
    "baselines.snapnet",
    "baselines.transporter",
)
"""Packages or modules with a table METHODS (name -> Method)."""
NETWORK_TABLES = (
    "baselines.training.networks",
    "baselines.kitnet",
    "baselines.snapnet",
    "baselines.transporter",
)
"""Packages with a table NETWORKS (name -> Network)."""


@dataclass(frozen=True)
class Network:
    """A network that `python -m baselines train` can train."""

    make_task: str
    """`module:function`, called with dataset, preset, options: returns the training task, whose model has a config."""
    training: Mapping[str, TrainConfig]
    """How it is trained, by preset."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of the function."""
    weights: Mapping[str, str] = field(default_factory=dict)
    """Further arguments: weights of other networks that make its examples, as of `Method`."""


def all_methods() -> dict[str, Method]:
    """The methods of all tables by name, in the order of METHOD_TABLES."""
    return catalog.all_methods(METHOD_TABLES)


def all_networks() -> dict[str, Network]:
    """The networks of all tables by name, in the order of NETWORK_TABLES."""
    return merged("NETWORKS", NETWORK_TABLES)


def weight_paths(weights: Mapping[str, str]) -> dict[str, Path]:
    """Paths of weights by argument, without suffix, from their names: those of the baselines, or of the library."""
    return {argument: weights_folder(name) / name for argument, name in weights.items()}


def weights_folder(name: str) -> Path:
    """The folder of the weights of a network: the library's for what the library loads, else that of the baselines."""
    ours = {path.stem for path in LIBRARY_WEIGHTS.glob("*.json")}
    return LIBRARY_WEIGHTS if name in ours else WEIGHTS


def method_of(name: str) -> Method:
    """A method of the tables, or one of your own: see `kit1000.prediction.making.method_of`."""
    return making.method_of(name, METHOD_TABLES)


run_config = partial(RunConfig, tables=METHOD_TABLES)
"""What a run predicts, by a method of our tables or of your own."""
