"""Signed distance of closed meshes on a grid: exact triangle distances near the surface, signs by winding numbers.

Lengths are in voxels, coordinates in voxel indices. The distance of a voxel is the least over the triangles within the
truncation, each computed exactly. The sign comes from the winding number along the voxel's column: the crossings of its
edges decide which columns a triangle covers, and both triangles at an edge compute the same crossing, so that a closed
surface covers each column as often upward as downward, whatever the rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kit1000.errors import InputError, MeshRefused
from kit1000.mesh import Mesh, defect
from kit1000.numerics.compiled import compiled
from kit1000.pose import Pose
from kit1000.voxels.grid import Grid, Volume, for_each_slab, truncation_voxels

LANES = 8  # voxels per SIMD block
PLANES = 7  # linear functions of a triangle: height, then outward distance from each edge, position along each edge
SLIVER_WIDTH = 1e-9  # [voxels] a narrower triangle has no reliable normal and counts as its longest edge, or as a point
MIN_SLOPE = 1e-12  # of a plane; a smaller one counts as none: over the widest grid it rises less than RANGE_MARGIN
FAR = 1e30  # [voxels] farther than every voxel
RANGE_MARGIN = 1e-6  # [voxels] by which ranges are widened against rounding


class TriangleSurface(NamedTuple):
    """The m triangles of a body, prepared for distance computations."""

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
    """(m,) float32: square of the radius of the inscribed circle, plus 1 %; -1 for slivers"""


def signed_distance(
    grid: Grid,
    bodies: Sequence[tuple[Mesh, Pose]],
    truncation: float | None = None,
    threads: int | None = None,
) -> Volume:
    """Truncated signed distance to the surface of bodies, negative inside, known everywhere.

    Args:
        grid: the voxels to compute.
        bodies: closed meshes, each with its `world_from_body`; of several the smallest signed distance counts.
        truncation: [m] distance from which a value is -1 or 1; five voxels by default.
        threads: number of threads; all cores by default. The result does not depend on it.

    Raises:
        InputError: when a mesh is not closed, and so has no inside.
    """
    limit = truncation_voxels(grid, truncation)
    surfaces = [_prepared_surface(grid, number, *body) for number, body in enumerate(bodies)]
    values = np.ones(grid.shape, np.float32)

    def measure(start: int, stop: int) -> None:
        shape = (stop - start, *grid.shape[1:])
        squared = np.empty((*shape[:2], shape[2] + LANES), np.float32)
        winding = np.empty(shape, np.int16)
        for surface in surfaces:
            squared.fill(np.inf)
            winding.fill(0)
            _add_winding(start, stop, surface, winding)
            _lower_distances(start, stop, surface, limit, squared)
            _write_signed(squared, winding, limit, values[start:stop])

    for_each_slab(measure, grid.shape, threads)
    return Volume.adopt(grid, values)


def _prepared_surface(grid: Grid, number: int, mesh: Mesh, world_from_body: Pose) -> TriangleSurface:
    reason = defect(mesh)
    if reason is not None:
        raise MeshRefused(f"bodies[{number}]: no inside ({reason}); Mesh.merged() joins equal vertices")
    if world_from_body.batch_shape != ():
        raise InputError(f"bodies[{number}]: expected one pose, got {world_from_body.batch_shape}")
    vertices = (grid.world_from_grid.inverse() @ world_from_body).apply(mesh.vertices) / grid.voxel_size
    m = len(mesh.faces)
    surface = TriangleSurface(
        corners=vertices[mesh.faces],
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
    """Fill all fields of a surface but the corners."""
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
    """Write a vector perpendicular to a direction; any vector if that is zero."""
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
    """Write the signed distance from a point along a direction, as coefficients of i, j, k and 1."""
    scale = 1 / _length(direction)
    plane[0], plane[1], plane[2] = direction[0] * scale, direction[1] * scale, direction[2] * scale
    plane[3] = -(plane[0] * point[0] + plane[1] * point[1] + plane[2] * point[2])


@compiled
def _add_winding(start, stop, surface, winding):
    """Write to `winding` (stop - start, ny, nz) the winding number of the surface about each voxel.

    Upward along a column, a triangle facing down adds one from its crossing on, a triangle facing up subtracts one.
    """
    ny, nz = winding.shape[1:]
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
            sign = 1 if up > down else -1
            for j in range(left, right):
                height = -(plane[3] + plane[0] * i + plane[1] * j) / plane[2]
                height = min(max(height, low), high) if height == height else low
                k = np.int64(np.ceil(min(max(height, 0.0), nz)))
                if k < nz:
                    winding[i - start, j, k] += sign
    for i in range(winding.shape[0]):
        for j in range(ny):
            total = np.int16(0)
            for k in range(nz):
                total += winding[i, j, k]
                winding[i, j, k] = total


@compiled
def _crossings(corners, i):
    """The j at which edges of a triangle cross the plane of this i: of the edge ascending in i, of the descending one.

    A corner exactly on the plane counts as beyond it. Each edge is computed from its lower end, for either of its
    triangles; both results are 0 where no edge crosses.
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
def _lower_distances(start, stop, surface, truncation, squared):
    """Lower squared distances (stop - start, ny, nz + LANES) to those of the triangles within the truncation."""
    ny, stride = squared.shape[1:]
    nz, limit, flat = stride - LANES, truncation + RANGE_MARGIN, squared.reshape(-1)
    for t in range(surface.corners.shape[0]):
        low, high, planes, lengths = surface.low[t], surface.high[t], surface.planes[t], surface.lengths[t]
        if low[0] > stop - 1 + limit or high[0] < start - limit:
            continue
        first_i, last_i = _clamped_range(low[0] - limit, high[0] + limit, start, stop)
        first_j, last_j = _clamped_range(low[1] - limit, high[1] + limit, 0, ny)
        first_k, last_k = _clamped_range(low[2] - limit, high[2] + limit, 0, nz)
        centre, radius = (low + high) / 2, np.sqrt(np.sum((high - low) ** 2)) / 2
        large = radius > 2
        for i in range(first_i, last_i):
            for j in range(first_j, last_j):
                remaining = (radius + limit) ** 2 - (i - centre[0]) ** 2 - (j - centre[1]) ** 2
                if remaining < 0:
                    continue
                half = np.sqrt(remaining)
                first, last = _clamped_range(centre[2] - half, centre[2] + half, first_k, last_k)
                if large:
                    first, last = _clip_to_triangle(planes, limit, i, j, first, last)
                if first < last:
                    at = ((i - start) * ny + j) * stride + first
                    _measure_row(planes, lengths, surface.max_inradius_squared[t], i, j, first, last, at, flat)


@compiled
def _clip_to_triangle(planes, limit, i, j, first, last):
    """Narrow the range first .. last - 1 of k to voxels within `limit` of a triangle's plane and of its three sides."""
    for p in range(4):
        base, slope = planes[p, 0] * i + planes[p, 1] * j + planes[p, 3], planes[p, 2]
        least = -limit if p == 0 else -FAR
        if abs(slope) < MIN_SLOPE:
            if base < least - RANGE_MARGIN or base > limit + RANGE_MARGIN:
                return first, first
        else:
            a, b = (least - base) / slope, (limit - base) / slope
            first, last = _clamped_range(min(a, b), max(a, b), first, last)
    return first, last


@compiled
def _clamped_range(low, high, first, stop):
    """The integers from low to high among first .. stop - 1, as (start, stop)."""
    start = np.int64(np.ceil(min(max(low, first), stop)))
    return start, max(start, np.int64(np.floor(max(min(high, stop - 1.0), first - 1.0))) + 1)


@compiled
def _measure_row(planes, lengths, max_inradius_squared, i, j, first, last, at, squared):
    """Lower `squared` from k = first to last - 1 to the squared distance from one triangle; `at` is the index of first.

    Projected to the triangle's plane, the nearest point is inside the triangle, or on the nearest of the three edges.
    Whole blocks of LANES voxels are computed, for SIMD; the values beyond last - 1 are also correct.
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
        edge_square = min(min(a * a + d * d, b * b + e * e), c * c + f * f)
        inside = (max(max(a, b), c) <= zero) & (edge_square <= max_inradius_squared)
        square = height * height + (zero if inside else edge_square)
        index = np.uint64(at) + np.uint64(n)
        squared[index] = min(squared[index], square)


@compiled
def _plane_along_row(plane, i, j, first):
    """A plane along a row of voxels from k = first: value at first and slope, float32."""
    base = plane[0] * i + plane[1] * j + plane[2] * first + plane[3]
    return np.float32(base), np.float32(plane[2])


@compiled
def _write_signed(squared, winding, truncation, values):
    """Lower `values` to the truncated signed distances of one body."""
    scale, one = np.float32(1 / truncation), np.float32(1)
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            for k in range(values.shape[2]):
                distance = min(np.sqrt(squared[i, j, k]) * scale, one)
                signed = -distance if winding[i, j, k] > 0 else distance
                values[i, j, k] = min(values[i, j, k], signed)
