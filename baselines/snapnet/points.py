"""Points sampled from volumes, and their rotation: the inputs of the rotation network."""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.voxels import Grid, Volume, surface_points

Where = Literal["inside", "surface"]


def sample_points(volume: np.ndarray, voxel: float, where: Where, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points of a volume, drawn uniformly without replacement.

    Where there are fewer than `count`, all of them are taken repeatedly, each time in a new order (the release fills
    up with a corner of the volume, which then is a point of the shape); where there are none, all points lie in the
    middle.

    Args:
        volume: (nx, ny, nz) float32, signed distances in truncations, 1 where unknown.
        voxel: [m] edge.
        where: inside: centres of voxels whose value is at most 0; surface: zero crossings between two voxels, except
            where the value jumps by more than the truncation: that is the end of the observed surface.
        count: points.
        rng: draws them.

    Returns:
        (count, 3) float32 [m] from the middle of the voxel n // 2 of each axis, along the axes of the grid; in
        random order.
    """
    values = np.asarray(volume, np.float32)
    if values.ndim != 3:
        raise InputError(f"volume: expected shape (nx, ny, nz), got {values.shape}")
    if where == "inside":
        indices = np.argwhere(values <= 0).astype(np.float64)
    else:
        indices = surface_points(Volume(Grid(values.shape, 1.0, Pose.identity()), values))
    if len(indices) == 0:
        return np.zeros((count, 3), np.float32)
    full, rest = divmod(count, len(indices))
    rounds = [rng.permutation(len(indices)) for _ in range(full)] + [rng.choice(len(indices), rest, replace=False)]
    return ((indices[np.concatenate(rounds)] - np.array(values.shape) // 2) * voxel).astype(np.float32)


def rotated(points: Tensor, rotations: Tensor) -> Tensor:
    """Points (B, P, 3) rotated about the origin by quaternions (B, C, 4) wxyz. (B, C, P, 3), of the points' type.

    Each coordinate is one fixed sum of three products, so that a point rotated alone and in a batch is the same to
    the bit: the points within a radius must not depend on how many candidates are scored together.
    """
    matrix = _matrices(rotations).to(points.dtype)[:, :, None]  # (B, C, 1, 3, 3)
    p = points[:, None, :, None]  # (B, 1, P, 1, 3)
    return matrix[..., 0] * p[..., 0] + matrix[..., 1] * p[..., 1] + matrix[..., 2] * p[..., 2]  # (B, C, P, 3)


def interpolated(volume: Tensor, points: Tensor, voxel: float) -> Tensor:
    """Values of volumes at points, trilinear; outside, the value of the nearest voxel at the border.

    Args:
        volume: (B, nx, ny, nz).
        points: (B, C, P, 3) [m] from the middle of the voxel n // 2 of each axis.
        voxel: [m] edge.

    Returns:
        (B, C, P).
    """
    cells = points.new_tensor(volume.shape[1:])
    normalised = 2 * (points / voxel + torch.floor(cells / 2)) / (cells - 1) - 1  # -1 and 1 at the outermost voxels
    grid = normalised.flip(-1)[:, :, :, None]  # torch counts axes from the last
    values = functional.grid_sample(volume[:, None], grid, padding_mode="border", align_corners=True)
    return values[:, 0, :, :, 0]


def _matrices(wxyz: Tensor) -> Tensor:
    """Rotation matrices of quaternions of any length above 0. (..., 4) -> (..., 3, 3)."""
    w, x, y, z = (wxyz / wxyz.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)
