"""Encodings of volumes in one or two bytes per voxel, which preserve the sign and unknown voxels.

| encoding | unknown | largest error of a value |
| --- | --- | --- |
| uint8 | 0 | 1/254 (half a step); 1/127 just below zero, which is never rounded to zero |
| float16 | NaN | 2^-12 |
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kit1000.errors import checked
from kit1000.numerics.compiled import compiled
from kit1000.voxels.grid import Grid, Volume

CODE_STEPS = 127  # codes from value 0 to value 1
ZERO_CODE = 128  # the code of value 0; code 1 is -1, 255 is 1, 0 is unknown
MIN_HALF = np.float32(2**-24)  # the smallest float16 above 0


def to_uint8(volume: Volume) -> np.ndarray:
    """(nx, ny, nz) uint8: 0 unknown, else 128 + 127 x value, rounded; negative values give codes below 128."""
    codes = np.empty(volume.grid.shape, np.uint8)
    _encode(volume.values.reshape(-1), codes.reshape(-1))
    return codes


def from_uint8(grid: Grid, codes: ArrayLike) -> Volume:
    """The volume of codes (nx, ny, nz) uint8 from `to_uint8`."""
    values = (np.arange(256, dtype=np.float32) - ZERO_CODE) / CODE_STEPS
    values[0] = np.nan
    return Volume.adopt(grid, values[checked("codes", codes, grid.shape, np.uint8)])


def to_float16(volume: Volume) -> np.ndarray:
    """(nx, ny, nz) float16: the rounded values, NaN unknown."""
    with np.errstate(under="ignore"):
        halves = volume.values.astype(np.float16)
    halves[(halves == 0) & (volume.values < 0)] = -MIN_HALF
    return halves


def from_float16(grid: Grid, halves: ArrayLike) -> Volume:
    """The volume of values (nx, ny, nz) float16 from `to_float16`."""
    return Volume(grid, np.asarray(halves))


@compiled
def _encode(values, codes):
    for i in range(values.shape[0]):
        value = values[i]
        if value != value:
            codes[i] = 0
        else:
            code = int(np.floor(value * CODE_STEPS + np.float32(ZERO_CODE + 0.5)))
            codes[i] = min(code, ZERO_CODE - 1) if value < 0 else code
