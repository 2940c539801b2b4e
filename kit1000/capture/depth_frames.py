"""Depth frames of one camera that did not move, and the image that several of them give together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.known_sensors import known_unit
from kit1000.errors import InputError

NEAREST, FARTHEST = 0.15, 4.0  # [m] median depths of tables that a camera sees well
LIKELY = (0.12, 3.0)  # [m] median depths for which a unit is proposed
UNITS = (1e-3, 1e-4, 2e-4, 2.5e-4, 1e-2, 1.0, 1e-5)
"""[m] that 1 in an image may stand for, the usual ones first."""
SATURATED = 65535  # of 16 bits: many drivers write it for a pixel without a return
MOST_PIXELS = 30_000_000
LEAST_SIDE = 64  # [px] of an image
LEAST_RETURNS = 0.02  # share of the pixels
SMOOTHER = 8.0  # ratio of the steps between neighbours from which the bytes of 16-bit values are surely swapped


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """One frame as it was stored."""

    values: np.ndarray  # (H, W) unsigned integers or floats; 0 or not finite: no return
    source: str  # the file, and its topic if it has several, for messages
    unit: float | None = None  # [m] that 1 stands for, if the format says so
    intrinsics: Intrinsics | None = None  # intrinsics that came with it

    def __post_init__(self) -> None:
        values = self.values
        if values.ndim == 3 and values.shape[-1] == 1:
            object.__setattr__(self, "values", values[..., 0])
        check_values(self.values, self.source)

    @property
    def integers(self) -> bool:
        """Whether the values are integers, of a unit that is not 1 m."""
        return self.values.dtype.kind in "iu"


def check_values(values: np.ndarray, source: str) -> None:
    """Raise InputError if an array cannot be a depth image."""
    shape = " x ".join(map(str, values.shape)) or "one number"
    if values.ndim == 3 and values.shape[-1] in (3, 4) and values.dtype.kind == "f":
        raise InputError(f"{source}: an organised point cloud of {shape}: save its z alone, values[..., 2]")
    if values.ndim == 3 and values.shape[-1] in (2, 3, 4):
        raise InputError(f"{source}: {values.shape[-1]} channels, expected one: a colour picture, not depths")
    if values.ndim != 2:
        raise InputError(f"{source}: an array of {shape}, expected rows and columns of one depth image")
    if values.dtype.kind == "b" or (values.dtype.kind in "iu" and values.dtype.itemsize == 1):
        raise InputError(f"{source}: 8 bits a pixel, expected 16-bit integers or floats: a picture, not depths")
    if values.dtype.kind not in "iuf":
        raise InputError(f"{source}: {values.dtype} values, expected 16-bit integers or floats")
    check_size(values.shape, source)


def check_size(shape: tuple[int, ...], source: str) -> None:
    """Raise InputError if an image of a shape (H, W) is too small or too large for a depth image."""
    if min(shape) < LEAST_SIDE or shape[0] * shape[1] > MOST_PIXELS:
        size = " x ".join(map(str, shape))
        raise InputError(f"{source}: {size} px, expected rows and columns from {LEAST_SIDE} up, at most 30 megapixels")


def stated_unit(frame: DepthFrame, known: Intrinsics, scale: float | None, device: str) -> float | None:
    """[m] that 1 in a frame stands for: as the user, the files or the camera's name say; None if none of them does."""
    return scale or known.unit or frame.unit or (known_unit(device or known.device) if frame.integers else 1.0)


def metric_depth(frame: DepthFrame, unit: float) -> np.ndarray:
    """(H, W) float32 [m] the depths of a frame, 0 without a return. unit: [m] that 1 stands for.

    Raises InputError if hardly any pixel has a return, if the bytes of its values are swapped, or if the median depth
    is not that of a table; then a unit is proposed.
    """
    values = frame.values
    known = np.isfinite(values) & (values > 0)
    if frame.integers:
        known &= values != SATURATED
    share = np.count_nonzero(known) / values.size
    if share < LEAST_RETURNS:
        found, expected = f"{100 * share:.1f} % of the pixels have a depth", f"{100 * LEAST_RETURNS:.0f} or more"
        raise InputError(f"{frame.source}: {found}, expected {expected}: empty, or not a depth image")
    if values.dtype == np.uint16 and _roughness(values) > SMOOTHER * _roughness(values.byteswap()):
        raise InputError(f"{frame.source}: both bytes of each value are swapped: save the image in its own byte order")
    depth = np.where(known, values, 0).astype(np.float64) * unit
    middle = float(np.median(depth[known]))
    if not NEAREST <= middle <= FARTHEST:
        low, high = LIKELY
        other = next((each for each in UNITS if low <= middle / unit * each <= high), None)
        advice = "" if other is None else f"; is the unit {other:g} m? Give --depth-scale {other:g}"
        found = f"median depth {middle:.4g} m, expected {NEAREST:g} to {FARTHEST:g}"
        raise InputError(f"{frame.source}: {found}{advice}")
    return np.where(depth < 10 * FARTHEST, depth, 0).astype(np.float32)


def _roughness(values: np.ndarray) -> float:
    """Sum of the differences between neighbours in a row that both have a return."""
    left, right = values[:, :-1].astype(np.float64), values[:, 1:]
    return float(np.abs(left - right)[(left > 0) & (right > 0)].sum())


def mean_depth(depths: Sequence[np.ndarray]) -> np.ndarray:
    """(H, W) float32 [m]: the median of depths (H, W) if more than half of them see a pixel; 0 elsewhere."""
    if len(depths) == 1:
        return depths[0]
    stack = np.stack(depths)
    seen = stack > 0
    often = 2 * seen.sum(0) > len(depths)
    values = np.where(seen, stack, np.nan)
    middle = np.zeros(often.shape, np.float32)
    middle[often] = np.nanmedian(values[:, often], axis=0)
    return middle
