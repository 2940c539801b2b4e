"""The table in a view: the pixels that look at its top, the plane that they show, and the bending of the image on it.

A stereo camera bends planes by millimetres over some hundred pixels. On the table the error is seen; on a body it is
that of the table beside it, as it varies slowly in the image. The field is a sum of smooth bumps on a grid, with a
prior that pulls each to 0 (a Gaussian process): it is what the table's noise supports, and nothing far from the table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation

from kit1000.camera import Camera
from kit1000.numerics.elimination import solve_positive
from kit1000.numerics.linear_algebra import eigenvectors, matmul
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.sim.layout import TABLE_SIZE
from kit1000.values import View

HALF_SIZES = np.array(TABLE_SIZE[:2]) / 2
"""(2,) [m] from the origin to the table's edges, along x and y."""
NEAR = 25e-3  # [m] from the plane, of pixels of a table of unknown size
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
LEAST_SPREAD = 1e-9  # [1/m] added to the spread of inverse depths
BEND_CELL = 40  # [px] edge of the cells over which residuals are averaged
LEAST_SHARE = 0.15  # of a cell's pixels that show the table
BESIDE_BODIES = 13  # [px] edge of the square around each pixel of a body that is left out: edges reach over the table
NEAR_TABLE = 1.5  # [px] from the table's plane, of pixels that show it
SPACING = 64  # [px] between bumps
BUMP_REACH = 190  # [px] at which a bump ends; as wide as a normal one of 60 px
LEAST_CELLS = 30  # of the table; with fewer the image stays as it is
FIELD_DECIMALS = 9  # of a pixel


def tukey_weights(residuals: np.ndarray, limit: float | np.ndarray) -> np.ndarray:
    """(n,) biweights (Beaton and Tukey 1974) of residuals (n,): 1 for none, 0 from a limit on, a number or (n,)."""
    return np.square(np.clip(1 - np.square(residuals / limit), 0, None))


def robust_plane(
    rays: np.ndarray, inverse: np.ndarray, rounds: int, prior: np.ndarray | None = None, weight: float = 0.0
) -> tuple[np.ndarray, np.ndarray, float]:
    """The plane through pixels, in inverse depth, in which the noise of all pixels is equal.

    Args:
        rays: (n, 3) of depth 1.
        inverse: (n,) [1/m] inverse depths.
        rounds: of reweighting.
        prior: (3,) coefficients of a plane that is known before; None: none is.
        weight: of the prior, in pixels.

    Returns:
        (3,) coefficients [1/m], whose product with the ray of a pixel is its inverse depth; (n,) last weights; and the
        spread of the residuals [1/m].
    """
    known = np.zeros(3) if prior is None else prior
    weights, coefficients, spread = np.ones(len(inverse)), known, 0.0
    for _ in range(rounds):
        weighted = (rays * weights[:, None]).T
        normal = matmul(weighted, rays) + weight * np.eye(3)
        coefficients = known + solve_positive(normal, matmul(weighted, inverse - matmul(rays, known)))
        residuals = inverse - matmul(rays, coefficients)
        spread = 1.4826 * np.median(np.abs(residuals)) + LEAST_SPREAD
        weights = tukey_weights(residuals, TUKEY * spread)
    return coefficients, weights, float(spread)


def rays(camera: Camera, uv: np.ndarray) -> np.ndarray:
    """(n, 3) directions of pixels (n, 2), of depth 1."""
    return camera.unproject_pixels(uv, np.ones(len(uv)))


def ground(pose: Pose, directions: np.ndarray) -> np.ndarray:
    """(n, 3) [m] world: where rays (n, 3) of the camera meet the plane z = 0; NaN where they do not."""
    directions = pose.rotate(directions)
    down = np.where(directions[:, 2] < 0, -directions[:, 2], np.nan)
    return pose.xyz + directions * (pose.xyz[2] / down)[:, None]


def flattened(view: View, labels: np.ndarray, simulated: bool = True) -> View:
    """The view with the depths of the table's plane at all pixels of the table, with a return or without.

    simulated: whether the table is that of generated scenes; of another one, only pixels near its plane are its own.
    """
    depth, on = _table_top(view) if simulated else _near_plane(view)
    return replace(view, depth=np.where((labels == 0) & on, depth.astype(view.depth.dtype), view.depth))


def _near_plane(view: View) -> tuple[np.ndarray, np.ndarray]:
    """As of `_table_top`, for a table of unknown size: pixels without a return, or with one near the plane."""
    depth = _plane_depth(view)[0]
    along = np.abs(view.depth - depth) * view.world_from_camera.xyz[2] / np.maximum(depth, 1e-3)  # [m] of height
    return depth, (depth > 0) & ((view.depth == 0) | (along < NEAR))


def _table_top(view: View) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) [m] depths of the plane z = 0, 0 where it is not in front; (H, W) bool: pixels that look at the table."""
    depth, (x, y, z) = _plane_depth(view)
    axes = zip(view.world_from_camera.xyz, (x, y), HALF_SIZES, strict=False)
    within = [np.abs(start + direction * depth) <= half for start, direction, half in axes]
    return depth, (z < 0) & within[0] & within[1]


def _plane_depth(view: View) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """(H, W) [m] depths of the plane z = 0, 0 where it is not in front; three (H, W): rays of depth 1 in the world."""
    camera, pose = view.camera, view.world_from_camera
    across = (np.arange(camera.width) - camera.cx) / camera.fx
    along = (np.arange(camera.height) - camera.cy) / camera.fy
    x, y, z = (axis[0] * across + (axis[1] * along + axis[2])[:, None] for axis in pose.rotation_matrix())
    return np.divide(pose.xyz[2], -z, out=np.zeros_like(z), where=z < 0), (x, y, z)


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
    """The plane of the table's pixels; None if there are too few. reach: [m] of them from the recorded plane.

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
    coefficients, weights, spread = robust_plane(directions, inverse, PLANE_ROUNDS, recorded, RECORDED_WEIGHT)
    information = matmul((directions * weights[:, None]).T, directions) / correlated
    axes = eigenvectors(information)
    pixels = np.diag(matmul(axes.T, matmul(information, axes)))
    return Plane(coefficients, axes, spread / np.sqrt(np.maximum(pixels, LEAST_INFORMATION)))


class Residuals(NamedTuple):
    """The table's disparities less those of its plane, averaged over n cells."""

    places: np.ndarray
    """(n, 2) [px] row and column of their middles"""
    means: np.ndarray
    """(n,) [px]"""
    noise: float
    """[px^2] variance of a mean by what varies within some cells."""
    bending: float
    """[px^2] variance of what varies slowly."""


def unbent(view: View, labels: np.ndarray, baseline: float) -> View:
    """A calibrated view without the bending that its table shows.

    Args:
        view: its table is the plane z = 0.
        labels: (H, W) uint8 masks; 0 for the table or nothing.
        baseline: [m] of the stereo camera.
    """
    gain = view.camera.fx * baseline
    seen = table_residuals(view, labels, gain)
    if seen is None or seen.bending <= 0:
        return view
    field = bending_field(seen, view.depth.shape)
    disparity = gain / np.where(view.depth > 0, view.depth, np.inf) - field
    depth = np.where(view.depth > 0, gain / np.maximum(disparity, 1e-3), 0.0)
    return replace(view, depth=depth.astype(view.depth.dtype))


def table_residuals(view: View, labels: np.ndarray, gain: float) -> Residuals | None:
    """The residuals of a calibrated view's table; None if too few cells show it. gain: [px m]."""
    beside = np.asarray(binary_dilation(labels > 0, np.ones((BESIDE_BODIES, 1))))
    beside = np.asarray(binary_dilation(beside, np.ones((1, BESIDE_BODIES))), bool)
    v, u = np.nonzero((view.depth > 0) & ~beside)
    plane = matmul(rays(view.camera, np.stack([u, v], axis=-1)), plane_coefficients(view.world_from_camera))
    residuals = gain * (1 / view.depth[v, u].astype(float) - plane)
    near = np.abs(residuals) < NEAR_TABLE
    down, across = (-(-size // BEND_CELL) for size in view.depth.shape)
    cells = (v[near] // BEND_CELL) * across + u[near] // BEND_CELL
    counts = np.bincount(cells, minlength=down * across).reshape(down, across)
    sums = np.bincount(cells, residuals[near], down * across).reshape(down, across)
    full = counts > LEAST_SHARE * BEND_CELL**2
    if full.sum() < LEAST_CELLS:
        return None
    means = np.where(full, sums / np.maximum(counts, 1), np.nan)
    steps = np.concatenate([np.diff(means, axis=axis).ravel() for axis in (0, 1)])
    noise = float(np.nanmean(steps**2)) / 2
    bending = max(float(np.mean(means[full] ** 2)) - noise, 0.0)
    return Residuals(np.argwhere(full) * BEND_CELL + (BEND_CELL - 1) / 2, means[full], noise, bending)


def bending_field(seen: Residuals, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) [px] the likeliest field of an image of a shape."""
    grids = [np.arange(-SPACING, size + SPACING, SPACING, dtype=float) for size in shape]
    rows, columns = (_bumps(seen.places[:, axis], grid) for axis, grid in enumerate(grids))
    bumps = (rows[:, :, None] * columns[:, None, :]).reshape(len(seen.means), -1)
    prior = seen.noise / seen.bending * float(np.median((bumps**2).sum(1)))
    normal = matmul(bumps.T, bumps) + prior * np.eye(bumps.shape[1])
    heights = solve_positive(normal, matmul(bumps.T, seen.means)).reshape(len(grids[0]), len(grids[1]))
    down, across = (_bumps(np.arange(size, dtype=float), grid) for size, grid in zip(shape, grids, strict=True))
    return matmul(matmul(down, heights), across.T).round(FIELD_DECIMALS)


def _bumps(places: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """(n, m) values at places (n,) of bumps about the points (m,) of a grid [px]: triweights, without exponentials."""
    return np.clip(1 - np.square((places[:, None] - grid) / BUMP_REACH), 0, None) ** 3
