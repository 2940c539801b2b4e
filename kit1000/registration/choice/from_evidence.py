"""Registration by what is certain: contradictions choose among the candidates, intervals refine the chosen ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kit1000.perception.placement.channels import CELLS
from kit1000.pose import Pose
from kit1000.registration.choice.fits import STIFFNESS, Fit, moved, ranked, same_pose
from kit1000.registration.geometry.expected_relief import outline_misfit
from kit1000.registration.inputs.volume_sources import DepthSource
from kit1000.registration.refinement.image_residuals import ImageFit, refine_in_image
from kit1000.registration.refinement.interval_residuals import Intervals, refine_within
from kit1000.registration.refinement.levenberg_marquardt import SCALES
from kit1000.registration.refinement.plate_patch import plate_patch
from kit1000.registration.search.candidates import find_candidates, within_guess_error
from kit1000.registration.search.contradictions import Contradictions, KitHeights, contradictions
from kit1000.registration.search.correlation import UP, Candidate, lies_on, tilted, without_duplicates
from kit1000.registration.search.effort import LARGEST, tries_of
from kit1000.values import Query

DISTINCT, DISTINCT_WITHOUT_GUESS = 24, 16  # candidates of each plate among which contradictions choose
REFINED, REFINED_WITHOUT_GUESS = 4, 6  # candidates of all plates that are refined
COARSE_WEIGHT = 1e-3  # [m] of the coarse misfit beside contradictions: over unseen cells nothing contradicts
UNSEEN_CHOICE, UNSEEN_MISFIT = 0.3e-3, 0.4e-3  # [m] added for a face that the part's volume does not have
MOST_TRIED = 40  # candidates that are refined while no fit is good; fewer of large parts
IN_IMAGE = 3  # best fits that are refined in a noisy image
TYPICAL_SPREAD = 55e-6  # [m] of the place of such a fit
TYPICAL_CAMERA_SPREAD = 1.45e-3  # [m] of a motion, by the camera of a noisy image: the mean of the split val
FURTHER_MISFIT = 0.4e-3  # [m] added for those beyond the first: the image contradicts them more
SPARE = 3  # further candidates that are refined once in place of those that end in an earlier one's pose
CHOICE_DECIMALS = 9  # of a metre: candidates that contradict equally are taken in order


class Residuals(NamedTuple):
    """What is left of the residuals of a fit, [m], or their weights in a sum."""

    outside: float
    """RMS of the distances from the intervals."""
    filled: float
    """RMS of the residuals of the filled part."""
    outline: float
    """See `outline_misfit`."""
    contradicted: float
    """See `Contradictions.score`."""
    coarse: float
    """COARSE_WEIGHT times the misfit of the coarse search."""
    unseen: float
    """UNSEEN_MISFIT for a face that the part's volume does not have."""

    def weighted(self, weights: Residuals) -> float:
        """[m] the sum."""
        return sum(weight * residual for weight, residual in zip(weights, self, strict=True))


MISFIT = Residuals(2.0, 1.0, 0.25, 1.0, 0.0, 1.0)  # weights of the sum by which the best fit is chosen


class Refinement(NamedTuple):
    """How candidates are refined and judged, as the noise of the sensor allows."""

    passes: tuple[Sequence[float], Sequence[float]]
    """[m] scales of the weights; the second pass with the part's sweeps in the refined rotation."""
    doubtful: float
    """[m] of misfit: while the best fit has more, further candidates are refined."""
    tilt: float
    """[rad] by which the best fit is then tilted and refined again, where the part does not lie as it is inserted."""
    prior: float
    """Weight of the filled part beside what is certain."""
    completed_prior: float
    """The same of a part that a network completed."""
    doubt: Residuals
    """Weights in the doubt: how sure a fit is tells another sum than which of the fits is the best."""
    hidden: float
    """[m] added to the doubt of a part whose whole outline is hidden, in proportion to the hidden share."""
    noise_px: float = 0.0
    """[px] of disparity, of the robust scale with which the best fits are refined in the image; 0: they are not."""
    shown: float = 0.0
    """[m] added to the misfit of such a fit, for each unit by which its `ImageFit.misfit` exceeds the least of them."""
    spread: float = 0.0
    """[m] added to their doubt where their place is then e times as uncertain as TYPICAL_SPREAD."""
    camera: float = 0.0
    """Share in the doubt, of the spread that the camera leaves of a motion, beyond TYPICAL_CAMERA_SPREAD."""
    lift: float = 0.0
    """[m] by which goals are raised out of the cavity, for each m of the part's half width: a part whose fit is tilted
    by error touches the cavity's floor before its middle does."""


EXACT = Refinement((SCALES[:3], SCALES[2:]), 2.6e-3, float(np.radians(8)), 0.1, 0.1, MISFIT, 0.0)
NOISY_DOUBT = Residuals(0.0, 1.0, 1.0, 1.0, 5.0, 1.0)
D415 = Refinement(((4e-3, 2e-3), (2e-3, 1.5e-3)), 4e-3, 0.0, 0.3, 1.0, NOISY_DOUBT, 0.0, noise_px=1.0)
"""Edges of the d415 are off by 1.4 mm at random: there a narrow scale follows single walls, and what is surely solid or
free is hardly surer than what a network fills."""
RESTORED = D415._replace(
    doubt=Residuals(0.0, 1.0, 0.0, 0.3, 0.0, 0.0),
    hidden=1e-3,
    noise_px=0.6,
    shown=0.1,
    spread=1e-3,
    camera=0.6,
    lift=0.014,
)
SCANNED = EXACT._replace(noise_px=1.2, lift=0.006)
REFINEMENTS = {"ideal": EXACT, "photoneo": SCANNED, "d415": D415, "restored": RESTORED}
"""Refinement of each kind of image: its sensor, or restored where a network restored it."""


def register_certain(source: DepthSource, query: Query, clearance: float, further: bool = True) -> list[Fit]:
    """The fits of a part in the cavities it may belong to, the best first.

    Args:
        source: of part and kits.
        query: its guess, if any, bounds the search.
        clearance: [m]
        further: whether further candidates are refined while the best fit is doubtful, and the best fits in the image.

    Returns:
        The fits; none of a part that is too large to search.
    """
    if source.half_width > LARGEST:
        return []
    search = EvidenceSearch(source, query, clearance, further)
    guessed = query.guess is not None
    found = find_candidates(source, source.evidence.filled, query, clearance, thorough=True)
    distinct = without_duplicates(found, source.middle, DISTINCT if guessed else DISTINCT_WITHOUT_GUESS)
    fits = search.fits(search.least_contradictory(distinct), REFINED if guessed else REFINED_WITHOUT_GUESS)
    best = ranked(fit for fit in fits if within_guess_error(fit.goal_from_now, query))
    refined = [*search.in_image(best[:IN_IMAGE]), *best[IN_IMAGE:]] if further else best
    return [*map(search.lifted, refined)]


class EvidenceSearch:
    """The evidence about a part and its kits, at a clearance [m]."""

    def __init__(self, source: DepthSource, query: Query, clearance: float, further: bool) -> None:
        self.source, self.query = source, query
        self.clearance, self.further = clearance, further
        self.refinement = REFINEMENTS["restored" if source.restored else query.sensor]
        self.prior = self.refinement.prior if source.completer is None else self.refinement.completed_prior
        self.seen = source.part_points
        self._kits: dict[int, KitHeights] = {}

    def least_contradictory(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """The candidates, those first that the image contradicts least."""
        return sorted(candidates, key=lambda candidate: round(self._choice(candidate), CHOICE_DECIMALS))

    def fits(self, candidates: Sequence[Candidate], most: int) -> list[Fit]:
        """The fits of the first `most` candidates in different poses; of further ones while the best is doubtful."""
        fits: list[Fit] = []
        goals: list[Pose] = []
        tries = tries_of(self.source.half_width, most + SPARE, MOST_TRIED)
        for number, candidate in enumerate(candidates[:tries]):
            further = len(goals) >= most or number >= most + SPARE
            if further and not self._doubtful(fits):
                break
            self._add_fit(candidate, fits, goals, further)
        if fits and self._doubtful(fits):
            best, middle = ranked(fits)[0].candidate, self.source.middle
            for candidate in () if lies_on(best.down_normal) else tilted(best, middle, self.refinement.tilt):
                self._add_fit(candidate, fits, goals, further=True)
        return fits

    def _doubtful(self, fits: Sequence[Fit]) -> bool:
        """Whether a better fit than these is sought."""
        return self.further and min((fit.misfit for fit in fits), default=np.inf) > self.refinement.doubtful

    def _add_fit(self, candidate: Candidate, fits: list[Fit], goals: list[Pose], further: bool) -> None:
        """Add the fit of a candidate, unless its first pass ends in an earlier goal or farther from the guess than any.

        further: whether it is one beyond the first, which is not fitted where its first pass is worse than a fit.
        """
        moved, left = self._refined(candidate, self.refinement.passes[0])
        goal_from_now = moved.cavity.world_from_plate @ moved.plate_from_now
        known = any(same_pose(goal_from_now, other, self.source.middle) for other in goals)
        if known or not within_guess_error(goal_from_now, self.query):
            return
        goals.append(goal_from_now)
        if not further:
            fits.append(self.fitted(moved))
        elif all(self._residuals(moved, left).weighted(MISFIT) < fit.misfit for fit in fits):
            fit = self.fitted(moved)
            fits.append(replace(fit, misfit=fit.misfit + FURTHER_MISFIT))

    def fitted(self, candidate: Candidate) -> Fit:
        """The fit of a candidate after the first pass."""
        candidate, intervals = self._refined(candidate, self.refinement.passes[1])
        filled, pose = self.source.evidence.filled, candidate.plate_from_now
        outline = outline_misfit(filled, candidate.cavity, pose, self.clearance)
        left = self._residuals(candidate, intervals)._replace(outline=outline)
        goal_from_now = candidate.cavity.world_from_plate @ candidate.plate_from_now
        doubt = left.weighted(self.refinement.doubt) + self._unseen_doubt(goal_from_now)
        return Fit(goal_from_now, left.weighted(MISFIT), doubt, candidate)

    def _unseen_doubt(self, goal_from_now: Pose) -> float:
        """[m] of doubt that no residual shows: a hidden outline, and what calibration leaves of the camera's error."""
        doubt = 0.0
        if self.refinement.hidden:
            doubt += self.refinement.hidden * self.source.hidden_outline
        if self.refinement.camera and self.source.camera is not None:
            spread = self.source.camera.spread_of(goal_from_now, self.source.middle)
            doubt += self.refinement.camera * (spread - TYPICAL_CAMERA_SPREAD)
        return doubt

    def in_image(self, fits: Sequence[Fit]) -> list[Fit]:
        """Fits, moved in their plates to where a noisy image shows the cavity.

        Their misfit rises by what the image shows worse than the best of them.
        """
        if not self.refinement.noise_px:
            return list(fits)
        image, filled = self.source.query.image, self.source.evidence.filled
        gain = self.source.gain / self.refinement.noise_px
        given = (image, gain, filled, self.source.middle)
        found = [refine_in_image(*given, fit.candidate, self.clearance) for fit in fits]
        misfits = [each.misfit for each in found if each is not None] if self.refinement.shown else []
        least = min(misfits, default=0.0)
        return [fit if each is None else self._shown(fit, each, least) for fit, each in zip(fits, found, strict=True)]

    def _shown(self, fit: Fit, found: ImageFit, least: float) -> Fit:
        """A fit where the image shows it. least: misfit in the image of the best one."""
        moved = replace(fit.candidate, plate_from_now=found.plate_from_now)
        goal_from_now = moved.cavity.world_from_plate @ found.plate_from_now
        misfit, doubt = fit.misfit, fit.doubt
        if self.refinement.shown:
            misfit += self.refinement.shown * (found.misfit - least)
        if self.refinement.spread:
            doubt += self.refinement.spread * float(np.log(found.spread / TYPICAL_SPREAD))
        return self._placed(Fit(goal_from_now, misfit, doubt, moved))

    def _placed(self, fit: Fit) -> Fit:
        """A fit, moved as a network tells; its misfit and doubt stay."""
        source, candidate = self.source, fit.candidate
        if source.placer is None:
            return fit
        patch = plate_patch(source, candidate, self.clearance, CELLS)
        if patch is None:
            return fit
        return moved(fit, patch.moved(fit.goal_from_now, source.middle, source.placer(patch.channels)))

    def lifted(self, fit: Fit) -> Fit:
        """A fit, raised out of its cavity by what the noise of the image asks for; see `Refinement.lift`."""
        if not self.refinement.lift:
            return fit
        height = self.refinement.lift * self.source.half_width
        world_from_plate = fit.candidate.cavity.world_from_plate
        return moved(fit, Pose.from_translation(height * world_from_plate.rotate(UP)) @ fit.goal_from_now)

    def _residuals(self, candidate: Candidate, intervals: Intervals) -> Residuals:
        """Residuals of a refined candidate, without the outline's."""
        contradicted, coarse = self._contradictions(candidate).score, COARSE_WEIGHT * candidate.misfit
        unseen = 0.0 if candidate.seen else UNSEEN_MISFIT
        return Residuals(intervals.outside, intervals.filled, 0.0, contradicted, coarse, unseen)

    def _choice(self, candidate: Candidate) -> float:
        """[m] by which candidates are chosen."""
        unseen = 0.0 if candidate.seen else UNSEEN_CHOICE
        return self._contradictions(candidate).choice + COARSE_WEIGHT * candidate.misfit + unseen

    def _refined(self, candidate: Candidate, scales: Sequence[float]) -> tuple[Candidate, Intervals]:
        """A candidate after one pass, with what is left of its residuals."""
        evidence, middle = self.source.evidence, self.source.middle
        intervals = refine_within(evidence, middle, candidate, self.clearance, STIFFNESS, self.prior, scales)
        return replace(candidate, plate_from_now=intervals.plate_from_now), intervals

    def _contradictions(self, candidate: Candidate) -> Contradictions:
        key = id(candidate.cavity)
        if key not in self._kits:
            self._kits[key] = KitHeights.of(candidate.cavity, self.clearance)
        return contradictions(self.source.evidence, self.seen, self._kits[key], candidate.plate_from_now)
