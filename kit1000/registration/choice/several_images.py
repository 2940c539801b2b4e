"""Fits of one part in several images of a scene: those on which the images agree, each the mean of their fits.

Noise of an image, and what calibration leaves of its camera's error, are its own: the mean of n images errs by about
1 / sqrt(n) of what one does. And a fit in a wrong pose seldom has company in an image from elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kit1000.numerics.linear_algebra import length
from kit1000.pose import Pose
from kit1000.registration.choice.fits import Fit, moved, ranked, same_pose

MOST_FITS = 6  # of each image, the best
ARM = 20e-3  # [m] from a part's middle at which a rotation moves it: half of a typical part
NEAR = 8e-3  # [m] by which fits of one pose differ at most
DIFFERENCE = 0.5  # share of the difference from an image's fit that counts like its misfit
ALONE = 8e-3  # [m] in place of the misfit of an image that has no fit near
APART = 0.6  # share in the doubt, of the mean difference of the fits from their mean
DOUBTLESS, LEAST_DOUBT = -2.3e-3, 1e-3  # [m] a fit weighs 1 / (doubt - DOUBTLESS), or at most 1 / LEAST_DOUBT
COMPANY = 3e-3  # [m] off the doubt where e times as many images have a fit near


def agreed(images: Sequence[Sequence[Fit]], middle: np.ndarray) -> list[Fit]:
    """The fits of a part by all images, the best first.

    Args:
        images: the fits of each image, in one world, the best first; an image without a fit says nothing.
        middle: (3,) [m] world, of the part as it lies now.

    Returns:
        A fit for every pose, the mean of the fits that images have near it; its misfit is the mean over the images.
    """
    seen = [fits for fits in images if fits]
    if len(seen) < 2:
        return [fit for fits in seen for fit in fits]
    ordered = [_in_order(fits[:MOST_FITS]) for fits in seen]
    found: list[Fit] = []
    for fit in ranked(_mean_fit(fit, ordered, middle) for fits in ordered for fit in fits):
        if not any(same_pose(fit.goal_from_now, other.goal_from_now, middle) for other in found):
            found.append(fit)
    return found


def mean_motion(motions: Sequence[Pose], weights: Sequence[float], middle: np.ndarray) -> Pose:
    """The weighted mean of motions near each other: of their quaternions, and of where a middle (3,) [m] goes."""
    shares = np.array(weights)[:, None] / sum(weights)
    first = motions[0].wxyz
    turned = [motion.wxyz if (motion.wxyz * first).sum() >= 0 else -motion.wxyz for motion in motions]
    rotation = Pose((shares * turned).sum(0), np.zeros(3))
    place = (shares * [motion.apply(middle) for motion in motions]).sum(0)
    return Pose(rotation.wxyz, place - rotation.apply(middle))


def difference(a: Pose, b: Pose, middle: np.ndarray) -> float:
    """[m] by which two motions of a part differ: of its middle (3,) [m], and ARM away from it."""
    place = length(a.apply(middle) - b.apply(middle))
    chord = min(length(a.wxyz - b.wxyz), length(a.wxyz + b.wxyz))  # of quaternions: half the angle, if it is small
    return float(np.sqrt(place**2 + (2 * ARM * chord) ** 2))


def _in_order(fits: Sequence[Fit]) -> list[Fit]:
    """Fits, none with less misfit than one before it: their order may tell more than their misfits."""
    return [replace(fit, misfit=max(other.misfit for other in fits[: k + 1])) for k, fit in enumerate(fits)]


def _mean_fit(fit: Fit, images: Sequence[Sequence[Fit]], middle: np.ndarray) -> Fit:
    """The mean of a fit and of those that other images have near it."""
    near = [each for each in (_nearest(fit, fits, middle) for fits in images) if each is not None]
    weights = [1 / max(each.doubt - DOUBTLESS, LEAST_DOUBT) for each in near]
    motion = mean_motion([each.goal_from_now for each in near], weights, middle)
    misfit = sum(_cost(fit, each, middle) for each in near) + ALONE * (len(images) - len(near))
    doubts = [each.doubt + APART * difference(motion, each.goal_from_now, middle) for each in near]
    doubt = float(np.mean(doubts)) - COMPANY * float(np.log(len(near)))
    return replace(moved(fit, motion), misfit=misfit / len(images), doubt=doubt)


def _nearest(fit: Fit, fits: Sequence[Fit], middle: np.ndarray) -> Fit | None:
    """The fit of least cost among those of an image that are near another one; None where none is."""
    near = [each for each in fits if difference(fit.goal_from_now, each.goal_from_now, middle) < NEAR]
    return min(near, key=lambda each: _cost(fit, each, middle), default=None)


def _cost(fit: Fit, other: Fit, middle: np.ndarray) -> float:
    """[m] the misfit of a fit beside another one, and what they differ."""
    return other.misfit + DIFFERENCE * difference(fit.goal_from_now, other.goal_from_now, middle)
