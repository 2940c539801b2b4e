"""Ranking: the odds that a fit is right order the fits and give the confidence; several images of one scene agree.

One model ranks the fits of a kind of image. The score of a fit is the log of the odds that it is right against that
none is: a weighted sum of its features, with other weights once it is refined in the image. So the probability of fit i
is exp(s_i) / (1 + sum of exp(s_j) over the fits in different places). `bench/quality/ranking.py` fits the weights to
fits of split train of which the outcome is known.

If several images show one scene, each fit is the geometric median of the fits of the images near it. Noise, outlines
and what calibration leaves of the error of a camera are independent of other images, so the median is nearer the truth
than one image, and an image that sees the part or its cavity badly does not move it far. By four imported d415 images
it seats 51 % of 195, the mean 46 % (train and val). Wrong fits rarely agree between views.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kit1000.dataset.own_scenes import scenes_from_elsewhere
from kit1000.dataset.reader import Dataset
from kit1000.files import read_json
from kit1000.numerics.linear_algebra import length
from kit1000.pose import Pose
from kit1000.registration.part_volume import PartShape
from kit1000.registration.search import Candidate
from kit1000.values import Query

WEIGHTS = Path(__file__).with_suffix(".json")
"""The bias and the weight of each feature, by kind of image; see `weights_of`."""
SCORE_DECIMALS = 9  # fits whose scores differ by less are equal
SAME_PLACE = 0.6e-3  # [m] mean distance between two places of a part's surface, below which they are the same
CONFIDENCE_DECIMALS = 9  # the last digits of an exponential depend on the processor
MOST_FITS = 6  # best fits of each image
ARM = 20e-3  # [m] lever of a rotation in the difference of two motions: half of a typical part
NEAR = 12e-3  # [m] largest difference between fits of the same pose
MEDIAN_ROUNDS, LEAST_APART = 8, 1e-3  # of Weiszfeld's iteration; [m] below which a motion pulls no stronger
DISAGREEMENT = 0.6e3  # [1/m] of score, by which the fits differ from their median
CERTAIN = 4.0  # a fit has the weight 1 / (CERTAIN - score) in the median
LEAST_UNCERTAINTY = 1.0  # least value of that difference
COMPANY = 4.0  # of score that comes if e times as many images have a fit near
SAME_PART = 25e-3  # [m] level distance between what two images show of the same part: half of a typical part, and more


class Features(NamedTuple):
    """What speaks against a fit."""

    outside: float
    """[mm] RMS of the distances from the intervals, see `refine.Intervals`."""
    filled: float
    """[mm] RMS of the residuals of the filled part."""
    contradicted: float
    """[mm] contradiction by the image, see `contradictions.contradictions`."""
    camera: float
    """[mm] standard deviation of the motion by the error left in the camera's pose, beyond that of a usual one."""
    misfit: float | None = None
    """How much less of a noisy image the fit explains than the best one, see `image_refine.ImageFit.cost`; None: the
    fit was not refined in the image."""
    spread: float | None = None
    """Natural logarithm of the standard deviation of the place in such an image, over that of a usual one."""


@lru_cache
def weights_of(kind: str) -> dict[str, dict[str, float]]:
    """The weights in images of a kind, by name: of fits in the `volume`, and of those refined in the `image`."""
    return read_json(WEIGHTS)[kind]


def score_of(features: Features, kind: str) -> float:
    """The log odds that a fit in an image of a kind is right, against that none is."""
    of_kind = weights_of(kind)
    weights = of_kind["image" if features.misfit is not None and "image" in of_kind else "volume"]
    terms = (weights[name] * value for name, value in features._asdict().items() if name in weights)
    return weights["bias"] + sum(terms)


@dataclass(frozen=True, eq=False)
class Fit:
    """A refined candidate."""

    goal_from_now: Pose
    score: float
    """The log odds that it is right, against that no fit is."""
    candidate: Candidate
    """The candidate in the refined pose."""
    shape: PartShape
    features: Features
    """From which the score is computed."""


def moved(fit: Fit, goal_from_now: Pose) -> Fit:
    """A fit with another motion; its score stays."""
    plate_from_now = fit.candidate.cavity.world_from_plate.inverse() @ goal_from_now
    return replace(fit, goal_from_now=goal_from_now, candidate=replace(fit.candidate, plate_from_now=plate_from_now))


def ranked(fits: Iterable[Fit]) -> list[Fit]:
    """The fits, the best first; of equal ones the first stays the first."""
    return sorted(fits, key=lambda fit: -round(fit.score, SCORE_DECIMALS))


def best_score(fits: Iterable[Fit]) -> float:
    """The score of the best fit, on the grid on which fits are ranked; -inf without fits."""
    return max((round(fit.score, SCORE_DECIMALS) for fit in fits), default=-np.inf)


def same_place(one: Fit, other: Fit) -> bool:
    """Whether two fits put the part into the same place, be it rotated by a symmetry."""
    return one.shape.gap(one.goal_from_now, other.goal_from_now) < SAME_PLACE


def confidence(fit: Fit, fits: Sequence[Fit]) -> float:
    """The probability that a fit is right, against those of all fits in other places and against that none is."""
    distinct = [fit]
    for other in ranked(fits):
        if not any(same_place(known, other) for known in distinct):
            distinct.append(other)
    scores = np.array([0.0, *(each.score for each in distinct)])
    odds = np.exp(scores - scores.max())
    return round(float(odds[1] / odds.sum()), CONFIDENCE_DECIMALS)


def agreed(images: Sequence[Sequence[Fit]], middle: np.ndarray) -> list[Fit]:
    """The fits of a part by all images, the best first.

    Args:
        images: the fits of each image, in one world, the best first; an image without a fit is left out.
        middle: (3,) [m] world, of the part as it lies now.

    Returns:
        A fit for every pose: the geometric median of the fits that images have near it.
    """
    seen = [fits for fits in images if fits]
    if len(seen) < 2:
        return [fit for fits in seen for fit in fits]
    best = [fits[:MOST_FITS] for fits in seen]
    found: list[Fit] = []
    for fit in ranked(_median_fit(fit, best, middle) for fits in best for fit in fits):
        if not any(same_place(fit, other) for other in found):
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


def median_motion(motions: Sequence[Pose], weights: Sequence[float], middle: np.ndarray) -> Pose:
    """The weighted geometric median by `difference` (Weiszfeld 1937): one motion that is far off moves it little."""
    found = mean_motion(motions, weights, middle)
    for _ in range(MEDIAN_ROUNDS):
        apart = [max(difference(found, motion, middle), LEAST_APART) for motion in motions]
        found = mean_motion(motions, [w / far for w, far in zip(weights, apart, strict=True)], middle)
    return found


def difference(a: Pose, b: Pose, middle: np.ndarray) -> float:
    """[m] difference of two motions of a part: of its middle (3,) [m], and ARM away from it."""
    place = length(a.apply(middle) - b.apply(middle))
    chord = min(length(a.wxyz - b.wxyz), length(a.wxyz + b.wxyz))  # half the angle, if it is small
    return float(np.sqrt(place**2 + (2 * ARM * chord) ** 2))


def _median_fit(fit: Fit, images: Sequence[Sequence[Fit]], middle: np.ndarray) -> Fit:
    """The geometric median of a fit and of the fits that other images have near it."""
    near = [each for each in (_nearest(fit, fits, middle) for fits in images) if each is not None]
    weights = [1 / max(CERTAIN - each.score, LEAST_UNCERTAINTY) for each in near]
    motion = median_motion([each.goal_from_now for each in near], weights, middle)
    score = float(np.mean([_score_beside(motion, each, middle) for each in near])) + COMPANY * float(np.log(len(near)))
    return replace(moved(fit, motion), score=score)


def _nearest(fit: Fit, fits: Sequence[Fit], middle: np.ndarray) -> Fit | None:
    """The fit of an image with the best score among those near another fit; None if none is near."""
    near = [each for each in fits if difference(fit.goal_from_now, each.goal_from_now, middle) < NEAR]
    return max(near, key=lambda each: _score_beside(fit.goal_from_now, each, middle), default=None)


def _score_beside(motion: Pose, fit: Fit, middle: np.ndarray) -> float:
    """The score of a fit for a motion near it: its own, less by the difference of the two."""
    return fit.score - DISAGREEMENT * difference(motion, fit.goal_from_now, middle)


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
