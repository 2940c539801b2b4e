"""Windows of a depth image, and the points that its pixels stand for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from kit1000.camera import Camera
from kit1000.compiled import compiled
from kit1000.values import LabelledDepth, View

SPREAD = 4  # places across a pixel: closer than columns, also on what is seen aslant
STRIDE = 2  # every second pixel of rows and columns has a normal


class Noise(NamedTuple):
    """Of an image."""

    near: float
    """[m] how far points of a plane may lie from it."""
    flat: float
    """[rad] how far facets of one face may lean from it."""
    smooth: int
    """Pixels over which normals are taken."""


IDEAL = Noise(0.5e-3, float(np.radians(4)), 3)
SENSOR = Noise(2e-3, float(np.radians(8)), 7)


def noise_of(sensor: str) -> Noise:
    """Of the images of a sensor."""
    return IDEAL if sensor == "ideal" else SENSOR


def window(look: LabelledDepth, box: tuple[slice, slice]) -> LabelledDepth:
    """An image of its own: some rows and columns of another."""
    camera, depth = look.view.camera, look.view.depth[box]
    left, top = box[1].start, box[0].start
    shifted = Camera(depth.shape[1], depth.shape[0], camera.fx, camera.fy, camera.cx - left, camera.cy - top)
    return LabelledDepth(View(shifted, look.view.world_from_camera, depth), look.labels[box])


def spread_points(view: View, mask: np.ndarray) -> np.ndarray:
    """Places spread evenly over the pixels of a mask (H, W), on the plane that each pixel saw. (n, 3) [m], world.

    A mask holds the pixels whose centres a thing covers: on average it ends half a pixel beyond the last.
    """
    mask, camera = mask & (view.depth > 0), view.camera
    v, u = np.nonzero(mask)
    across, down = (_slope(view.depth, mask, axis)[v, u] for axis in (1, 0))
    points = np.empty((len(v), SPREAD * SPREAD, 3))
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    eye = view.world_from_camera
    _spread(v, u, view.depth[v, u], across, down, lens, eye.rotation_matrix(), eye.xyz, points)
    return points.reshape(-1, 3)


@compiled
def _spread(v, u, depth, across, down, lens, rotation, shift, points):
    """Fill `points` (n, SPREAD^2, 3) [m], of the world, from pixels, their depths and the slopes of these."""
    fx, fy, cx, cy = lens
    for n in range(len(v)):
        for place in range(SPREAD * SPREAD):
            a = (place % SPREAD + 0.5) / SPREAD - 0.5
            b = (place // SPREAD + 0.5) / SPREAD - 0.5
            z = depth[n] + across[n] * a + down[n] * b
            points[n, place] = moved(rotation, shift, (u[n] + a - cx) / fx * z, (v[n] + b - cy) / fy * z, z)


@compiled
def moved(rotation, shift, x, y, z):
    """A point once it is turned and shifted, as `Pose.apply` does it, without an array for each step."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + shift[0],
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + shift[1],
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + shift[2],
    )


def oriented_points(view: View, mask: np.ndarray, smooth: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Points of an image with normals from their neighbours.

    Args:
        view: the image.
        mask: (H, W) bool, the pixels that are asked about.
        smooth: pixels over which points are averaged for the normals.

    Returns:
        (n, 3) [m] and (n, 3) unit, world, and the area [m^2] that a point stands for.
    """
    mask = mask & (view.depth > 0)
    v, u = np.nonzero(mask)
    if len(v) == 0:
        return np.empty((0, 3)), np.empty((0, 3)), 0.0
    low, high = (v.min(), u.min()), (v.max() + 1, u.max() + 1)
    crop = np.s_[low[0] : high[0], low[1] : high[1]]
    v, u = np.mgrid[crop]
    cloud = view.camera.unproject_pixels(np.stack([u, v], -1), view.depth[crop])
    share = uniform_filter(mask[crop].astype(float), smooth)
    mean = np.stack([uniform_filter(cloud[..., k] * mask[crop], smooth) for k in range(3)], -1)
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
    turned = view.world_from_camera.rotate(normals[good])
    return points, turned, float(np.median(area[good])) * STRIDE**2


def _slope(depth: np.ndarray, mask: np.ndarray, axis: int) -> np.ndarray:
    """(H, W) [m a pixel]: how the depth goes on across each pixel, by the nearer of its two neighbours in the mask."""
    ahead = np.roll(depth, -1, axis) - depth
    behind = depth - np.roll(depth, 1, axis)
    ahead = np.where(np.roll(mask, -1, axis), ahead, np.inf)
    behind = np.where(np.roll(mask, 1, axis), behind, np.inf)
    nearer = np.where(np.abs(ahead) < np.abs(behind), ahead, behind)
    return np.where(np.isfinite(nearer), nearer, 0.0)
