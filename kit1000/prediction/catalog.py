"""The catalog of methods: the description of a method before it is made, and the tables that list methods.

A table is a package or module with METHODS (name -> Method). The library lists its own in TABLES; others are passed
beside them. Entries name code as `module:Object`, so reading a table loads no network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from kit1000.errors import InputError
from kit1000.queries.tracks import ALL_TRACKS

TABLES = ("kit1000.registration", "kit1000.known_shapes")
"""Packages of the library with a table METHODS."""


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
    """Tracks it predicts for; a method that corrects a guess needs one of GUESS_TRACKS."""
    uses_true_geometry: bool = False
    """Whether it gets the true geometry; the controls read the ground truth as well."""
    reads: Literal["image", "shapes"] = "image"
    """shapes: it gets the meshes of the scene's parts and kits beside the image, without poses."""
    learned: bool = False
    control: bool = False
    """Whether it is a control, such as the unchanged guess, and no method."""
    predicts: Literal["pose", "rotation"] = "pose"
    masks: Literal["given", "predicted"] = "given"
    """Masks it reads: those of the dataset, or those that `kit1000.perception.segmentation` finds in the image."""
    training_data: str = ""
    """The data that it learned from."""
    weights: Mapping[str, Path] = field(default_factory=dict)
    """Further arguments of the class: weight files, without suffix."""
    camera_set: str = "primary"
    """The cameras that it reads, see `kit1000.sim.cameras.camera_set`."""
    label: str = ""
    """Short name in tables; the method's name if empty."""
    paper_row: str = ""
    """Key of the row of the paper's Table I that it reproduces, see `benchmark.table1`; none if empty."""


def all_methods(tables: Sequence[str] = TABLES) -> dict[str, Method]:
    """The methods of tables by name, in their order."""
    return merged("METHODS", tables)


def merged(table: str, folders: Sequence[str]) -> dict[str, Any]:
    """The entries of a table of several packages or modules; none if a package lacks it.

    Raises:
        InputError: two packages declare one name.
    """
    found: dict[str, Any] = {}
    for folder in folders:
        entries: Mapping[str, Any] = getattr(import_module(folder), table, {})
        if twice := sorted(set(entries) & set(found)):
            raise InputError(f"{folder}.{table}: {twice[0]} is declared twice")
        found |= entries
    return found
