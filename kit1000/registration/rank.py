"""Ranking: fits and their order, the plate that a part belongs to, and the confidence in a fit.

Without a guess a part may fit another plate nearly as well as its own. Each kit is for one part, and the image shows
all parts, so a plate that another part fits far better is not this part's. `plate_posterior` sums over all assignments
of parts to plates. It is unknown whether the other parts lie as they are inserted; if not, their costs mean nothing.

If several images show one scene, each fit is the mean of the fits of the images near it. The noise of an image and the
error of its camera that calibration leaves are independent of other images, so the error of the mean of n images is
about 1 / sqrt(n) of that of one image. Wrong fits rarely agree between views.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from kit1000.dataset.own_scenes import scenes_from_elsewhere
from kit1000.dataset.reader import Dataset
from kit1000.numerics.linear_algebra import length
from kit1000.perception.image_kinds import Curve
from kit1000.pose import Pose
from kit1000.registration.geometry.cavity import VOXEL, Cavity
from kit1000.registration.search import Candidate
from kit1000.sim.layout import UPRIGHT_SHARE
from kit1000.values import Query

COST_DECIMALS = 9  # of a metre: fits that differ by less are equal
SAME_DISTANCE, SAME_ANGLE = 1e-3, np.radians(3)  # [m], [rad] within which two poses are the same
LARGEST_MARGIN = 5e-3  # [m] of a fit over those in other poses
CONFIDENCE_DECIMALS = 9  # the last digits of an exponential depend on the processor
DOUBTFUL = 1e-3  # [m] of cost: if the best fit in another plate costs at most so much more, other parts are searched
MOST_PLATES = 12  # that are distinguished: the sums run over all sets of plates
PLATES_APART = 0.03  # [m] between the middles of cavities in different plates
NO_FIT = -2.0  # log odds of a plate in which no fit was refined: the image contradicts all of them
MOST_FITS = 6  # best fits of each image
ARM = 20e-3  # [m] lever of a rotation in the difference of two motions: half of a typical part
NEAR = 8e-3  # [m] largest difference between fits of the same pose
DIFFERENCE = 0.5  # weight of the difference from an image's fit beside the cost of that fit
ALONE = 8e-3  # [m] cost of an image that has no fit near
DISAGREEMENT = 0.6  # uncertainty per metre by which the fits differ from their mean
CERTAIN = -2.3e-3  # [m] a fit has the weight 1 / (uncertainty - CERTAIN) in the mean
LEAST_UNCERTAINTY = 1e-3  # [m] least value of that difference
COMPANY = 3e-3  # [m] of uncertainty that goes if e times as many images have a fit near
SAME_PART = 25e-3  # [m] level distance between what two images show of the same part: half of a typical part, and more


@dataclass(frozen=True, eq=False)
class Fit:
    """A refined candidate."""

    goal_from_now: Pose
    cost: float
    """[m] cost that ranks the fits; the lowest is the best."""
    uncertainty: float
    """[m] sum of the same terms with other weights; the lower, the likelier the fit is seated."""
    candidate: Candidate
    """The candidate in the refined pose."""


def moved(fit: Fit, goal_from_now: Pose) -> Fit:
    """A fit with another motion; its cost and uncertainty stay."""
    plate_from_now = fit.candidate.cavity.world_from_plate.inverse() @ goal_from_now
    return replace(fit, goal_from_now=goal_from_now, candidate=replace(fit.candidate, plate_from_now=plate_from_now))


def ranked(fits: Iterable[Fit]) -> list[Fit]:
    """The fits, the best first; of equal ones the first stays the first."""
    return sorted(fits, key=lambda fit: round(fit.cost, COST_DECIMALS))


def least_cost(fits: Iterable[Fit]) -> float:
    """[m] the cost of the best fit, on the grid on which fits are ranked; infinite without fits."""
    return min((round(fit.cost, COST_DECIMALS) for fit in fits), default=np.inf)


def same_pose(a: Pose, b: Pose, point: np.ndarray) -> bool:
    """Whether two motions move a point (3,) [m] to the same place and differ little in rotation."""
    near = length(a.apply(point) - b.apply(point)) < SAME_DISTANCE
    return bool(near and (a @ b.inverse()).angle() < SAME_ANGLE)


def margin(fit: Fit, fits: Sequence[Fit], point: np.ndarray) -> float:
    """[m] least cost of the fits in other poses less the cost of this fit, at most LARGEST_MARGIN.

    point: (3,) [m] of the part now.
    """
    others = [other.cost for other in fits if not same_pose(other.goal_from_now, fit.goal_from_now, point)]
    return min(min(others, default=np.inf) - fit.cost, LARGEST_MARGIN)


def confidence(fit: Fit, fits: Sequence[Fit], point: np.ndarray, curve: Curve) -> float:
    """The share of fits with such an uncertainty and margin that are seated.

    Args:
        fit: one of the fits.
        fits: all fits.
        point: (3,) [m] of the part now.
        curve: of the kind of image.
    """
    uncertainty = fit.uncertainty - curve.margin_share * margin(fit, fits, point)
    return round(float(1 / (1 + np.exp((uncertainty - curve.half) / curve.spread))), CONFIDENCE_DECIMALS)


def assigned(fits: Sequence[Fit], others: Iterable[Sequence[Fit]], curve: Curve) -> list[Fit]:
    """The fits of a part, the best first; those in the plate that the part most likely belongs to precede all others.

    Args:
        fits: of the part, the best first.
        others: the fits of each other part of the scene; read only if two plates fit about equally well.
        curve: probability that a part belongs to a plate, see `ImageKind.right_plate`.
    """
    nearest = np.sort(least_costs(fits, _middles(fits)))[:2]
    if len(nearest) < 2 or nearest[1] - nearest[0] > DOUBTFUL:
        return list(fits)
    parts = [fits, *others]
    middles = _middles([fit for part in parts for fit in part])[:MOST_PLATES]
    costs = np.stack([least_costs(part, middles) for part in parts])
    posterior = plate_posterior(np.where(np.isfinite(costs), (curve.half - costs) / curve.spread, NO_FIT))
    best = int(np.argmax(np.where(np.isfinite(costs[0]), posterior, -1.0)))
    there = [_plate(fit.candidate.cavity, middles) == best for fit in fits]
    return [*compress(fits, there), *compress(fits, np.logical_not(there))]


def plate_posterior(odds: np.ndarray) -> np.ndarray:
    """(plates,) the probability that the first part belongs to each plate; the rest is for plates that were not found.

    odds: (parts, plates) log odds by the costs of each part alone. The odds of the other parts count as far as these
    parts are likely to lie as they are inserted.
    """
    weights = np.exp(odds)
    weights[1:] = UPRIGHT_SHARE * weights[1:] + 1 - UPRIGHT_SHARE
    plates = odds.shape[1]
    taken = np.arange(1 << plates)  # each set of plates as a number: bit p is plate p
    sums = (taken == 0).astype(float)  # over the assignments of the other parts so far that take just these plates
    for part in weights[1:]:
        before = sums.copy()
        for plate, weight in enumerate(part):
            free = taken[(taken >> plate & 1) == 0]
            sums[free | 1 << plate] += weight * before[free]
    left = np.array([sums[(taken >> plate & 1) == 0].sum() for plate in range(plates)])
    found = weights[0] * left
    return found / (found.sum() + sums.sum())


def least_costs(fits: Sequence[Fit], middles: Sequence[np.ndarray]) -> np.ndarray:
    """(plates,) [m] the least cost of the fits in each plate; infinite in a plate without fits."""
    least = np.full(len(middles), np.inf)
    for fit in fits:
        plate = _plate(fit.candidate.cavity, middles)
        if plate is not None:
            least[plate] = min(least[plate], fit.cost)
    return least


def _middles(fits: Sequence[Fit]) -> list[np.ndarray]:
    """(3,) [m] world, each: the middles of the cavities of the fits, one for each plate."""
    middles: list[np.ndarray] = []
    for fit in fits:
        if _plate(fit.candidate.cavity, middles) is None:
            middles.append(_middle(fit.candidate.cavity))
    return middles


def _plate(cavity: Cavity, middles: Sequence[np.ndarray]) -> int | None:
    """The index of the first plate that has this cavity, as found for any part; None if no plate has it."""
    middle = _middle(cavity)
    return next((plate for plate, other in enumerate(middles) if length(middle - other) < PLATES_APART), None)


def _middle(cavity: Cavity) -> np.ndarray:
    """(3,) [m] world: the middle of a cavity, on the face of its plate."""
    cells = np.argwhere(cavity.region).mean(0) - (len(cavity.region) - 1) / 2
    return cavity.world_from_plate.apply(np.append(cells * VOXEL, 0.0))


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
    uncertainties = [each.uncertainty + DISAGREEMENT * difference(motion, each.goal_from_now, middle) for each in near]
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
