"""Refinement of a standing shape in the disparity image: Gauss-Newton on its place, its yaw and the depth scale.

The residual of a pixel is its measured less its expected disparity, in its own standard deviation and under Tukey's
weights. A slow error of the disparities (offset and two slopes about the shape) is estimated beside it and forgotten.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kit1000.known_shapes.disparity import SHARP, DisparityImage
from kit1000.known_shapes.shapes import StandingShape
from kit1000.perception.calibration.table import tukey_weights

STEP = 0.6e-3  # [m] by which a shape is moved for slopes: most of a pixel, so that edges of a render change
CORRELATED = 30.0  # pixels whose errors are as one: windows of a stereo matcher
LIMITS = np.array([4e-3, 4e-3, 0.12])  # [m], [m], [rad] of one step
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
        normal, gradient = _equations(image, shape, others, np.exp(log_scale), reach, used, free_scale)
        normal += RIDGE * np.diag(np.diag(normal)) + 1e-9 * np.eye(len(normal))
        step = np.linalg.solve(normal, gradient)
        covariance = np.linalg.inv(normal)[:4, :4]
        move = step[:3] * min(1.0, float((LIMITS / np.maximum(np.abs(step[:3]), 1e-12)).min()))
        shape = shape.at(shape.place + move)
        if free_scale:
            log_scale += float(np.clip(step[3], -3e-3, 3e-3))
        if (np.abs(move) < LEAST_STEP).all():
            break
    return Fit(shape, log_scale if free_scale else 0.0, covariance)


def _equations(
    image: DisparityImage,
    shape: StandingShape,
    others: Sequence[StandingShape],
    scale: float,
    reach: float,
    used: np.ndarray | None,
    free_scale: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """The normal matrix (7, 7) and gradient (7,): place, yaw, log scale, then offset and slopes of the slow error."""
    box, blur = image.box(shape), SHARP if reach <= FINE[0] else FAR

    def expected(moved: StandingShape, by: float) -> np.ndarray:
        return image.expected(image.rendered([moved, *others], box, by)[0], blur)[0]

    exact, inside = image.rendered([shape, *others], box, scale)
    mean, variance = image.expected(exact, blur)
    steps = STEP * np.array([1.0, 1.0, 1.5 / shape.radius])
    slopes = [
        (expected(shape.at(shape.place + move), scale) - expected(shape.at(shape.place - move), scale)) / (2 * step)
        for move, step in zip(np.diag(steps), steps, strict=True)
    ]
    by = STEP / shape.radius
    wider = (expected(shape, scale * (1 + by)) - expected(shape, scale * (1 - by))) / (2 * by) if free_scale else None
    kept = image.compared(box, inside, used)
    v, u = np.nonzero(kept)
    rows, columns = kept.shape
    slow = np.stack([np.ones(len(v)), 2 * u / columns - 1, 2 * v / rows - 1])
    unknown = np.stack([*(slope[kept] for slope in slopes), np.zeros(len(v)) if wider is None else wider[kept], *slow])
    total = variance[kept] + image.noise**2
    residual = image.measured[box.window][kept] - mean[kept]
    weight = tukey_weights(residual, reach * np.sqrt(total)) / (total * CORRELATED)
    prior = np.array([0.0, 0.0, 0.0, 0.0 if free_scale else FIXED, *np.full(3, image.bend**-2)])
    return (unknown * weight) @ unknown.T + np.diag(prior), (unknown * weight) @ residual
