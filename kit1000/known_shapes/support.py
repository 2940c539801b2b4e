"""The plane that the bodies stand on, in the camera frame, and the noise and bend of the depths that show it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation

from kit1000.errors import InputError
from kit1000.perception.calibration.table import TUKEY, robust_plane
from kit1000.pose import Pose, unit_vector
from kit1000.values import LabelledDepth

STEP = 4  # [px] between the pixels that are fitted
MARGIN = 12  # [px] about every body, where a fattened edge may cover the table
REACH = 25e-3  # [m] from the recorded plane, of the pixels that are fitted
LEAST_PIXELS = 300
ROUNDS = 8  # of reweighting
CELL = 100  # [px] edge of the cells that show the bend: about as large as a part in an image
LEAST_CELL = 100  # fitted pixels in a cell
LEAST_BEND = 0.1e-3  # [m] at 1 m
LEAST_NOISE = 0.3e-3  # [m] at 1 m: below it, steps of stored depths and edges matter more than noise


@dataclass(frozen=True, eq=False)
class Support:
    """A plane n . x = offset in the camera frame, as measured."""

    normal: np.ndarray
    """(3,) unit, away from the table: towards the camera."""
    offset: float
    """[m] negative: the camera is above the plane."""
    noise: float
    """[1/m] standard deviation of inverse depths, equal at all distances for a stereo camera."""
    bend: float
    """[1/m] standard deviation of what varies slowly in the image: the same error for all pixels of a part."""

    @property
    def bend_share(self) -> float:
        """The share of the bend in the variance of the depths."""
        return min((self.bend / self.noise) ** 2, 1.0)

    def noise_at(self, depth: np.ndarray | float) -> np.ndarray | float:
        """[m] standard deviation of depths (...,) [m]."""
        return self.noise * np.square(depth)


def recorded_support(image: LabelledDepth) -> Support:
    """The plane z = 0 of an image whose camera was calibrated, with the noise and bend that the image shows.

    Borders of the table determine it better than its depths, which bend. Raises InputError as `seen_support`.
    """
    pose = image.view.world_from_camera
    normal = pose.inverse().rotate(np.array([0.0, 0.0, 1.0]))
    return replace(seen_support(image), normal=normal, offset=-float(pose.xyz[2]))


def seen_support(image: LabelledDepth) -> Support:
    """The plane of the table's pixels near z = 0 of the recorded world; raises InputError where too few show it."""
    view, bodies = image.view, image.labels > 0
    table = np.logical_not(binary_dilation(bodies, iterations=MARGIN)) & (view.depth > 0)
    v, u = np.nonzero(table[::STEP, ::STEP])
    pixels, z = np.stack([u, v], axis=-1) * STEP, view.depth[::STEP, ::STEP][v, u].astype(float)
    rays = view.camera.unproject_pixels(pixels.astype(float), np.ones(len(z)))
    near = np.abs(view.world_from_camera.apply(rays * z[:, None])[:, 2]) < REACH
    pixels, rays, inverse = pixels[near], rays[near], 1 / z[near]
    if len(rays) < LEAST_PIXELS:
        raise InputError(
            f"the image shows {len(rays) * STEP**2} pixels of the table within {REACH * 1e3:g} mm of z = 0, expected "
            f"{LEAST_PIXELS * STEP**2} or more: is the table in view, and is the camera's pose right?"
        )
    coefficients, _, noise = robust_plane(rays, inverse, ROUNDS)
    residuals = inverse - rays @ coefficients
    table = np.abs(residuals) < TUKEY * noise
    bend = _bend(pixels[table], residuals[table])
    size = float(np.linalg.norm(coefficients))
    return Support(-coefficients / size, -1 / size, max(noise, LEAST_NOISE), max(bend, LEAST_BEND))


def _bend(pixels: np.ndarray, residuals: np.ndarray) -> float:
    """The root mean square of the residuals (n,) [1/m] at pixels (n, 2), averaged over cells; 0 without a full cell."""
    _, cells = np.unique(pixels // CELL, axis=0, return_inverse=True)
    counts = np.bincount(cells.ravel())
    means = np.bincount(cells.ravel(), residuals) / counts
    full = counts >= LEAST_CELL
    return float(np.sqrt(np.mean(np.square(means[full])))) if full.any() else 0.0


def standing_frame(support: Support, above: np.ndarray) -> Pose:
    """camera_from_table: z away from the table, the origin on it below a point (3,) [m] of the camera frame."""
    z = support.normal
    x = unit_vector(np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (1.0, 0.0, 0.0), z))
    origin = above + z * (support.offset - float(above @ z))
    return Pose.from_rotation_matrix(np.stack([x, np.cross(z, x), z], axis=-1), origin)
