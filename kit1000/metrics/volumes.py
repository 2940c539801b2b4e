"""Comparing two volumes: IoU of their occupied voxels, and chamfer distance of their surfaces.

Nothing is sampled at random, so a volume compared with itself has exactly IoU 1 and chamfer distance 0.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from kit1000.errors import InputError, ShapeError, checked
from kit1000.voxels import Volume, surface_points


def occupancy_iou(a: Volume | np.ndarray, b: Volume | np.ndarray) -> float:
    """Intersection over union of the occupied voxels of two volumes, over the voxels known in both. 0 to 1.

    |A and B| / |A or B| with A, B the voxels of negative distance, as in `Volume.occupied`. 1 when neither volume has
    an occupied voxel, 0 when no voxel is known in both.

    Args:
        a: a volume, or signed distances (nx, ny, nz) of any scale, negative inside, NaN unknown.
        b: another on the same grid; the order does not matter.
    """
    left, right = _on_one_grid(a, b)
    known = ~np.isnan(left) & ~np.isnan(right)
    if not known.any():
        return 0.0
    inside, other = left[known] < 0, right[known] < 0
    union = np.count_nonzero(inside | other)
    return np.count_nonzero(inside & other) / union if union else 1.0


def known_share(predicted: Volume | np.ndarray, true: Volume | np.ndarray) -> float:
    """The share of the voxels known in `true` that are known in `predicted` too, 0 to 1; 1 where there are none.

    To be reported beside `occupancy_iou`, which a volume with few known voxels can make large.
    """
    left, right = _on_one_grid(predicted, true)
    known = ~np.isnan(right)
    return float(np.mean(~np.isnan(left[known]))) if known.any() else 1.0


def surface_chamfer(a: Volume | np.ndarray, b: Volume | np.ndarray) -> float:
    """Symmetric chamfer distance between two surfaces [m].

    (mean over A of the distance to the nearest of B + mean over B of the distance to the nearest of A) / 2, Euclidean,
    with A, B points on the surfaces: of a volume those where a line of its grid passes from free to occupied between
    two known voxels (`kit1000.voxels.surface_points`), interpolated. 0 when neither has a surface, infinite when only
    one has.

    Args:
        a: a volume, or points (n, 3) [m] of a surface in the world, evenly spread.
        b: another; the order does not matter. Volumes on one grid have their points on the same lines, so that the
            spacing of the points does not affect the result.
    """
    left, right = _surface_samples("a", a), _surface_samples("b", b)
    if not len(left) or not len(right):
        return 0.0 if len(left) == len(right) else float("inf")
    to_right, to_left = KDTree(right).query(left)[0], KDTree(left).query(right)[0]
    return float(to_right.mean() + to_left.mean()) / 2


def _on_one_grid(a: Volume | np.ndarray, b: Volume | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The signed distances of two volumes, which must share one grid."""
    if isinstance(a, Volume) and isinstance(b, Volume) and a.grid != b.grid:
        raise InputError(
            "volumes: expected two on one grid; kit1000.voxels.resample samples one on the grid of another"
        )
    left, right = _signed_distances("a", a), _signed_distances("b", b)
    if left.shape != right.shape:
        raise ShapeError(f"volumes: expected two of one shape, got {left.shape} and {right.shape}")
    return left, right


def _signed_distances(name: str, volume: Volume | np.ndarray) -> np.ndarray:
    """(nx, ny, nz) signed distances, NaN unknown."""
    if isinstance(volume, Volume):
        return volume.values
    values = np.asarray(volume)
    if values.dtype.kind not in "if" or values.ndim != 3:
        expected = f"{name}: expected a Volume, or signed distances of shape (nx, ny, nz), negative inside"
        raise ShapeError(f"{expected}, got {values.dtype} of shape {values.shape}")
    return values


def _surface_samples(name: str, surface: Volume | np.ndarray) -> np.ndarray:
    return surface_points(surface) if isinstance(surface, Volume) else checked(name, surface, ("n", 3))
