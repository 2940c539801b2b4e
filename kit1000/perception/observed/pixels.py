"""Cropped depth images, and the points of their pixels."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter

from kit1000.camera import Camera
from kit1000.numerics.compiled import compiled
from kit1000.values import LabelledDepth, Query, View

SUBPIXELS = 4  # points across a pixel: closer than columns, also on slanted surfaces
STRIDE = 2  # a normal for every second pixel of every second row


def cropped(image: LabelledDepth, box: tuple[slice, slice]) -> LabelledDepth:
    """Some rows and columns of an image, with the camera that fits them."""
    camera, depth = image.view.camera, image.view.depth[box]
    left, top = box[1].start, box[0].start
    shifted = Camera(depth.shape[1], depth.shape[0], camera.fx, camera.fy, camera.cx - left, camera.cy - top)
    return LabelledDepth(View(shifted, image.view.world_from_camera, depth), image.labels[box])


def pixel_points(view: View, mask: np.ndarray) -> np.ndarray:
    """(n, 3) [m] world: of the pixels of a mask (H, W) bool that have a return, row by row."""
    v, u = np.nonzero(mask & (view.depth > 0))
    return view.world_from_camera.apply(view.camera.unproject_pixels(np.stack([u, v], -1), view.depth[v, u]))


def subpixel_points(view: View, mask: np.ndarray) -> np.ndarray:
    """(n, 3) [m] world: points spread evenly over the pixels of a mask (H, W), on the local plane of each pixel.

    A mask holds the pixels whose centres an object covers: on average it ends half a pixel beyond the last.
    """
    mask, camera = mask & (view.depth > 0), view.camera
    v, u = np.nonzero(mask)
    across, down = (depth_slopes(view.depth, mask, axis)[v, u] for axis in (1, 0))
    points = np.empty((len(v), SUBPIXELS * SUBPIXELS, 3))
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    camera_pose = view.world_from_camera
    rotation, shift = camera_pose.rotation_matrix(), camera_pose.xyz
    _subdivide(v, u, view.depth[v, u], across, down, intrinsics, rotation, shift, points)
    return points.reshape(-1, 3)


@compiled
def _subdivide(v, u, depth, across, down, intrinsics, rotation, shift, points):
    """Fill `points` (n, SUBPIXELS^2, 3) [m], of the world, from pixels, their depths and depth slopes."""
    fx, fy, cx, cy = intrinsics
    for n in range(len(v)):
        for k in range(SUBPIXELS * SUBPIXELS):
            a = (k % SUBPIXELS + 0.5) / SUBPIXELS - 0.5
            b = (k // SUBPIXELS + 0.5) / SUBPIXELS - 0.5
            z = depth[n] + across[n] * a + down[n] * b
            points[n, k] = transformed(rotation, shift, (u[n] + a - cx) / fx * z, (v[n] + b - cy) / fy * z, z)


@compiled
def transformed(rotation, shift, x, y, z):
    """A point, rotated and shifted as by `Pose.apply`, without an array for each step."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + shift[0],
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + shift[1],
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + shift[2],
    )


def oriented_points(view: View, mask: np.ndarray, window: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Points of an image with normals from their neighbours.

    Args:
        view: the image.
        mask: (H, W) bool, the pixels of interest.
        window: [px] over which points are averaged for the normals.

    Returns:
        Points (n, 3) [m] and normals (n, 3) in the world, and the area [m^2] that a point represents.
    """
    mask = mask & (view.depth > 0)
    v, u = np.nonzero(mask)
    if len(v) == 0:
        return np.empty((0, 3)), np.empty((0, 3)), 0.0
    low, high = (v.min(), u.min()), (v.max() + 1, u.max() + 1)
    crop = np.s_[low[0] : high[0], low[1] : high[1]]
    v, u = np.mgrid[crop]
    cloud = view.camera.unproject_pixels(np.stack([u, v], -1), view.depth[crop])
    share = uniform_filter(mask[crop].astype(float), window)
    mean = np.stack([uniform_filter(cloud[..., k] * mask[crop], window) for k in range(3)], -1)
    mean /= np.maximum(share, 1e-9)[..., None]
    normals = np.cross(np.gradient(mean, axis=0), np.gradient(mean, axis=1))
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    good = mask[crop] & (share > 0.999)
    good[::STRIDE] = False
    good[:, ::STRIDE] = False
    sight = cloud / np.maximum(np.linalg.norm(cloud, axis=-1, keepdims=True), 1e-9)
    cosine = np.einsum("ijk,ijk->ij", normals, sight)
    normals = np.where(cosine[..., None] > 0, -normals, normals)
    area = cloud[..., 2] ** 2 / (view.camera.fx * view.camera.fy) / np.maximum(np.abs(cosine), 0.2)
    points = view.world_from_camera.apply(cloud[good])
    rotated = view.world_from_camera.rotate(normals[good])
    return points, rotated, float(np.median(area[good])) * STRIDE**2


def depth_slopes(depth: np.ndarray, mask: np.ndarray, axis: int) -> np.ndarray:
    """(H, W) [m/px]: slope of the depth (H, W) [m] at each pixel along an axis, to the nearer neighbour in the mask."""
    ahead = np.roll(depth, -1, axis) - depth
    behind = depth - np.roll(depth, 1, axis)
    ahead = np.where(np.roll(mask, -1, axis), ahead, np.inf)
    behind = np.where(np.roll(mask, 1, axis), behind, np.inf)
    nearer = np.where(np.abs(ahead) < np.abs(behind), ahead, behind)
    return np.where(np.isfinite(nearer), nearer, 0.0)


def observed_points(query: Query, mask: np.ndarray, most: int | None = None) -> np.ndarray:
    """(n, 3) float64 [m] world: the points of the pixels of a mask (H, W) that have a return, row by row.

    With `most`, every k-th of them, so that there are no more than that.
    """
    points = pixel_points(query.view, mask)
    return points if most is None else points[:: -(-len(points) // most) or 1]
