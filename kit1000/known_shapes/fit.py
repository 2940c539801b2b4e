"""Refinement of a standing shape in the disparity image: Gauss-Newton on its place, its yaw and the depth scale.

The residual of a pixel is its measured less its expected disparity, in its own standard deviation and under Tukey's
weights. A slow error of the disparities (offset and two slopes about the shape) is estimated beside it and forgotten.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kit1000.known_shapes.disparity import CORRELATED, SHARP, DisparityImage, Window, slow_errors
from kit1000.known_shapes.shapes import StandingShape
from kit1000.perception.calibration.table import tukey_weights

STEP = 0.6e-3  # [m] by which a shape is moved for slopes: most of a pixel, so that edges of a render change
LIMITS = np.array([4e-3, 4e-3, 0.12])  # [m], [m], [rad] of one step
STRIDES = (1, 3, 9)  # multiples of a fine step that are tried: a step falls short, for edges that are off are outliers
LEAST_STEP = np.array([3e-5, 3e-5, 3e-4])  # below which a shape has arrived
COARSE, FINE = (15.0, 10.0, 8.0), (6.0, 5.0, 5.0)  # standard deviations of Tukey's weights, by round
FAR = 9  # [px] such a window while a shape may be some millimetres away
FIXED = 1e12  # certainty of a log scale that is not estimated
RIDGE = 1e-6


class Fit(NamedTuple):
    """A refined shape."""

    shape: StandingShape
    log_scale: float
    """Of the depth scale that fits it best, without any prior; 0 if it was not estimated."""
    covariance: np.ndarray
    """(4, 4) of place, yaw and log scale."""


def fit(
    image: DisparityImage,
    shape: StandingShape,
    others: Sequence[StandingShape] = (),
    scale: float = 1.0,
    reaches: Sequence[float] = FINE,
    used: np.ndarray | None = None,
    free_scale: bool = False,
) -> Fit:
    """A shape moved to where it explains the image best, from a place within some millimetres.

    Args:
        image: the disparities.
        shape: to move.
        others: shapes beside it, which stay.
        scale: measured over true depth.
        reaches: of each round, see FINE.
        used: (H, W) bool, the pixels that are compared; all if None.
        free_scale: whether the scale is estimated too.
    """
    log_scale, covariance = float(np.log(scale)), np.eye(4)
    for reach in reaches:
        window = image.window(shape, others, np.exp(log_scale))
        normal, gradient = _equations(window, shape, others, reach, used, free_scale)
        step = np.linalg.solve(normal, gradient)
        covariance = np.linalg.inv(normal)[:4, :4]
        move = step[:3] * min(1.0, float((LIMITS / np.maximum(np.abs(step[:3]), 1e-12)).min()))
        if free_scale:
            log_scale += float(np.clip(step[3], -3e-3, 3e-3))
        strides = (1,) if free_scale or reach > FINE[0] else STRIDES
        shape = _best_stride(window, shape, [stride * move for stride in strides], used)
        if (np.abs(move) < LEAST_STEP).all():
            break
    return Fit(shape, log_scale if free_scale else 0.0, covariance)


def place_covariance(window: Window, shape: StandingShape) -> np.ndarray:
    """(3, 3) of the place and yaw of a shape that explains a window best, by noise and edges of the sensor."""
    normal, _ = _equations(window, shape, (), FINE[-1], None, False)
    return np.linalg.inv(normal)[:3, :3]


def _best_stride(
    window: Window, shape: StandingShape, moves: Sequence[np.ndarray], used: np.ndarray | None
) -> StandingShape:
    """A shape after that of some moves after which it explains the most."""
    moved = [shape.at(shape.place + move) for move in moves]
    return moved[0] if len(moved) == 1 else max(moved, key=lambda each: window.explained(each, used).gain)


def _equations(
    window: Window,
    shape: StandingShape,
    others: Sequence[StandingShape],
    reach: float,
    used: np.ndarray | None,
    free_scale: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """The normal matrix (7, 7) and gradient (7,): place, yaw, log scale, then offset and slopes of the slow error."""
    image, blur = window.image, SHARP if reach <= FINE[0] else FAR

    def expected(moved: StandingShape, by: Window = window) -> np.ndarray:
        return image.expected(by.exact(moved)[0], blur)[0]

    exact, inside = window.exact(shape)
    mean, variance = image.expected(exact, blur)
    steps = STEP * np.array([1.0, 1.0, 1.5 / shape.radius])
    moves, far = np.diag(steps), reach > FINE[0]  # one-sided slopes take half the time and lead as far
    less = [mean if far else expected(shape.at(shape.place - move)) for move in moves]
    more = [expected(shape.at(shape.place + move)) for move in moves]
    slopes = [(a - b) / (step if far else 2 * step) for a, b, step in zip(more, less, steps, strict=True)]
    by, wider = STEP / shape.radius, None
    if free_scale:
        farther, nearer = (image.window(shape, others, window.scale * (1 + sign * by)) for sign in (1, -1))
        wider = (expected(shape, farther) - expected(shape, nearer)) / (2 * by)
    kept = window.compared(inside, used)
    slow = slow_errors(kept)
    scaled = np.zeros(slow.shape[1]) if wider is None else wider[kept]
    unknown = np.stack([*(slope[kept] for slope in slopes), scaled, *slow])
    total = variance[kept] + image.noise**2
    residual = window.measured[kept] - mean[kept]
    weight = tukey_weights(residual, reach * np.sqrt(total)) / (total * CORRELATED)
    prior = np.array([0.0, 0.0, 0.0, 0.0 if free_scale else FIXED, *np.full(3, image.bend**-2)])
    normal = (unknown * weight) @ unknown.T + np.diag(prior)
    normal += RIDGE * np.diag(np.diag(normal)) + 1e-9 * np.eye(len(normal))
    return normal, (unknown * weight) @ residual
