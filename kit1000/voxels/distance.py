"""True signed distance of closed meshes on a grid: exact to the triangle near the surface, signed by columns.

Lengths are in voxels, coordinates in voxel indices. The distance of a voxel is the least over the triangles within
the truncation, each measured exactly. The sign is the winding of the surface along the voxel's column: a triangle
covers a column by the crossings of its edges, and both triangles at an edge compute the very same crossing, so that
a closed surface covers each column as often upward as downward, whatever is rounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kit1000.compiled import compiled
from kit1000.errors import InputError, MeshRefused
from kit1000.mesh import Mesh, defect
from kit1000.pose import Pose
from kit1000.voxels.grid import Grid, Volume, truncation_voxels
from kit1000.voxels.slabs import for_each_slab

LANES = 8  # voxels measured at once
PLANES = 7  # linear functions that describe a triangle: height, then outward distance and place along each edge
SLIVER_WIDTH = (
    1e-9  # [voxels] a triangle thinner than this has no normal to trust: it counts as its longest edge, or a point
)
MIN_SLOPE = 1e-12  # slope of a plane that counts as none; over the widest grid it rises by less than SLACK
FAR = 1e30  # [voxels] beyond every voxel
RANGE_MARGIN = 1e-6  # [voxels] by which ranges are widened, so that no voxel is lost to rounding


class TriangleSurface(NamedTuple):
    """The triangles of a body, ready to be measured from; m of them."""

    corners: np.ndarray
    """(m, 3, 3) float64 [voxels]"""
    low: np.ndarray
    """(m, 3) float64: smallest coordinates"""
    high: np.ndarray
    """(m, 3) float64: largest coordinates"""
    planes: np.ndarray
    """(m, PLANES, 4) float64: coefficients of i, j, k and 1"""
    lengths: np.ndarray
    """(m, 3) float32: of the edges"""
    max_inradius_squared: np.ndarray
    """(m,) float32: square of the radius of the inscribed circle, a little more; -1 for slivers"""


def signed_distance(
    grid: Grid,
    bodies: Sequence[tuple[Mesh, Pose]],
    truncation: float | None = None,
    threads: int | None = None,
) -> Volume:
    """Distance to the surface of bodies, negative inside, known everywhere.

    Args:
        grid: where to measure.
        bodies: closed meshes, each with its `world_from_body`; of several the least distance counts.
        truncation: [m] beyond which a value is -1 or 1; five voxels by default.
        threads: how many to use; all cores by default. The result is the same.

    Raises:
        InputError: when a mesh is not closed, and so has no inside.
    """
    reach = truncation_voxels(grid, truncation)
    surfaces = [_prepared_surface(grid, number, *body) for number, body in enumerate(bodies)]
    values = np.ones(grid.shape, np.float32)

    def measure(start: int, stop: int) -> None:
        shape = (stop - start, *grid.shape[1:])
        squares = np.empty((*shape[:2], shape[2] + LANES), np.float32)
        turns = np.empty(shape, np.int16)
        for surface in surfaces:
            squares.fill(np.inf)
            turns.fill(0)
            _add_winding(start, stop, surface, turns)
            _lower_distances(start, stop, surface, reach, squares)
            _write_signed(squares, turns, reach, values[start:stop])

    for_each_slab(measure, grid.shape, threads)
    return Volume.adopt(grid, values)


def _prepared_surface(grid: Grid, number: int, mesh: Mesh, world_from_body: Pose) -> TriangleSurface:
    fault = defect(mesh)
    if fault is not None:
        raise MeshRefused(f"bodies[{number}]: no inside to tell ({fault}); equal vertices join by Mesh.merged()")
    if world_from_body.batch_shape != ():
        raise InputError(f"bodies[{number}]: expected one pose, got {world_from_body.batch_shape}")
    places = (grid.world_from_grid.inverse() @ world_from_body).apply(mesh.vertices) / grid.voxel_size
    m = len(mesh.faces)
    surface = TriangleSurface(
        corners=places[mesh.faces],
        low=np.empty((m, 3)),
        high=np.empty((m, 3)),
        planes=np.empty((m, PLANES, 4)),
        lengths=np.empty((m, 3), np.float32),
        max_inradius_squared=np.empty(m, np.float32),
    )
    _fill_surface(surface)
    return surface


@compiled
def _fill_surface(surface):
    """Fill all but the corners of a surface."""
    edges, lengths, normal, along, out = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for t in range(surface.corners.shape[0]):
        corners, planes = surface.corners[t], surface.planes[t]
        for axis in range(3):
            a, b, c = corners[0, axis], corners[1, axis], corners[2, axis]
            surface.low[t, axis], surface.high[t, axis] = min(a, b, c), max(a, b, c)
            edges[0, axis], edges[1, axis], edges[2, axis] = b - a, c - b, a - c
        for e in range(3):
            lengths[e] = _length(edges[e])
        longest = np.argmax(lengths)
        _cross(edges[0], edges[1], normal)
        size = _length(normal)
        if lengths[longest] < SLIVER_WIDTH:
            edges[longest], lengths[longest] = 0.0, 0.0
        sliver = size <= SLIVER_WIDTH * max(lengths[longest], SLIVER_WIDTH)
        surface.max_inradius_squared[t] = -1 if sliver else 1.01 * (size / (lengths[0] + lengths[1] + lengths[2])) ** 2
        if sliver:
            _perpendicular(edges[longest], normal)
        _set_plane(planes[0], normal, corners[0])
        for e in range(3):
            edge = longest if sliver else e
            surface.lengths[t, e] = lengths[edge]
            along[:] = edges[edge]
            if lengths[edge] == 0:
                _perpendicular(normal, along)
            _cross(along, normal, out)
            _set_plane(planes[1 + e], out, corners[edge])
            _set_plane(planes[4 + e], along, corners[edge])


@compiled
def _perpendicular(direction, into):
    """Write some vector at a right angle to a direction; any vector where that is zero."""
    axis = np.zeros(3)
    axis[np.argmin(np.abs(direction))] = 1
    _cross(direction, axis, into)
    if _length(into) == 0:
        into[:] = axis


@compiled
def _cross(a, b, into):
    into[0] = a[1] * b[2] - a[2] * b[1]
    into[1] = a[2] * b[0] - a[0] * b[2]
    into[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def _length(a):
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@compiled
def _set_plane(plane, direction, point):
    """The distance along a direction from a point, as coefficients of i, j, k and 1."""
    scale = 1 / _length(direction)
    plane[0], plane[1], plane[2] = direction[0] * scale, direction[1] * scale, direction[2] * scale
    plane[3] = -(plane[0] * point[0] + plane[1] * point[1] + plane[2] * point[2])


@compiled
def _add_winding(start, stop, surface, turns):
    """Add to `turns` (stop - start, ny, nz) how often the surface winds about each voxel.

    Going up a column, each triangle facing down adds one from its crossing on, each facing up takes one off.
    """
    ny, nz = turns.shape[1:]
    for t in range(surface.corners.shape[0]):
        first = max(start, np.int64(np.ceil(min(surface.low[t, 0], 1e9))))
        last = min(stop - 1, np.int64(np.floor(max(surface.high[t, 0], -1.0))))
        if first > last or surface.low[t, 1] > ny or surface.high[t, 1] < 0 or surface.low[t, 2] > nz:
            continue
        corners, plane = surface.corners[t], surface.planes[t, 0]
        low, high = surface.low[t, 2], surface.high[t, 2]
        for i in range(first, last + 1):
            up, down = _crossings(corners, i)
            left = np.int64(np.ceil(min(max(min(up, down), 0.0), ny)))
            right = np.int64(np.ceil(min(max(max(up, down), 0.0), ny)))
            turn = 1 if up > down else -1
            for j in range(left, right):
                height = -(plane[3] + plane[0] * i + plane[1] * j) / plane[2]
                height = min(max(height, low), high) if height == height else low
                k = np.int64(np.ceil(min(max(height, 0.0), nz)))
                if k < nz:
                    turns[i - start, j, k] += turn
    for i in range(turns.shape[0]):
        for j in range(ny):
            winding = np.int16(0)
            for k in range(nz):
                winding += turns[i, j, k]
                turns[i, j, k] = winding


@compiled
def _crossings(corners, i):
    """Where, in j, the edges of a triangle cross the line of this i: the edge that goes up in i, the one down.

    A corner exactly on the line counts as beyond it. Each edge is computed from its lower end, whichever triangle
    asks; equal results where no edge crosses.
    """
    up, down = 0.0, 0.0
    for e in range(3):
        a, b = corners[e], corners[(e + 1) % 3]
        if (a[0] < i) != (b[0] < i):
            low, high = (a, b) if a[0] < b[0] else (b, a)
            j = low[1] + (i - low[0]) / (high[0] - low[0]) * (high[1] - low[1])
            if a[0] < i:
                up = j
            else:
                down = j
    return up, down


@compiled
def _lower_distances(start, stop, surface, reach, squares):
    """Lower `squares` (stop - start, ny, nz + LANES), the squared distances, to those of triangles within reach."""
    ny, room = squares.shape[1:]
    nz, wide, flat = room - LANES, reach + RANGE_MARGIN, squares.reshape(-1)
    for t in range(surface.corners.shape[0]):
        low, high, planes, lengths = surface.low[t], surface.high[t], surface.planes[t], surface.lengths[t]
        if low[0] > stop - 1 + wide or high[0] < start - wide:
            continue
        first_i, last_i = _clamped_range(low[0] - wide, high[0] + wide, start, stop)
        first_j, last_j = _clamped_range(low[1] - wide, high[1] + wide, 0, ny)
        first_k, last_k = _clamped_range(low[2] - wide, high[2] + wide, 0, nz)
        middle, radius = (low + high) / 2, np.sqrt(np.sum((high - low) ** 2)) / 2
        large = radius > 2
        for i in range(first_i, last_i):
            for j in range(first_j, last_j):
                room_k = (radius + wide) ** 2 - (i - middle[0]) ** 2 - (j - middle[1]) ** 2
                if room_k < 0:
                    continue
                half = np.sqrt(room_k)
                first, last = _clamped_range(middle[2] - half, middle[2] + half, first_k, last_k)
                if large:
                    first, last = _clip_to_triangle(planes, wide, i, j, first, last)
                if first < last:
                    at = ((i - start) * ny + j) * room + first
                    _measure_row(planes, lengths, surface.max_inradius_squared[t], i, j, first, last, at, flat)


@compiled
def _clip_to_triangle(planes, wide, i, j, first, last):
    """Narrow the range first .. last - 1 of k to voxels within reach of a triangle's plane and of its three sides."""
    for p in range(4):
        base, slope = planes[p, 0] * i + planes[p, 1] * j + planes[p, 3], planes[p, 2]
        least = -wide if p == 0 else -FAR
        if abs(slope) < MIN_SLOPE:
            if base < least - RANGE_MARGIN or base > wide + RANGE_MARGIN:
                return first, first
        else:
            a, b = (least - base) / slope, (wide - base) / slope
            first, last = _clamped_range(min(a, b), max(a, b), first, last)
    return first, last


@compiled
def _clamped_range(low, high, first, stop):
    """Whole numbers from low to high among first .. stop - 1, as a range."""
    start = np.int64(np.ceil(min(max(low, first), stop)))
    return start, max(start, np.int64(np.floor(max(min(high, stop - 1.0), first - 1.0))) + 1)


@compiled
def _measure_row(planes, lengths, widest, i, j, first, last, at, squares):
    """Lower `squares`, which begin at k = first, to the squared distance from one triangle, at least up to last - 1.

    In the triangle's plane the nearest point lies inside, or on the nearest of the three edges. A whole number of
    blocks of LANES voxels is measured, each by one pass of the processor; what lies beyond is measured as truly.
    """
    zero = np.float32(0)
    h0, h1 = _plane_along_row(planes[0], i, j, first)
    a0, a1 = _plane_along_row(planes[1], i, j, first)
    b0, b1 = _plane_along_row(planes[2], i, j, first)
    c0, c1 = _plane_along_row(planes[3], i, j, first)
    d0, d1 = _plane_along_row(planes[4], i, j, first)
    e0, e1 = _plane_along_row(planes[5], i, j, first)
    f0, f1 = _plane_along_row(planes[6], i, j, first)
    d2, e2, f2 = lengths[0], lengths[1], lengths[2]
    for n in range((last - first + LANES - 1) // LANES * LANES):
        k = np.float32(np.int32(n))
        height, a, b, c = h0 + h1 * k, a0 + a1 * k, b0 + b1 * k, c0 + c1 * k
        d, e, f = d0 + d1 * k, e0 + e1 * k, f0 + f1 * k
        d -= min(max(d, zero), d2)
        e -= min(max(e, zero), e2)
        f -= min(max(f, zero), f2)
        beside = min(min(a * a + d * d, b * b + e * e), c * c + f * f)
        inside = (max(max(a, b), c) <= zero) & (beside <= widest)
        square = height * height + (zero if inside else beside)
        place = np.uint64(at) + np.uint64(n)
        squares[place] = min(squares[place], square)


@compiled
def _plane_along_row(plane, i, j, first):
    """A plane along a row of voxels that begins at k = first: value and slope, float32."""
    base = plane[0] * i + plane[1] * j + plane[2] * first + plane[3]
    return np.float32(base), np.float32(plane[2])


@compiled
def _write_signed(squares, turns, reach, values):
    """Lower `values` to the signed and truncated distances of one body."""
    scale, one = np.float32(1 / reach), np.float32(1)
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            for k in range(values.shape[2]):
                distance = min(np.sqrt(squares[i, j, k]) * scale, one)
                signed = -distance if turns[i, j, k] > 0 else distance
                values[i, j, k] = min(values[i, j, k], signed)
