"""Folders of real depth images with a manifest: 16-bit PNG and npy or npz files, their units and focal lengths."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from kit1000.errors import InputError

MANIFEST = "manifest.csv"
BASELINES = {"D415": 0.055, "D435": 0.050, "PhoXi": 0.225}
"""[m] by words in the name of a sensor: data sheets of the D400 series; the scanner's from the width of its shadows."""
COLUMNS = ("file", "sensor", "metres_a_unit", "fx")


@dataclass(frozen=True, eq=False)
class DepthImage:
    """A real depth image."""

    name: str
    """Name of its file, without the suffix."""
    sensor: str
    depth: np.ndarray
    """(H, W) float64 [m], 0 for no return."""
    fx: float
    """[px] focal length."""

    @property
    def kind(self) -> str:
        """The word of BASELINES that the sensor's name has."""
        return next(word for word in BASELINES if word in self.sensor)

    @property
    def gain(self) -> float:
        """[px m] disparity times depth."""
        return self.fx * BASELINES[self.kind]


def read_images(folder: Path) -> list[DepthImage]:
    """The images of a folder that its manifest lists, those of unknown sensors left out.

    Raises:
        InputError: no manifest, a column or a file that is missing, or an image that is none of depths.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise InputError(f"{folder}: no {MANIFEST}, a table with the columns {', '.join(COLUMNS)}")
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for column in COLUMNS:
        if rows and column not in rows[0]:
            raise InputError(f"{path}: no column {column!r}")
    return [
        DepthImage(Path(row["file"]).stem, row["sensor"], _read(folder / row["file"], float(row["metres_a_unit"])), fx)
        for row in rows
        for fx in [float(row["fx"])]
        if any(word in row["sensor"] for word in BASELINES)
    ]


def _read(path: Path, unit: float) -> np.ndarray:
    """(H, W) [m]."""
    if not path.is_file():
        raise InputError(f"{path}: no such file, though {MANIFEST} lists it")
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            values = file["depth"] if "depth" in file else file[file.files[0]]
    elif path.suffix == ".npy":
        values = np.load(path, allow_pickle=False)
    else:
        values = np.asarray(Image.open(path))
    values = np.squeeze(values)
    if values.ndim != 2 or values.dtype == np.uint8:
        raise InputError(f"{path}: {values.dtype} of shape {values.shape}, expected an image of 16 bits or of floats")
    depth = values.astype(float) * unit
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0.0)
