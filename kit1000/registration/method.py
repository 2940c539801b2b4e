"""Registration of a part in a scene: search, refinement, refinement in the image, and rank, in this order.

`register` finds the fits at one clearance, `fits_at` those at the best of several clearances.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from kit1000.perception.calibration import CameraEstimate
from kit1000.perception.image_kinds import IDEAL, ImageKind
from kit1000.perception.placement import CELLS
from kit1000.pose import Pose
from kit1000.registration.contradictions import KitHeights, contradictions
from kit1000.registration.geometry.cavity import Cavity
from kit1000.registration.image_refine import ImageFit, plate_patch, refine_in_image
from kit1000.registration.kit_volume import KitCavities, TrueKits
from kit1000.registration.part_volume import PartShape, true_part
from kit1000.registration.prepared_image import RestoredImage
from kit1000.registration.rank import SAME_PLACE, Features, Fit, best_score, moved, ranked, score_of
from kit1000.registration.refine import Intervals, refine_within
from kit1000.registration.search import (
    UP,
    Candidate,
    find_candidates,
    tries_of,
    within_guess_error,
    without_duplicates,
)
from kit1000.values import Query, TrueGeometry

DISTINCT, DISTINCT_WITHOUT_GUESS = 24, 16  # candidates of each plate among which contradictions choose
REFINED, REFINED_WITHOUT_GUESS = 4, 6  # candidates of all plates that are refined
MOST_TRIED = 20  # candidates that are refined as long as no fit is good; fewer of large parts
IN_IMAGE = 3  # best fits that are refined in a noisy image
USUAL_SPREAD = 55e-6  # [m] usual standard deviation of the place of such a fit
USUAL_CAMERA_SPREAD = 1.45e-3  # [m] of a motion, by the camera of a noisy image
CONTRADICTED_DECIMALS = 9  # of a metre
MM = 1e3  # [1/m]


class Scene(Protocol):
    """What is registered: the kits and parts of a `PreparedImage`, or of a `TrueScene`."""

    query: Query
    kind: ImageKind
    kits: KitCavities
    camera: CameraEstimate | None
    """The camera with its uncertainty; None: exact, or unknown."""

    def parts(self) -> Iterator[tuple[PartShape, RestoredImage | None]]:
        """The part of the query, in each way to see it, with the image in which fits are refined."""
        ...


class TrueScene:
    """A scene of which the true shapes are known."""

    def __init__(self, query: Query, geometry: TrueGeometry) -> None:
        """geometry: of the part and the kits."""
        self.query, self.kind = query, IDEAL
        self.camera: CameraEstimate | None = None
        self._geometry = geometry
        self.kits = KitCavities(TrueKits(geometry), query)

    def parts(self) -> Iterator[tuple[PartShape, RestoredImage | None]]:
        """The true part."""
        yield true_part(self._geometry), None


def fits_in(scene: Scene, clearances: Sequence[float]) -> list[Fit]:
    """All fits of the part of a scene's query, the best first.

    With several clearances [m], the fits are those at the one with the best fit.
    """
    searches = [
        [FitSearch(PartRegistration(scene, part, image, clearance)) for clearance in clearances]
        for part, image in scene.parts()
    ]
    if not searches:
        return []
    first = searches[0]
    best = 0 if len(first) == 1 else max(range(len(first)), key=lambda k: best_score(first[k].first_fits()))
    return max((each[best].all_fits() for each in searches), key=best_score)


class FitSearch:
    """The fits of a part: candidates are refined one after the other, until a fit is good."""

    def __init__(self, part: PartRegistration) -> None:
        """Nothing is searched yet."""
        self.part = part
        self.fits: list[Fit] = []
        self._goals: list[Pose] = []  # in which candidates ended
        self._candidates: list[Candidate] | None = None
        self._first = REFINED_WITHOUT_GUESS if part.query.guess is None else REFINED
        self._tried = 0

    def first_fits(self) -> list[Fit]:
        """The fits of the first candidates, the best first."""
        self._refine_first()
        return ranked(map(self.part.raised, self._within_guess()))

    def all_fits(self) -> list[Fit]:
        """The fits of the first candidates, of more if the best fit is doubtful; the best are refined in the image."""
        candidates = self._refine_first()
        tries = tries_of(self.part.shape.half_width, self._first, MOST_TRIED)
        while self._tried < len(candidates[:tries]) and best_score(self.fits) < self.part.refinement.doubtful:
            self._add_fit(candidates[self._tried])
        best = self._within_guess()
        in_image = [*self.part.in_image(best[:IN_IMAGE]), *best[IN_IMAGE:]]
        return ranked(map(self.part.raised, in_image))

    def _within_guess(self) -> list[Fit]:
        """The fits that are as near to the guess as a goal is, the best first."""
        return ranked(fit for fit in self.fits if within_guess_error(fit.goal_from_now, self.part.query))

    def _refine_first(self) -> list[Candidate]:
        """Refine the first candidates; returns all of them."""
        if self._candidates is None:
            self._candidates = self.part.candidates()
        for candidate in self._candidates[self._tried : self._first]:
            self._add_fit(candidate)
        return self._candidates

    def _add_fit(self, candidate: Candidate) -> None:
        """Add the fit of a candidate, unless it converges to a known goal or leaves the guess's range.

        Candidates beyond the first are fitted only if their first pass is already better than every fit.
        """
        self._tried += 1
        part = self.part
        candidate, left = part.refined(candidate, part.refinement.passes[0])
        goal_from_now = candidate.cavity.world_from_plate @ candidate.plate_from_now
        known = any(part.shape.gap(goal_from_now, goal) < SAME_PLACE for goal in self._goals)
        if known or not within_guess_error(goal_from_now, part.query):
            return
        self._goals.append(goal_from_now)
        if self._tried <= self._first or part.score(part.features(candidate, left)) > best_score(self.fits):
            self.fits.append(part.fitted(candidate))


class PartRegistration:
    """A part, the kits of its scene, and how candidates of the part are refined at a clearance."""

    def __init__(self, scene: Scene, shape: PartShape, image: RestoredImage | None, clearance: float) -> None:
        """Prepare the registration of a part.

        Args:
            scene: its kits, kind of image and camera; the guess of its query, if any, bounds the search.
            shape: of the part.
            image: in which fits are refined; None: they are not.
            clearance: [m]
        """
        self.shape, self.image, self.query, self.clearance = shape, image, scene.query, clearance
        self.kits, self.camera, self.refinement = scene.kits, scene.camera, scene.kind.refinement
        self.ranking = scene.kind.ranking
        self.prior = self.refinement.prior if shape.completed is None else self.refinement.completed_prior
        self._heights: dict[Cavity, KitHeights] = {}

    def candidates(self) -> list[Candidate]:
        """The candidates that differ, those first that the image contradicts least; of equal ones the better match."""
        found = find_candidates(self.shape, self.kits, self.query, self.clearance)
        most = DISTINCT_WITHOUT_GUESS if self.query.guess is None else DISTINCT
        distinct = without_duplicates(found, self.shape.middle, most)
        return sorted(distinct, key=lambda candidate: round(self._contradicted(candidate), CONTRADICTED_DECIMALS))

    def refined(self, candidate: Candidate, scales: Sequence[float]) -> tuple[Candidate, Intervals]:
        """A candidate after one pass at some scales [m], with what is left of its residuals."""
        shape = self.shape
        left = refine_within(shape.bounds, shape.middle, candidate, self.clearance, self.prior, scales)
        return replace(candidate, plate_from_now=left.plate_from_now), left

    def features(self, candidate: Candidate, left: Intervals) -> Features:
        """The features of a refined candidate. left: of its residuals."""
        camera = 0.0
        if self.camera is not None:
            goal_from_now = candidate.cavity.world_from_plate @ candidate.plate_from_now
            camera = MM * (self.camera.spread_of(goal_from_now, self.shape.middle) - USUAL_CAMERA_SPREAD)
        return Features(
            outside=MM * left.outside,
            filled=MM * left.filled,
            contradicted=MM * self._contradicted(candidate),
            camera=camera,
        )

    def score(self, features: Features) -> float:
        """The score of a fit."""
        return score_of(features, self.ranking)

    def fitted(self, candidate: Candidate) -> Fit:
        """The fit of a candidate after the first pass."""
        candidate, left = self.refined(candidate, self.refinement.passes[1])
        features = self.features(candidate, left)
        goal_from_now = candidate.cavity.world_from_plate @ candidate.plate_from_now
        return Fit(goal_from_now, self.score(features), candidate, self.shape, features)

    def in_image(self, fits: Sequence[Fit]) -> list[Fit]:
        """Fits, moved in their plates to where a noisy image shows the cavity, and scored by what it shows."""
        image, noise = self.image, self.refinement.noise_px
        if image is None or not noise:
            return list(fits)
        filled, middle = self.shape.bounds.filled, self.shape.middle
        found = [
            refine_in_image(image.restored, image.gain / noise, filled, middle, fit.candidate, self.clearance)
            for fit in fits
        ]
        costs = [None if each is None else each.cost() for each in found]
        least = min((cost for cost in costs if cost is not None), default=0.0)
        return [
            fit if each is None or cost is None else self._placed(self._shown(fit, each, cost - least), image)
            for fit, each, cost in zip(fits, found, costs, strict=True)
        ]

    def _shown(self, fit: Fit, found: ImageFit, misfit: float) -> Fit:
        """A fit in the place that the image shows. misfit: see `Features`."""
        shown = moved(fit, fit.candidate.cavity.world_from_plate @ found.plate_from_now)
        features = fit.features._replace(misfit=misfit, spread=float(np.log(found.spread() / USUAL_SPREAD)))
        return replace(shown, score=self.score(features), features=features)

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

    def _contradicted(self, candidate: Candidate) -> float:
        """[m] the contradiction of a candidate by the image."""
        cavity = candidate.cavity
        if cavity not in self._heights:
            self._heights[cavity] = KitHeights.of(cavity, self.clearance)
        return contradictions(self.shape, self._heights[cavity], candidate.plate_from_now).cost
