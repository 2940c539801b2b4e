"""Renderer of depth and segmentation images of meshes, exact to rounding: a z-buffer over triangles, by numba.

Cameras are OpenCV (+x right, +y down, +z forward); the centre of pixel (u, v) is at (u, v). Depth is measured along the
optical axis. The image does not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kit1000.camera import Camera
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.parallel import thread_map
from kit1000.pose import Pose
from kit1000.sim import raster
from kit1000.sim.raster import Intrinsics, TriangleBatch

MAX_BODIES = np.iinfo(np.int16).max
BAND_ROWS = 32  # [px] per task: enough bands for all threads, and a buffer that fits the cache
CHUNK_FACES = 1 << 15  # faces per task


@dataclass(frozen=True, eq=False)
class RenderedImage:
    """A rendered image of W x H pixels; all arrays read-only."""

    depth: np.ndarray
    """(H, W) float32 [m] along the optical axis, 0 for no surface."""
    body_ids: np.ndarray
    """(H, W) int16: i + 1 for the i-th body, 0 for none."""
    face_ids: np.ndarray
    """(H, W) int32: index of the face within its body, -1 for none."""


class _ProjectedBody(NamedTuple):
    """A body projected to the camera: n vertices, m faces."""

    faces: np.ndarray  # (m, 3) int32
    first_face: int  # index of its first face among the faces of all bodies
    points: np.ndarray  # (n, 3) [m] vertices in the camera frame
    uv: np.ndarray  # (n, 2) int32, pixels / 4096
    state: np.ndarray  # (n,) uint8, of the vertices


def render(
    camera: Camera, world_from_camera: Pose, bodies: Sequence[tuple[Mesh, Pose]], threads: int | None = None
) -> RenderedImage:
    """Render bodies, each a mesh and its `world_from_body`.

    Both sides of a face are visible. Surfaces nearer than 1 mm to the camera are clipped. Where surfaces coincide
    exactly, the first body is visible. `threads` defaults to the available cores.
    """
    if len(bodies) > MAX_BODIES:
        raise InputError(f"render: {len(bodies)} bodies, expected at most {MAX_BODIES}")
    counts = [len(mesh.faces) for mesh, _ in bodies]
    first_of = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
    body_of = np.repeat(np.arange(len(bodies), dtype=np.int16), counts)
    depth = np.zeros((camera.height, camera.width), np.float32)
    ids = np.zeros(depth.shape, np.int16)
    faces = np.full(depth.shape, -1, np.int32)
    intrinsics = Intrinsics.of(camera)
    camera_from_world = world_from_camera.inverse()

    def project(item: tuple[tuple[Mesh, Pose], int]) -> _ProjectedBody:
        (mesh, world_from_body), first = item
        return _project_body(intrinsics, mesh, camera_from_world @ world_from_body, first)

    def prepare(item: tuple[_ProjectedBody, int]) -> list[tuple[TriangleBatch, int]]:
        return _triangle_batches(intrinsics, *item)

    def fill(top: int) -> None:
        inverse_depth = np.zeros((min(BAND_ROWS, camera.height - top), camera.width))
        nearest_face = np.empty(inverse_depth.shape, np.int32)
        for batch, count in batches:
            raster.fill_band(top, batch, count, inverse_depth, nearest_face)
        band = slice(top, top + BAND_ROWS)
        raster.resolve_band(inverse_depth, nearest_face, body_of, first_of, depth[band], ids[band], faces[band])

    with thread_map(threads) as spread:
        projected = list(spread(project, zip(bodies, first_of[:-1].tolist(), strict=True)))
        chunks = [(body, start) for body in projected for start in range(0, len(body.faces), CHUNK_FACES)]
        batches = [batch for group in spread(prepare, chunks) for batch in group]
        list(spread(fill, range(0, camera.height, BAND_ROWS)))  # raises what a thread raised
    for array in (depth, ids, faces):
        array.setflags(write=False)
    return RenderedImage(depth, ids, faces)


def inverse_depths(camera: Camera, mesh: Mesh, camera_from_body: Pose) -> np.ndarray:
    """(H, W) float64 [1/m] inverse depths of one body alone, 0 where it is not: `render` without faces and threads."""
    intrinsics, found = Intrinsics.of(camera), np.zeros((camera.height, camera.width))
    body, faces = _project_body(intrinsics, mesh, camera_from_body, 0), np.empty(found.shape, np.int32)
    for start in range(0, len(mesh.faces), CHUNK_FACES):
        for batch, count in _triangle_batches(intrinsics, body, start):
            raster.fill_band(0, batch, count, found, faces)
    return found


def _project_body(intrinsics: Intrinsics, mesh: Mesh, camera_from_body: Pose, first: int) -> _ProjectedBody:
    n = len(mesh.vertices)
    points, uv, state = np.empty((n, 3)), np.empty((n, 2), np.int32), np.empty(n, np.uint8)
    rotation, translation = camera_from_body.rotation_matrix(), camera_from_body.xyz
    raster.project_vertices(intrinsics, mesh.vertices, rotation, translation, points, uv, state)
    return _ProjectedBody(mesh.faces, first, points, uv, state)


def _triangle_batches(intrinsics: Intrinsics, body: _ProjectedBody, start: int) -> list[tuple[TriangleBatch, int]]:
    """The triangles of CHUNK_FACES faces, with the number of entries: unclipped ones, then clipped ones."""
    faces, first = body.faces[start : start + CHUNK_FACES], body.first_face + start
    whole, to_clip = _empty_batch(len(faces)), np.empty(len(faces), np.int32)
    count, clip_count = raster.prepare_triangles(
        intrinsics, faces, first, body.points, body.uv, body.state, whole, to_clip
    )
    if not clip_count:
        return [(whole, count)]
    clipped = _empty_batch(6 * clip_count)
    return [
        (whole, count),
        (clipped, raster.prepare_clipped(intrinsics, to_clip[:clip_count], faces, first, body.points, clipped)),
    ]


def _empty_batch(k: int) -> TriangleBatch:
    return TriangleBatch(
        np.empty((k, 6), np.int32), np.empty((k, 5)), np.empty((k, 2), np.int16), np.empty(k, np.int32)
    )
