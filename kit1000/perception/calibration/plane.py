"""The plane of the table's pixels in the camera frame, and how well they determine it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from kit1000.numerics.elimination import solve_positive
from kit1000.numerics.linear_algebra import eigenvectors, matmul
from kit1000.perception.calibration.table_top import rays
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.values import View

STEP = 6  # [px] between pixels that enter the plane
CORRELATED = 3.0  # of which so many count as one: noise of two windows of 7 px in succession, one value in 108 px
BENT = 600.0  # of a stereo camera, which bends planes: half of the variance varies over 85 px, one value in 45,000 px
MARGIN = 2  # cells of STEP px about every body: there its fattened edge may cover the table
PLANE_REACH = 25e-3  # [m] from the recorded plane, of the pixels that enter
OWN_REACH, OWN_SPREADS = 2e-3, 4.0  # [m], or so many standard deviations of the noise, of an own image
LEAST_PIXELS = 500  # of the plane; with fewer there is none
PLANE_ROUNDS = 5  # of reweighting
RECORDED_WEIGHT = 0.3  # of the recorded plane, in pixels: noise of a pixel over spread of the plane, squared, at 0.8 m
LEAST_INFORMATION = 1e-9  # [pixels] along an axis
TUKEY = 4.685  # standard deviations at which a weight becomes 0: 95 % efficient for normal residuals


def tukey_weights(residuals: np.ndarray, limit: float | np.ndarray) -> np.ndarray:
    """(n,) biweights (Beaton and Tukey 1974) of residuals (n,): 1 for none, 0 from a limit on, a number or (n,)."""
    return np.square(np.clip(1 - np.square(residuals / limit), 0, None))


@dataclass(frozen=True, eq=False)
class Plane:
    """The table's top in the camera frame, in measured depths."""

    coefficients: np.ndarray
    """(3,) [1/m]: their product with the ray of a pixel, of depth 1, is its inverse depth."""
    axes: np.ndarray
    """(3, 3) unit columns, along which the errors of the coefficients are independent."""
    spreads: np.ndarray
    """(3,) [1/m] standard deviations along them."""


def plane_coefficients(pose: Pose) -> np.ndarray:
    """(3,) [1/m] those of the plane z = 0 for a camera at this pose, see `Plane`."""
    return -pose.inverse().rotate((0.0, 0.0, 1.0)) / pose.xyz[2]


def reach_of(sensor: SensorFacts, view: View) -> float:
    """[m] from the recorded plane of pixels that may show the table.

    The plane of an own image was found in it, so that only its noise is left; beside it may be walls.
    """
    if sensor.simulated_table:
        return PLANE_REACH
    gain = sensor.gain(view.camera)
    return max(OWN_REACH, OWN_SPREADS * sensor.noise_px * float(view.world_from_camera.xyz[2]) ** 2 / gain)


def correlated_in(sensor: SensorFacts) -> float:
    """How many of the pixels that enter the plane count as one, in an image of a sensor."""
    return BENT if sensor.kind.restores else CORRELATED


def table_plane(
    view: View, labels: np.ndarray, reach: float = PLANE_REACH, correlated: float = CORRELATED
) -> Plane | None:
    """The plane of the table's pixels; None where there are too few. reach: [m] of them from the recorded plane.

    Fitted in inverse depth, where noise is the same for all pixels, with Tukey's weights; what a narrow strip of table
    leaves open stays as recorded.
    """
    bodies = labels[::STEP, ::STEP] > 0
    depth = view.depth[::STEP, ::STEP].astype(float)
    v, u = np.nonzero((depth > 0) & np.logical_not(binary_dilation(bodies, np.ones((2 * MARGIN + 1,) * 2))))
    z, directions = depth[v, u], rays(view.camera, np.stack([u, v], axis=-1) * float(STEP))
    if view.world_from_camera.xyz[2] < PLANE_REACH:
        return None
    recorded = plane_coefficients(view.world_from_camera)
    near = np.abs(z * matmul(directions, recorded) - 1) * view.world_from_camera.xyz[2] < reach
    directions, inverse = directions[near], 1 / z[near]
    return _fitted(directions, inverse, recorded, correlated) if len(directions) >= LEAST_PIXELS else None


def _fitted(directions: np.ndarray, inverse: np.ndarray, recorded: np.ndarray, correlated: float) -> Plane:
    """The plane of pixels: (n, 3) rays, (n,) [1/m] inverse depths. recorded: (3,) coefficients, a weak prior."""
    weights, coefficients, spread = np.ones(len(inverse)), recorded, 0.0
    for _ in range(PLANE_ROUNDS):
        weighted = (directions * weights[:, None]).T
        normal = matmul(weighted, directions) + RECORDED_WEIGHT * np.eye(3)
        coefficients = recorded + solve_positive(normal, matmul(weighted, inverse - matmul(directions, recorded)))
        residuals = inverse - matmul(directions, coefficients)
        spread = 1.4826 * np.median(np.abs(residuals)) + 1e-9
        weights = tukey_weights(residuals, TUKEY * spread)
    information = matmul((directions * weights[:, None]).T, directions) / correlated
    axes = eigenvectors(information)
    pixels = np.diag(matmul(axes.T, matmul(information, axes)))
    return Plane(coefficients, axes, spread / np.sqrt(np.maximum(pixels, LEAST_INFORMATION)))
