"""How much of each cell of a grid a closed mesh fills: the soft labels of a completion network."""

from __future__ import annotations

import numpy as np

from kit1000.mesh import Mesh
from kit1000.numerics.compiled import compiled
from kit1000.pose import Pose
from kit1000.voxels import Grid

COLUMNS = 2  # across a cell, along x and y; along z the share is exact


def filled_share(mesh: Mesh, world_from_mesh: Pose, grid: Grid) -> np.ndarray:
    """The share of each cell that a closed mesh fills, from the heights at which lines along z cross its surface.

    Args:
        mesh: closed, without self-intersection.
        world_from_mesh: its pose.
        grid: of the cells.

    Returns:
        (nx, ny, nz) float32, 0 to 1.
    """
    points = (grid.world_from_grid.inverse() @ world_from_mesh).apply(mesh.vertices) / grid.voxel_size + 0.5
    share = np.zeros(grid.shape, np.float32)
    _add_crossings(np.ascontiguousarray(points), mesh.faces, COLUMNS, share)
    _sum_downwards(share)
    return np.clip(share, 0, 1)


@compiled
def _add_crossings(points, faces, columns, share):
    """Write to `share` (nx, ny, nz) the steps at the crossings of all lines; points (n, 3) are in cells.

    The sum of the steps of a cell and of those above it is its share: a face that looks up fills what is below it.
    """
    nx, ny, nz = share.shape
    for f in range(len(faces)):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        normal = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if normal == 0:
            continue
        side = 1.0 if normal > 0 else -1.0
        first_x, last_x = _lines(min(a[0], b[0], c[0]), max(a[0], b[0], c[0]), columns, nx)
        first_y, last_y = _lines(min(a[1], b[1], c[1]), max(a[1], b[1], c[1]), columns, ny)
        for i in range(first_x, last_x):
            x = (i + 0.5) / columns
            for j in range(first_y, last_y):
                y = (j + 0.5) / columns
                if _side(a, b, x, y) != side or _side(b, c, x, y) != side or _side(c, a, x, y) != side:
                    continue
                over_b = (x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])
                over_c = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
                z = a[2] + (over_b * (b[2] - a[2]) + over_c * (c[2] - a[2])) / normal
                if z > 0:
                    _add_step(share[i // columns, j // columns], min(z, nz), side / (columns * columns))


@compiled
def _lines(low, high, columns, cells):
    """First of the lines between two coordinates, and the one after the last."""
    return max(int(np.ceil(low * columns - 0.5)), 0), min(int(np.floor(high * columns - 0.5)) + 1, cells * columns)


@compiled
def _add_step(column, z, weight):
    """Add the weight to all below height z of a column of cells (nz,), as steps."""
    k = int(np.ceil(z)) - 1
    column[k] += weight * (z - k)
    if k > 0:
        column[k - 1] += weight * (k + 1 - z)


@compiled
def _side(a, b, x, y):
    """1 where a point lies to the left of the edge from a to b, else -1.

    Always evaluated from the smaller end: a point on an edge belongs to exactly one of the two faces beside it.
    """
    if a[0] < b[0] or (a[0] == b[0] and a[1] < b[1]):
        return 1.0 if (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) > 0 else -1.0
    return -1.0 if (a[0] - b[0]) * (y - b[1]) - (a[1] - b[1]) * (x - b[0]) > 0 else 1.0


@compiled
def _sum_downwards(share):
    """Add to each cell of (nx, ny, nz) all those above it."""
    nx, ny, nz = share.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz - 2, -1, -1):
                share[i, j, k] += share[i, j, k + 1]
