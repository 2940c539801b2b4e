"""Height fields of a body along z: a kit from above, a part from below on square and polar grids. Lengths in metres."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kit1000.mesh import Mesh
from kit1000.numerics.compiled import compiled
from kit1000.numerics.trigonometry import cosine, sine

RELIEF_CELLS = 75  # along a relief's longest side: fine enough to distinguish yaws, coarse enough for 2 ms
RELIEF_RINGS, RELIEF_ANGLES = 30, 120


@dataclass(frozen=True, eq=False)
class HeightField:
    """A kit from above, on a grid."""

    heights: np.ndarray  # heights of the cells, (nx, ny) [m]; 0, the top of the plate, beside the kit
    origin: np.ndarray  # middle of the first cell, (2,) [m]
    cell: float  # side of a cell [m]
    depth: float  # depth of the cavity [m]

    @staticmethod
    def of(kit: Mesh, cell: float, depth: float) -> HeightField:
        """The field of a kit whose top is at z = 0."""
        upside_down = Mesh(kit.vertices * [1, 1, -1], kit.faces[:, ::-1])
        heights, origin = lower_envelope(upside_down, cell)
        return HeightField(np.where(np.isfinite(heights), -heights, 0.0), origin, cell, depth)

    def minimum_filtered(self) -> HeightField:
        """The field with the minimum over each cell and its eight neighbours, float32."""
        padded = np.pad(self.heights, 1)
        rows, columns = self.heights.shape
        least = np.min([padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)], axis=0)
        return replace(self, heights=least.astype(np.float32))

    @cached_property
    def opening(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (2,) [m] of the rectangle around the cells that are open to half of the depth."""
        cells = np.argwhere(self.heights < -self.depth / 2)
        return self.origin + cells.min(0) * self.cell, self.origin + cells.max(0) * self.cell


def lower_envelope(mesh: Mesh, cell: float, margin: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The lowest height [m] of a body at each cell centre, +inf beside it.

    Returns (heights (nx, ny), corner (2,)): cell (i, j) has its centre at corner + (i, j) * cell.
    """
    shape, corner = _grid(mesh, cell, margin)
    down = mesh.triangles[mesh.normals[:, 2] < 0]
    return _lowest(down, corner[0], corner[1], cell, shape[0], shape[1]), corner


def polar_relief(resting: Mesh, depth: float, clearance: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The depth of a resting body below the rim of its cavity on a polar grid, centred on the area below the rim.

    resting: the body, its lowest point at any height; depth: [m] of its cavity: the rim lies so far above that point.
    Returns (relief (rings, angles) [m], the same grown sideways by the clearance, area of a cell (rings,) [m^2]).
    """
    cell = resting.extents.max() / RELIEF_CELLS
    heights, _ = lower_envelope(resting, cell, margin=clearance)
    depths = np.maximum(depth - (heights - resting.bounds[0, 2]), 0.0)
    if not depths.any():
        depths = np.maximum(depth - (_edge_heights(resting, cell, margin=clearance) - resting.bounds[0, 2]), 0.0)
    i, j = np.nonzero(depths)
    middle = np.array([i.mean(), j.mean()])
    reach = np.hypot(i - middle[0], j - middle[1]).max() + 1
    radii = (np.arange(RELIEF_RINGS) + 0.5) * reach / RELIEF_RINGS
    angles = np.arange(RELIEF_ANGLES) * (2 * np.pi / RELIEF_ANGLES)
    rows = np.rint(middle[0] + radii[:, None] * cosine(angles)).astype(int)
    columns = np.rint(middle[1] + radii[:, None] * sine(angles)).astype(int)
    inside = (rows >= 0) & (rows < depths.shape[0]) & (columns >= 0) & (columns < depths.shape[1])
    cells = np.clip(rows, 0, depths.shape[0] - 1), np.clip(columns, 0, depths.shape[1] - 1)
    fields = (depths, grown(depths, int(clearance / cell) + 0.5))
    relief, wider = (np.where(inside, field[cells], 0) for field in fields)
    return relief, wider, radii * (cell**2 * 2 * np.pi * reach / RELIEF_RINGS)


def _grid(mesh: Mesh, cell: float, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Shape (2,) of the grid over a body, and the centre (2,) [m] of its first cell."""
    low, high = mesh.bounds[:, :2] + np.array([[-margin], [margin]])
    shape = np.ceil((high - low) / cell).astype(int) + 1
    return shape, (low + high) / 2 - (shape - 1) * cell / 2


def _edge_heights(mesh: Mesh, cell: float, margin: float) -> np.ndarray:
    """The lowest height of the edges of the underside in each cell [m]; +inf in a cell without edges.

    For blades and needles: a body narrower than a cell may lie between all centres, and then has no envelope.
    """
    shape, corner = _grid(mesh, cell, margin)
    down = mesh.triangles[mesh.normals[:, 2] < 0]
    start, along = down.reshape(-1, 3), (np.roll(down, -1, axis=1) - down).reshape(-1, 3)
    steps = 2 * int(np.ceil(np.abs(along[:, :2]).max() / cell)) + 1  # at most half a cell between points
    share = np.linspace(0, 1, steps + 1)
    points = (start[:, None] + share[:, None] * along[:, None]).reshape(-1, 3)
    i, j = np.rint((points[:, :2] - corner) / cell).astype(int).T
    heights = np.full(shape, np.inf)
    np.minimum.at(heights, (i, j), points[:, 2])
    return heights


def grown(depths: np.ndarray, cells: float) -> np.ndarray:
    """Depths (n, m), none negative, grown sideways: the largest within a radius [cells] of each cell.

    A disc is rows of cells, and the maximum over a row is that of two overlapping spans of a power of two.
    """
    reach = int(cells)
    across = np.arange(-reach, reach + 1)
    widths = 2 * np.floor(np.sqrt(np.maximum(cells**2 - across**2, 0)) + 1e-9).astype(int) + 1
    rows, columns = depths.shape
    spans = [np.pad(depths, reach)]  # of 1, 2, 4, ... cells to the right
    while 2 ** len(spans) <= widths.max():
        step = 2 ** (len(spans) - 1)
        spans.append(np.maximum(spans[-1][:, :-step], spans[-1][:, step:]))
    most = np.zeros_like(depths)
    for row, width in enumerate(widths):
        level, first = int(width).bit_length() - 1, reach - width // 2
        span = spans[level][row : row + rows]
        for start in {first, first + width - 2**level}:
            np.maximum(most, span[:, start : start + columns], out=most)
    return most


@compiled
def _lowest(triangles, x0, y0, cell, nx, ny):
    heights = np.full((nx, ny), np.inf)
    for t in range(triangles.shape[0]):
        ax, ay, az = triangles[t, 0]
        bx, by, bz = triangles[t, 1]
        cx, cy, cz = triangles[t, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        first = max(0, int(np.ceil((min(ax, bx, cx) - x0) / cell)))
        last = min(nx - 1, int(np.floor((max(ax, bx, cx) - x0) / cell)))
        left = max(0, int(np.ceil((min(ay, by, cy) - y0) / cell)))
        right = min(ny - 1, int(np.floor((max(ay, by, cy) - y0) / cell)))
        for i in range(first, last + 1):
            x = x0 + i * cell
            for j in range(left, right + 1):
                y = y0 + j * cell
                u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                w = 1.0 - u - v
                if u >= -1e-9 and v >= -1e-9 and w >= -1e-9:
                    heights[i, j] = min(heights[i, j], u * az + v * bz + w * cz)
    return heights
