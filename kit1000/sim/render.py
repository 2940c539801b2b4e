"""Depth and identity images of meshes, exact to rounding: a z-buffer over triangles, compiled by numba.

Cameras are OpenCV (+x right, +y down, +z forward) with the centre of pixel (u, v) AT (u, v). Depth is
measured along the optical axis. The image does not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kit1000.camera import Camera
from kit1000.engines.cores import usable_cores
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.sim import raster
from kit1000.sim.raster import Intrinsics, TriangleBatch

MAX_BODIES = np.iinfo(np.int16).max
BAND_ROWS = 32  # [px] rows filled at once: enough bands to share among threads, a buffer that stays in the cache
CHUNK_FACES = 1 << 15  # faces prepared at once


@dataclass(frozen=True, eq=False)
class Frame:
    """What a camera of W x H pixels sees; all arrays read-only."""

    depth: np.ndarray
    """(H, W) float32 [m] along the optical axis, 0 where nothing is seen."""
    ids: np.ndarray
    """(H, W) int16: 0 nothing, i + 1 the i-th body."""
    faces: np.ndarray
    """(H, W) int32: index of the face within its body, -1 where nothing is seen."""


class _ProjectedBody(NamedTuple):
    """A body as the camera has it: n vertices, m faces."""

    faces: np.ndarray  # (m, 3) int32
    first_face: int  # number of its first face among those of all bodies
    points_cam: np.ndarray  # (n, 3) [m] vertices in the camera
    snapped_uv: np.ndarray  # (n, 2) int32, pixels / 4096
    vertex_state: np.ndarray  # (n,) uint8


def render(
    camera: Camera, world_from_camera: Pose, bodies: Sequence[tuple[Mesh, Pose]], threads: int | None = None
) -> Frame:
    """Draw bodies, each a mesh and its `world_from_body`, as the camera sees them.

    Both sides of a face are drawn. Surfaces nearer than 1 mm to the camera are cut away. Where surfaces
    coincide exactly, the body named first is seen. `threads` defaults to the cores at hand.
    """
    if len(bodies) > MAX_BODIES:
        raise InputError(f"render: {len(bodies)} bodies, expected at most {MAX_BODIES}")
    counts = [len(mesh.faces) for mesh, _ in bodies]
    first_of = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
    body_of = np.repeat(np.arange(len(bodies), dtype=np.int16), counts)
    depth = np.zeros((camera.height, camera.width), np.float32)
    ids = np.zeros(depth.shape, np.int16)
    faces = np.full(depth.shape, -1, np.int32)
    lens = Intrinsics.of(camera)
    camera_from_world = world_from_camera.inverse()

    def place(item: tuple[tuple[Mesh, Pose], int]) -> _ProjectedBody:
        (mesh, world_from_body), first = item
        return _project_body(lens, mesh, camera_from_world @ world_from_body, first)

    def prepare(item: tuple[_ProjectedBody, int]) -> list[tuple[TriangleBatch, int]]:
        return _triangle_batches(lens, *item)

    def fill(top: int) -> None:
        inverse = np.zeros((min(BAND_ROWS, camera.height - top), camera.width))
        winner = np.empty(inverse.shape, np.int32)
        for batch, count in batches:
            raster.fill_band(top, batch, count, inverse, winner)
        band = slice(top, top + BAND_ROWS)
        raster.resolve_band(inverse, winner, body_of, first_of, depth[band], ids[band], faces[band])

    with _Workers(threads) as workers:
        placed = workers.map(place, zip(bodies, first_of[:-1].tolist(), strict=True))
        chunks = [(body, start) for body in placed for start in range(0, len(body.faces), CHUNK_FACES)]
        batches = [batch for group in workers.map(prepare, chunks) for batch in group]
        workers.map(fill, range(0, camera.height, BAND_ROWS))
    for array in (depth, ids, faces):
        array.setflags(write=False)
    return Frame(depth, ids, faces)


class _Workers:
    """Threads that live for one picture (the loops release the interpreter); none when one is asked for."""

    def __init__(self, threads: int | None) -> None:
        count = usable_cores() if threads is None else threads
        self._pool = ThreadPoolExecutor(count) if count > 1 else None

    def map(self, function: Callable, items: Iterable) -> list:
        """[function(item) for item in items], shared among the threads."""
        return list(map(function, items) if self._pool is None else self._pool.map(function, items))

    def __enter__(self) -> _Workers:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown()


def _project_body(lens: Intrinsics, mesh: Mesh, camera_from_body: Pose, first: int) -> _ProjectedBody:
    n = len(mesh.vertices)
    seen, snapped, state = np.empty((n, 3)), np.empty((n, 2), np.int32), np.empty(n, np.uint8)
    rotation, shift = camera_from_body.rotation_matrix(), camera_from_body.xyz
    raster.project_vertices(lens, mesh.vertices, rotation, shift, seen, snapped, state)
    return _ProjectedBody(mesh.faces, first, seen, snapped, state)


def _triangle_batches(lens: Intrinsics, body: _ProjectedBody, start: int) -> list[tuple[TriangleBatch, int]]:
    """Triangles to fill among CHUNK faces, and how many: those seen whole, then what is left of those cut."""
    faces, first = body.faces[start : start + CHUNK_FACES], body.first_face + start
    whole, cut = _empty_batch(len(faces)), np.empty(len(faces), np.int32)
    kept, crossing = raster.prepare_triangles(
        lens, faces, first, body.points_cam, body.snapped_uv, body.vertex_state, whole, cut
    )
    if not crossing:
        return [(whole, kept)]
    pieces = _empty_batch(6 * crossing)
    return [
        (whole, kept),
        (pieces, raster.prepare_clipped(lens, cut[:crossing], faces, first, body.points_cam, pieces)),
    ]


def _empty_batch(k: int) -> TriangleBatch:
    return TriangleBatch(
        np.empty((k, 6), np.int32), np.empty((k, 5)), np.empty((k, 2), np.int16), np.empty(k, np.int32)
    )
