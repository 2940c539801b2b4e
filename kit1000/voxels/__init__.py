"""Volumes: truncated signed distance on posed voxel grids, from one depth image or from closed meshes.

A value is distance / truncation, from -1 to 1: negative inside, positive outside, NaN unknown. The centre of voxel
(i, j, k) is at `world_from_grid.apply((i, j, k) * voxel_size)`, as pixel centres are at integers.
"""

from kit1000.voxels.distance import signed_distance
from kit1000.voxels.grid import Grid, Volume, crop
from kit1000.voxels.sampling import resample, surface_points
from kit1000.voxels.tsdf import tsdf

__all__ = [
    "Grid",
    "Volume",
    "crop",
    "resample",
    "signed_distance",
    "surface_points",
    "tsdf",
]
