"""Which reference methods and networks there are: each method folder declares its own, in tables METHODS and NETWORKS.

A new method is a folder and a line of FOLDERS. Tables name code as `module:Object`, so reading them loads no network.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from baselines.training.config import TrainConfig
from kit1000.tracks import ALL_TRACKS

WEIGHTS = Path(__file__).parent / "weights"
"""Of the trained networks."""
FOLDERS = (
    "baselines.completion",
    "baselines.controls",
    "baselines.icp",
    "baselines.kitnet",
    "baselines.registration",
    "baselines.restoration",
    "baselines.segmentation",
    "baselines.snapnet",
    "baselines.transporter",
)
"""Packages or modules with a table METHODS (name -> Method) and, where they learn, NETWORKS (name -> Network)."""


@dataclass(frozen=True)
class Method:
    """A method before it is made."""

    make: str
    """`module:Object`: a predictor as it is, or a class, called with dataset, options, and a seed if it takes one."""
    description: str
    """One line."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of the class."""
    tracks: tuple[str, ...] = ALL_TRACKS
    """Those it predicts for; a method that corrects a guess needs one of GUESS_TRACKS."""
    uses_true_geometry: bool = False
    """Whether it is handed the true geometry; the controls read the ground truth as well."""
    learned: bool = False
    control: bool = False
    """Whether it is a control, such as the unchanged guess, and no method."""
    predicts: Literal["pose", "rotation"] = "pose"
    masks: Literal["given", "predicted"] = "given"
    """Those of the dataset, or such as `baselines.segmentation` finds in the depth image."""
    training_data: str = ""
    """What it learned from."""
    weights: Mapping[str, str] = field(default_factory=dict)
    """Further arguments of the class: names of files in baselines/weights, passed as paths without suffix."""
    camera_set: str = "primary"
    """The cameras that it reads, see `kit1000.sim.cameras.camera_set`."""
    label: str = ""
    """Short name in tables; the method's name when empty."""
    paper_row: str = ""
    """Key of the row of the paper's Table I that it reproduces, see `benchmark.table1`; none when empty."""


@dataclass(frozen=True)
class Network:
    """A network that `python -m baselines train` can train."""

    make_task: str
    """`module:function`, called with dataset, preset, options: returns the training task and the network's config."""
    training: Mapping[str, TrainConfig]
    """How it is trained, by preset."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of the function."""
    weights: Mapping[str, str] = field(default_factory=dict)
    """Further arguments: weights of other networks that make its examples, as of `Method`."""


def all_methods() -> dict[str, Method]:
    """The methods of all folders by name, in the order of FOLDERS."""
    return _merged("METHODS")


def all_networks() -> dict[str, Network]:
    """The networks of all folders by name, in the order of FOLDERS."""
    return _merged("NETWORKS")


def weight_paths(weights: Mapping[str, str]) -> dict[str, Path]:
    """The further arguments of a class or a task: the paths of `weights` of `Method` or `Network`."""
    return {argument: WEIGHTS / stem for argument, stem in weights.items()}


def _merged(table: str) -> dict[str, Any]:
    merged: dict[str, Any] = {}
    for folder in FOLDERS:
        entries: Mapping[str, Any] = getattr(import_module(folder), table, {})
        twice = sorted(set(entries) & set(merged))
        assert not twice, f"{folder}.{table}: {twice[0]} is declared twice"
        merged |= entries
    return merged
