"""Several images of one scene: the fits of a part on which they agree, each the mean of the fits of the images.

The noise of an image and the error of its camera that calibration leaves are independent of other images, so the error
of the mean of n images is about 1 / sqrt(n) of that of one image. Wrong fits rarely agree between views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kit1000.dataset.own_scenes import scenes_from_elsewhere
from kit1000.dataset.reader import Dataset
from kit1000.numerics.linear_algebra import length
from kit1000.pose import Pose
from kit1000.registration.rank import Fit, moved, ranked, same_pose
from kit1000.values import Query

MOST_FITS = 6  # best fits of each image
ARM = 20e-3  # [m] lever of a rotation in the difference of two motions: half of a typical part
NEAR = 8e-3  # [m] largest difference between fits of the same pose
DIFFERENCE = 0.5  # weight of the difference from an image's fit beside the cost of that fit
ALONE = 8e-3  # [m] cost of an image that has no fit near
APART = 0.6  # uncertainty per metre by which the fits differ from their mean
CERTAIN = -2.3e-3  # [m] a fit has the weight 1 / (uncertainty - CERTAIN) in the mean
LEAST_UNCERTAINTY = 1e-3  # [m] least value of that difference
COMPANY = 3e-3  # [m] of uncertainty that goes if e times as many images have a fit near
SAME_PART = 25e-3  # [m] level distance between what two images show of the same part: half of a typical part, and more


def agreed(images: Sequence[Sequence[Fit]], middle: np.ndarray) -> list[Fit]:
    """The fits of a part by all images, the best first.

    Args:
        images: the fits of each image, in one world, the best first; an image without a fit is left out.
        middle: (3,) [m] world, of the part as it lies now.

    Returns:
        A fit for every pose: the mean of the fits that images have near it, with the mean of their costs.
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
    """The weighted mean of motions near each other, of their quaternions and of the goals of a middle (3,) [m]."""
    shares = np.array(weights)[:, None] / sum(weights)
    first = motions[0].wxyz
    turned = [motion.wxyz if (motion.wxyz * first).sum() >= 0 else -motion.wxyz for motion in motions]
    rotation = Pose((shares * turned).sum(0), np.zeros(3))
    place = (shares * [motion.apply(middle) for motion in motions]).sum(0)
    return Pose(rotation.wxyz, place - rotation.apply(middle))


def difference(a: Pose, b: Pose, middle: np.ndarray) -> float:
    """[m] difference of two motions of a part: of its middle (3,) [m], and ARM away from it."""
    place = length(a.apply(middle) - b.apply(middle))
    chord = min(length(a.wxyz - b.wxyz), length(a.wxyz + b.wxyz))  # half the angle, if it is small
    return float(np.sqrt(place**2 + (2 * ARM * chord) ** 2))


def _in_order(fits: Sequence[Fit]) -> list[Fit]:
    """Fits whose costs never decrease: their order may be better than that by costs."""
    return [replace(fit, cost=max(other.cost for other in fits[: k + 1])) for k, fit in enumerate(fits)]


def _mean_fit(fit: Fit, images: Sequence[Sequence[Fit]], middle: np.ndarray) -> Fit:
    """The mean of a fit and of the fits that other images have near it."""
    near = [each for each in (_nearest(fit, fits, middle) for fits in images) if each is not None]
    weights = [1 / max(each.uncertainty - CERTAIN, LEAST_UNCERTAINTY) for each in near]
    motion = mean_motion([each.goal_from_now for each in near], weights, middle)
    cost = sum(_cost(fit, each, middle) for each in near) + ALONE * (len(images) - len(near))
    uncertainties = [each.uncertainty + APART * difference(motion, each.goal_from_now, middle) for each in near]
    uncertainty = float(np.mean(uncertainties)) - COMPANY * float(np.log(len(near)))
    return replace(moved(fit, motion), cost=cost / len(images), uncertainty=uncertainty)


def _nearest(fit: Fit, fits: Sequence[Fit], middle: np.ndarray) -> Fit | None:
    """The fit of an image with the least cost among those near another fit; None if none is near."""
    near = [each for each in fits if difference(fit.goal_from_now, each.goal_from_now, middle) < NEAR]
    return min(near, key=lambda each: _cost(fit, each, middle), default=None)


def _cost(fit: Fit, other: Fit, middle: np.ndarray) -> float:
    """[m] the cost of a fit beside another one: its own, and the difference of the two."""
    return other.cost + DIFFERENCE * difference(fit.goal_from_now, other.goal_from_now, middle)


def from_elsewhere(dataset: Dataset, query: Query) -> list[Query]:
    """The queries about the same part in the other images of its scene that dataset.json states.

    Most datasets state none. An image that shows no part at that place has no such query.
    """
    found = []
    for scene_id in scenes_from_elsewhere(dataset.summary, query.scene_id):
        scene = dataset.recorded_scene(scene_id, truth=False)
        others = [other for other in scene.queries if other.track == query.track]
        nearest = min(others, key=lambda other: _apart(query, other), default=None)
        if nearest is not None and _apart(query, nearest) < SAME_PART:
            found.append(replace(nearest, guess=query.guess))
    return found


def _apart(query: Query, other: Query) -> float:
    """[m] level distance between the pivots of two queries."""
    return float(length((query.pivot - other.pivot)[:2]))
