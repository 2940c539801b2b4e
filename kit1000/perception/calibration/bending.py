"""Bending: the smooth error of disparities that the table shows around bodies, taken off the whole image.

A stereo camera bends planes by millimetres over some hundred pixels. On the table the error is seen; on a body it is
that of the table beside it, as it varies slowly in the image. The field is a sum of smooth bumps on a grid, with a
prior that pulls each to 0 (a Gaussian process): it is what the table's noise supports, and nothing far from the table.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation

from kit1000.numerics.elimination import solve_positive
from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.calibration.table import plane_coefficients, rays
from kit1000.values import View

CELL = 40  # [px] edge of the cells over which residuals are averaged
LEAST_SHARE = 0.15  # of a cell's pixels that show the table
BESIDE_BODIES = 13  # [px] edge of the square around each pixel of a body that is left out: edges reach over the table
NEAR_TABLE = 1.5  # [px] from the table's plane, of pixels that show it
SPACING = 64  # [px] between bumps
REACH = 190  # [px] at which a bump ends; as wide as a normal one of 60 px
LEAST_CELLS = 30  # of the table; with fewer the image stays as it is
FIELD_DECIMALS = 9  # of a pixel


class Residuals(NamedTuple):
    """The table's disparities less those of its plane, averaged over n cells."""

    places: np.ndarray
    """(n, 2) [px] row and column of their middles"""
    means: np.ndarray
    """(n,) [px]"""
    noise: float
    """[px^2] variance of a mean by what varies within some cells."""
    bending: float
    """[px^2] variance of what varies slowly."""


def unbent(view: View, labels: np.ndarray, baseline: float) -> View:
    """A calibrated view without the bending that its table shows.

    Args:
        view: its table is the plane z = 0.
        labels: (H, W) uint8 masks; 0 for the table or nothing.
        baseline: [m] of the stereo camera.
    """
    gain = view.camera.fx * baseline
    seen = table_residuals(view, labels, gain)
    if seen is None or seen.bending <= 0:
        return view
    field = bending_field(seen, view.depth.shape)
    disparity = gain / np.where(view.depth > 0, view.depth, np.inf) - field
    depth = np.where(view.depth > 0, gain / np.maximum(disparity, 1e-3), 0.0)
    return replace(view, depth=depth.astype(view.depth.dtype))


def table_residuals(view: View, labels: np.ndarray, gain: float) -> Residuals | None:
    """The residuals of a calibrated view's table; None where too few cells show it. gain: [px m]."""
    beside = np.asarray(binary_dilation(labels > 0, np.ones((BESIDE_BODIES, 1))))
    beside = np.asarray(binary_dilation(beside, np.ones((1, BESIDE_BODIES))), bool)
    v, u = np.nonzero((view.depth > 0) & ~beside)
    plane = matmul(rays(view.camera, np.stack([u, v], axis=-1)), plane_coefficients(view.world_from_camera))
    residuals = gain * (1 / view.depth[v, u].astype(float) - plane)
    near = np.abs(residuals) < NEAR_TABLE
    down, across = (-(-size // CELL) for size in view.depth.shape)
    cells = (v[near] // CELL) * across + u[near] // CELL
    counts = np.bincount(cells, minlength=down * across).reshape(down, across)
    sums = np.bincount(cells, residuals[near], down * across).reshape(down, across)
    full = counts > LEAST_SHARE * CELL**2
    if full.sum() < LEAST_CELLS:
        return None
    means = np.where(full, sums / np.maximum(counts, 1), np.nan)
    steps = np.concatenate([np.diff(means, axis=axis).ravel() for axis in (0, 1)])
    noise = float(np.nanmean(steps**2)) / 2
    bending = max(float(np.mean(means[full] ** 2)) - noise, 0.0)
    return Residuals(np.argwhere(full) * CELL + (CELL - 1) / 2, means[full], noise, bending)


def bending_field(seen: Residuals, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) [px] the likeliest field of an image of a shape."""
    grids = [np.arange(-SPACING, size + SPACING, SPACING, dtype=float) for size in shape]
    rows, columns = (_bumps(seen.places[:, axis], grid) for axis, grid in enumerate(grids))
    bumps = (rows[:, :, None] * columns[:, None, :]).reshape(len(seen.means), -1)
    prior = seen.noise / seen.bending * float(np.median((bumps**2).sum(1)))
    normal = matmul(bumps.T, bumps) + prior * np.eye(bumps.shape[1])
    heights = solve_positive(normal, matmul(bumps.T, seen.means)).reshape(len(grids[0]), len(grids[1]))
    down, across = (_bumps(np.arange(size, dtype=float), grid) for size, grid in zip(shape, grids, strict=True))
    return matmul(matmul(down, heights), across.T).round(FIELD_DECIMALS)


def _bumps(places: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """(n, m) values at places (n,) of bumps about the points (m,) of a grid [px]: triweights, without exponentials."""
    return np.clip(1 - np.square((places[:, None] - grid) / REACH), 0, None) ** 3
