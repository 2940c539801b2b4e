"""How alike two volumes are: what both take for solid, and how far apart their surfaces lie.

Nothing is drawn at random, so a volume compared with itself is alike to the bit: IoU 1, chamfer distance 0.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from kit1000.errors import InputError, ShapeError, checked
from kit1000.voxels import Volume, surface_points


def occupancy_iou(a: Volume | np.ndarray, b: Volume | np.ndarray) -> float:
    """Intersection over union of what two volumes take for solid, over the voxels that both know. 0 to 1.

    |A and B| / |A or B| with A, B the voxels of negative distance, as in `Volume.occupied`. Two volumes that both know
    a voxel and take none for solid are alike: 1. Where they know no voxel in common, nothing was told: 0.

    Args:
        a: a volume, or signed distances (nx, ny, nz) of any scale, negative inside, NaN unknown.
        b: another on the same grid; the two may change places.
    """
    left, right = _alike(a, b)
    known = ~np.isnan(left) & ~np.isnan(right)
    if not known.any():
        return 0.0
    inside, other = left[known] < 0, right[known] < 0
    union = np.count_nonzero(inside | other)
    return np.count_nonzero(inside & other) / union if union else 1.0


def known_share(predicted: Volume | np.ndarray, true: Volume | np.ndarray) -> float:
    """The share of the voxels known in `true` that `predicted` knows too, 0 to 1; 1 where there are none.

    It stands beside `occupancy_iou`, which a volume that dares to say little could make large.
    """
    left, right = _alike(predicted, true)
    wanted = ~np.isnan(right)
    return float(np.mean(~np.isnan(left[wanted]))) if wanted.any() else 1.0


def surface_chamfer(a: Volume | np.ndarray, b: Volume | np.ndarray) -> float:
    """Symmetric chamfer distance between two surfaces [m].

    (mean over A of the distance to the nearest of B + mean over B of the distance to the nearest of A) / 2, Euclidean,
    with A, B points on the surfaces: of a volume those where a line of its grid passes from free to solid between two
    known voxels (`kit1000.voxels.surface_points`), found between the voxels. Two without any surface are alike: 0; to
    one without, all else is infinitely far.

    Args:
        a: a volume, or points (n, 3) [m] of a surface in the world, evenly spread.
        b: another; the two may change places. Volumes on one grid have their points on the same lines, which keeps
            the spacing of the points out of the result.
    """
    left, right = _points("a", a), _points("b", b)
    if not len(left) or not len(right):
        return 0.0 if len(left) == len(right) else float("inf")
    there, back = KDTree(right).query(left)[0], KDTree(left).query(right)[0]
    return float(there.mean() + back.mean()) / 2


def _alike(a: Volume | np.ndarray, b: Volume | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distances of two volumes on one grid."""
    if isinstance(a, Volume) and isinstance(b, Volume) and a.grid != b.grid:
        raise InputError("volumes: expected two on one grid; kit1000.voxels.resample reads one on the grid of another")
    left, right = _distances("a", a), _distances("b", b)
    if left.shape != right.shape:
        raise ShapeError(f"volumes: expected two of one shape, got {left.shape} and {right.shape}")
    return left, right


def _distances(name: str, volume: Volume | np.ndarray) -> np.ndarray:
    """(nx, ny, nz) signed distances, NaN unknown."""
    if isinstance(volume, Volume):
        return volume.values
    values = np.asarray(volume)
    if values.dtype.kind not in "if" or values.ndim != 3:
        wanted = f"{name}: expected a Volume, or signed distances of shape (nx, ny, nz), negative inside"
        raise ShapeError(f"{wanted}, got {values.dtype} of shape {values.shape}")
    return values


def _points(name: str, surface: Volume | np.ndarray) -> np.ndarray:
    return surface_points(surface) if isinstance(surface, Volume) else checked(name, surface, ("n", 3))
