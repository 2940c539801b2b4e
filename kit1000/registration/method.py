"""Registration of a part in a scene: search, refinement, refinement in the image, and rank, in this order.

`register` finds the fits at one clearance, `fits_at` those at the best of several clearances.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from kit1000.perception.calibration import CameraEstimate
from kit1000.perception.image_kinds import COST, IDEAL, CostTerms, ImageKind
from kit1000.perception.placement import CELLS
from kit1000.pose import Pose
from kit1000.registration.geometry.cavity import Cavity
from kit1000.registration.geometry.height_maps import outline_cost
from kit1000.registration.image_refine import ImageFit, plate_patch, refine_in_image
from kit1000.registration.kit_volume import KitCavities, TrueKits
from kit1000.registration.part_volume import PartShape, true_part
from kit1000.registration.prepared_image import RestoredImage
from kit1000.registration.rank import Fit, assigned, least_cost, moved, ranked, same_pose
from kit1000.registration.refine import Intervals, refine_within
from kit1000.registration.search import (
    UP,
    Candidate,
    Contradictions,
    KitHeights,
    contradictions,
    find_candidates,
    lies_on,
    tilted,
    tries_of,
    within_guess_error,
    without_duplicates,
)
from kit1000.values import Query, TrueGeometry

DISTINCT, DISTINCT_WITHOUT_GUESS = 24, 16  # candidates of each plate among which contradictions choose
REFINED, REFINED_WITHOUT_GUESS = 4, 6  # candidates of all plates that are refined
COARSE_WEIGHT = 1e-3  # [m] weight of the coarse cost beside contradictions: unseen cells contradict nothing
UNSEEN_CHOICE = 0.3e-3  # [m] added in the choice of candidates for a face that the part's volume does not have
UNSEEN_COST = 0.4e-3  # [m] the same in the cost of a fit
MOST_TRIED = 40  # candidates that are refined as long as no fit is good; fewer of large parts
IN_IMAGE = 3  # best fits that are refined in a noisy image
USUAL_SPREAD = 55e-6  # [m] usual standard deviation of the place of such a fit
USUAL_CAMERA_SPREAD = 1.45e-3  # [m] of a motion, by the camera of a noisy image: the mean of the split val
MORE_COST = 0.4e-3  # [m] added to the cost of candidates beyond the first: the image contradicts them more
SPARE = 3  # more candidates are refined if some of the first end in an earlier pose
CHOICE_DECIMALS = 9  # of a metre: candidates that contradict equally are taken in order


class Scene(Protocol):
    """What is registered: the kits and parts of a `PreparedImage`, or of a `TrueScene`."""

    query: Query
    kind: ImageKind
    kits: KitCavities
    camera: CameraEstimate | None
    """The camera with its uncertainty; None: exact, or unknown."""

    def parts(self, query: Query) -> Iterator[tuple[PartShape, RestoredImage | None]]:
        """The part of a query, in each way to see it, with the image in which fits are refined."""
        ...

    def rivals(self) -> Iterable[Query]:
        """The queries about the other parts of the scene."""
        ...


class TrueScene:
    """A scene of which the true shapes are known."""

    def __init__(self, query: Query, geometry: TrueGeometry) -> None:
        """geometry: of the part and the kits."""
        self.query, self.kind = query, IDEAL
        self.camera: CameraEstimate | None = None
        self._geometry = geometry
        self.kits = KitCavities(TrueKits(geometry), query)

    def parts(self, query: Query) -> Iterator[tuple[PartShape, RestoredImage | None]]:
        """The true part."""
        yield true_part(self._geometry), None

    def rivals(self) -> Iterable[Query]:
        """None: only the query's own part is known."""
        return ()


def fits_in(scene: Scene, clearances: Sequence[float]) -> list[Fit]:
    """All fits of the part of a scene's query, the best first.

    With several clearances [m], the fits are those at the one whose best fit costs the least.
    """
    searches = [
        [FitSearch(PartRegistration(scene, part, image, scene.query, clearance)) for clearance in clearances]
        for part, image in scene.parts(scene.query)
    ]
    if not searches:
        return []
    first = searches[0]
    best = 0 if len(first) == 1 else min(range(len(first)), key=lambda k: least_cost(first[k].first_fits()))
    fits = min((each[best].all_fits() for each in searches), key=least_cost)
    if scene.query.guess is not None:
        return fits
    return assigned(fits, _fits_of_rivals(scene, clearances[best]), scene.kind.right_plate)


def _fits_of_rivals(scene: Scene, clearance: float) -> Iterator[list[Fit]]:
    """The first fits of each other part of a scene: only their costs are read."""
    for query in scene.rivals():
        parts = scene.parts(query)
        found = [FitSearch(PartRegistration(scene, part, None, query, clearance)).first_fits() for part, _ in parts]
        yield min(found, key=least_cost, default=[])


class FitSearch:
    """The fits of a part: candidates are refined one after the other, until a fit is good."""

    def __init__(self, part: PartRegistration) -> None:
        """Nothing is searched yet."""
        self.part = part
        self.fits: list[Fit] = []
        self._goals: list[Pose] = []  # in which candidates ended
        self._candidates: list[Candidate] | None = None
        self._tried = 0

    def first_fits(self) -> list[Fit]:
        """The fits of the first candidates, the best first."""
        self._refine_first()
        return ranked(map(self.part.raised, self._within_guess()))

    def all_fits(self) -> list[Fit]:
        """The fits of the first candidates, of more if the best fit is doubtful; the best are refined in the image."""
        self._refine_first()
        self._refine_more()
        best = self._within_guess()
        in_image = [*self.part.in_image(best[:IN_IMAGE]), *best[IN_IMAGE:]]
        return ranked(map(self.part.raised, in_image))

    def _within_guess(self) -> list[Fit]:
        """The fits that are as near to the guess as a goal is, the best first."""
        return ranked(fit for fit in self.fits if within_guess_error(fit.goal_from_now, self.part.query))

    def _refine_first(self) -> None:
        """Refine candidates until enough of them end in different poses."""
        if self._candidates is None:
            self._candidates = self.part.candidates()
        most = REFINED_WITHOUT_GUESS if self.part.query.guess is None else REFINED
        first = self._candidates[: most + SPARE]
        while self._tried < len(first) and len(self._goals) < most:
            self._add_fit(first[self._tried], first=True)
            self._tried += 1

    def _refine_more(self) -> None:
        """Refine more candidates as long as the best fit is doubtful, at last tilts of the best fit."""
        assert self._candidates is not None
        guessed, part = self.part.query.guess is not None, self.part
        least = (REFINED if guessed else REFINED_WITHOUT_GUESS) + SPARE
        tries = tries_of(part.shape.half_width, least, MOST_TRIED)
        while self._tried < len(self._candidates[:tries]) and self._doubtful():
            self._add_fit(self._candidates[self._tried])
            self._tried += 1
        if self.fits and self._doubtful():
            best = ranked(self.fits)[0].candidate
            if not lies_on(best.down_normal):
                for candidate in tilted(best, part.shape.middle, part.refinement.tilt):
                    self._add_fit(candidate)

    def _doubtful(self) -> bool:
        """Whether a better fit is searched."""
        return min((fit.cost for fit in self.fits), default=np.inf) > self.part.refinement.doubtful

    def _add_fit(self, candidate: Candidate, first: bool = False) -> None:
        """Add the fit of a candidate, unless it converges to a known goal or leaves the guess's range.

        Candidates beyond the first are fitted only if their first pass already costs less than every fit.
        """
        part = self.part
        candidate, left = part.refined(candidate, part.refinement.passes[0])
        goal_from_now = candidate.cavity.world_from_plate @ candidate.plate_from_now
        known = any(same_pose(goal_from_now, goal, part.shape.middle) for goal in self._goals)
        if known or not within_guess_error(goal_from_now, part.query):
            return
        self._goals.append(goal_from_now)
        if first:
            self.fits.append(part.fitted(candidate))
        elif part.cost_terms(candidate, left).weighted(COST) < min((fit.cost for fit in self.fits), default=np.inf):
            fit = part.fitted(candidate)
            self.fits.append(replace(fit, cost=fit.cost + MORE_COST))


class PartRegistration:
    """A part, the kits of its scene, and how candidates of the part are refined at a clearance."""

    def __init__(
        self, scene: Scene, shape: PartShape, image: RestoredImage | None, query: Query, clearance: float
    ) -> None:
        """Prepare the registration of a part.

        Args:
            scene: its kits, kind of image and camera.
            shape: of the part.
            image: in which fits are refined; None: they are not.
            query: about the part; its guess, if any, bounds the search.
            clearance: [m]
        """
        self.shape, self.image, self.query, self.clearance = shape, image, query, clearance
        self.kits, self.camera, self.refinement = scene.kits, scene.camera, scene.kind.refinement
        self.prior = self.refinement.prior if shape.completed is None else self.refinement.completed_prior
        self._heights: dict[Cavity, KitHeights] = {}

    def candidates(self) -> list[Candidate]:
        """The candidates that differ, those first that the image contradicts least."""
        found = find_candidates(self.shape, self.kits, self.query, self.clearance)
        most = DISTINCT_WITHOUT_GUESS if self.query.guess is None else DISTINCT
        return self.least_contradictory(without_duplicates(found, self.shape.middle, most))

    def least_contradictory(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """The candidates, those first that the image contradicts least."""

        def choice(candidate: Candidate) -> float:
            unseen = 0.0 if candidate.seen else UNSEEN_CHOICE
            return round(
                self._contradictions(candidate).choice + COARSE_WEIGHT * candidate.cost + unseen, CHOICE_DECIMALS
            )

        return sorted(candidates, key=choice)

    def refined(self, candidate: Candidate, scales: Sequence[float]) -> tuple[Candidate, Intervals]:
        """A candidate after one pass at some scales [m], with what is left of its residuals."""
        shape = self.shape
        left = refine_within(shape.bounds, shape.middle, candidate, self.clearance, self.prior, scales)
        return replace(candidate, plate_from_now=left.plate_from_now), left

    def cost_terms(self, candidate: Candidate, left: Intervals) -> CostTerms:
        """The terms of the cost of a refined candidate, without the outline's."""
        contradicted, coarse = self._contradictions(candidate).cost, COARSE_WEIGHT * candidate.cost
        unseen = 0.0 if candidate.seen else UNSEEN_COST
        return CostTerms(left.outside, left.filled, 0.0, contradicted, coarse, unseen)

    def fitted(self, candidate: Candidate) -> Fit:
        """The fit of a candidate after the first pass."""
        candidate, left = self.refined(candidate, self.refinement.passes[1])
        filled, pose = self.shape.bounds.filled, candidate.plate_from_now
        outline = outline_cost(filled, candidate.cavity, pose, self.clearance)
        terms = self.cost_terms(candidate, left)._replace(outline=outline)
        goal_from_now = candidate.cavity.world_from_plate @ candidate.plate_from_now
        uncertainty = terms.weighted(self.refinement.uncertainty) + self._hidden_uncertainty(goal_from_now)
        return Fit(goal_from_now, terms.weighted(COST), uncertainty, candidate)

    def _hidden_uncertainty(self, goal_from_now: Pose) -> float:
        """[m] uncertainty that no residual shows: of a hidden outline, and of the camera's pose after calibration."""
        uncertainty = self.refinement.hidden * self.shape.hidden_outline
        if self.refinement.camera and self.camera is not None:
            spread = self.camera.spread_of(goal_from_now, self.shape.middle)
            uncertainty += self.refinement.camera * (spread - USUAL_CAMERA_SPREAD)
        return uncertainty

    def in_image(self, fits: Sequence[Fit]) -> list[Fit]:
        """Fits, moved in their plates to where a noisy image shows the cavity.

        The cost of a fit rises with its image cost above that of the best fit.
        """
        image, noise = self.image, self.refinement.noise_px
        if image is None or not noise:
            return list(fits)
        filled, middle = self.shape.bounds.filled, self.shape.middle
        found = [
            refine_in_image(image.restored, image.gain / noise, filled, middle, fit.candidate, self.clearance)
            for fit in fits
        ]
        costs = [0.0 if each is None or not self.refinement.image_cost else each.cost() for each in found]
        least = min((cost for cost, each in zip(costs, found, strict=True) if each is not None), default=0.0)
        return [
            fit if each is None else self._placed(self._shown(fit, each, cost - least), image)
            for fit, each, cost in zip(fits, found, costs, strict=True)
        ]

    def _shown(self, fit: Fit, found: ImageFit, image_cost: float) -> Fit:
        """A fit in the place that the image shows. image_cost: cost in the image above that of the best fit."""
        candidate = replace(fit.candidate, plate_from_now=found.plate_from_now)
        goal_from_now = candidate.cavity.world_from_plate @ found.plate_from_now
        cost, uncertainty = fit.cost, fit.uncertainty
        if self.refinement.image_cost:
            cost += self.refinement.image_cost * image_cost
        if self.refinement.spread:
            uncertainty += self.refinement.spread * float(np.log(found.spread() / USUAL_SPREAD))
        return Fit(goal_from_now, cost, uncertainty, candidate)

    def _placed(self, fit: Fit, image: RestoredImage) -> Fit:
        """A fit, moved by the network that places fits, if there is one."""
        if image.placer is None:
            return fit
        patch = plate_patch(self.shape, image, fit.candidate, self.clearance, CELLS)
        if patch is None:
            return fit
        return moved(fit, patch.moved(fit.goal_from_now, self.shape.middle, image.placer(patch.channels)))

    def raised(self, fit: Fit) -> Fit:
        """A fit with its goal raised along the insertion axis; see `Refinement.raise_goal`."""
        if not self.refinement.raise_goal:
            return fit
        height = self.refinement.raise_goal * self.shape.half_width
        world_from_plate = fit.candidate.cavity.world_from_plate
        return moved(fit, Pose.from_translation(height * world_from_plate.rotate(UP)) @ fit.goal_from_now)

    def _contradictions(self, candidate: Candidate) -> Contradictions:
        cavity = candidate.cavity
        if cavity not in self._heights:
            self._heights[cavity] = KitHeights.of(cavity, self.clearance)
        return contradictions(self.shape, self._heights[cavity], candidate.plate_from_now)
