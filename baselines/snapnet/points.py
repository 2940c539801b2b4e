"""Points of volumes, and their turning: what the rotation network is shown of a part and of the kits."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from kit1000.errors import InputError


def points_in(
    volume: np.ndarray, voxel: float, count: int, rng: np.random.Generator, deepest: float = -np.inf
) -> np.ndarray:
    """Middles of voxels inside, drawn evenly without putting back.

    Where there are fewer voxels than points, all of them come, and come again in a new order until the points are
    full (the release fills up with a corner of the volume, which then is a point of the shape); where there are
    none, all points lie in the middle.

    Args:
        volume: (nx, ny, nz) signed distances in truncations, or any values that are at most 0 inside.
        voxel: [m] edge.
        count: points wanted.
        rng: draws them.
        deepest: only values from here to 0 count: -1 (not included) leaves out what lies deeper than the truncation.

    Returns:
        (count, 3) float32 [m] from the middle of the voxel n // 2 of each axis, along the axes of the grid; in
        random order.
    """
    values = np.asarray(volume)
    if values.ndim != 3:
        raise InputError(f"volume: expected shape (nx, ny, nz), got {values.shape}")
    inside = np.flatnonzero((values <= 0) & (values > deepest))
    if len(inside) == 0:
        return np.zeros((count, 3), np.float32)
    full, rest = divmod(count, len(inside))
    rounds = [rng.permutation(inside) for _ in range(full)] + [rng.choice(inside, rest, replace=False)]
    index = np.stack(np.unravel_index(np.concatenate(rounds), values.shape), axis=-1)
    return ((index - np.array(values.shape) // 2) * voxel).astype(np.float32)


def turned(points: Tensor, turns: Tensor) -> Tensor:
    """Points (B, P, 3) turned about the origin by quaternions (B, C, 4) wxyz. (B, C, P, 3), of the points' type.

    Each coordinate is one fixed sum of three products, so that a point turned alone and in company are the same to
    the bit: what lies within a radius must not depend on how many candidates are scored together.
    """
    matrix = _matrices(turns).to(points.dtype)[:, :, None]  # (B, C, 1, 3, 3)
    p = points[:, None, :, None]  # (B, 1, P, 1, 3)
    return matrix[..., 0] * p[..., 0] + matrix[..., 1] * p[..., 1] + matrix[..., 2] * p[..., 2]  # (B, C, P, 3)


def _matrices(wxyz: Tensor) -> Tensor:
    """Rotation matrices of quaternions of any length but nothing. (..., 4) -> (..., 3, 3)."""
    w, x, y, z = (wxyz / wxyz.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)
