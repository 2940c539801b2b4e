"""The method from end to end: plates, cavities, coarse search, refinement, and the choice among the fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from baselines.completion.planes import find_planes, plane_frame
from baselines.registration.cavity import Cavity, find_cavity, plate_grid
from baselines.registration.faces import standing_faces
from baselines.registration.outline import outline_misfit
from baselines.registration.refine import refine
from baselines.registration.search import Candidate, SearchWindow, coarse_search, without_duplicates
from baselines.registration.sources import DepthSource, Source, TrueSource
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.rng import stream
from kit1000.values import Query, TrueGeometry
from kit1000.voxels import Volume, surface_points

SOURCES = ("depth", "truth")
SLACK_OFFSET, SLACK_ANGLE = 1.5e-3, np.radians(2.5)  # [m], [rad] searched beyond the largest error of a guess
SIDE = 0.144  # [m] of a plate's relief: the range of a guess and half a part's width on either side
REFINED, REFINED_WITHOUT_GUESS = 6, 4  # candidates of each plate that are refined
REFINED_TWICE = 3  # the best of them, with the part's sweep in the refined rotation
STIFFNESS = 1.0  # of the contact between the part's lower face and the floor
DEPTH_COST, MOST_DEPTH = 0.5, 1e-3  # cost of a depth that differs from the expected one, per metre, up to so many [m]
MISFIT_DECIMALS = 9  # of a metre: fits that differ by less are equal
CONFIDENCE_DECIMALS = 9  # the last digits of an exponential depend on the processor
DOWN = np.array([0.0, 0.0, -1.0])
SEATED = {"truth": (5.5e-3, 0.4e-3), "ideal": (6.0e-3, 1.4e-3), "d415": (-6.8e-3, 7.1e-3)}
"""By volumes (truth, or the sensor): the misfit [m] at which half of the predictions are seated, and the spread of the
logistic curve, fitted to the validation split."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A refined candidate."""

    goal_from_now: Pose
    misfit: float
    """[m] residual of the cavity's points, its outline and its depth."""
    candidate: Candidate
    """For a second refinement."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Predicts by registration: compares the cavity that the part would cut with those in the plates."""

    dataset: Dataset
    source: str = "depth"
    """depth: the query's image and masks; truth: the true geometry."""
    clearances: tuple[float, ...] = ()
    """[m] to try, of which the best fit counts; by default the one that the dataset states."""

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise InputError(f"source {self.source!r}: expected one of {', '.join(SOURCES)}")

    @property
    def uses_true_geometry(self) -> bool:
        """Whether it needs the true geometry."""
        return self.source == "truth"

    def __call__(self, query: Query, geometry: TrueGeometry | None = None) -> PredictedMotion:
        """The best fit; where nothing fits, the guess or no motion, with confidence 0."""
        source = self._source(query, geometry)
        clearances = self.clearances or (self.dataset.summary["config"]["clearance"],)
        fits = sorted(chain.from_iterable(register(source, query, c) for c in clearances), key=_rounded_misfit)
        if not fits:
            return PredictedMotion(Pose.identity() if query.guess is None else query.guess, 0.0)
        volumes = "truth" if self.uses_true_geometry else query.sensor
        return PredictedMotion(fits[0].goal_from_now, confidence(fits[0].misfit, volumes))

    def _source(self, query: Query, geometry: TrueGeometry | None) -> Source:
        if self.source == "depth":
            return DepthSource(query)
        if geometry is None:
            raise InputError(f"{query.id}: registration from true volumes needs the true geometry")
        return TrueSource(geometry)


def register(source: Source, query: Query, clearance: float) -> list[Fit]:
    """All fits of a part in the cavities it may belong to, the best first. clearance: [m]."""
    part = source.part()
    if not part.occupied.any():
        return []
    cavities = find_cavities(source, query)
    if not cavities:
        return []
    window = SearchWindow(query.pivot, query.guess, MAX_ANGLE + SLACK_ANGLE, MAX_OFFSET + SLACK_OFFSET)
    down_normals = _down_normals(source, part, query, cavities)
    candidates = coarse_search(part, source.middle, down_normals, cavities, clearance, window)
    most = REFINED if query.guess is not None else REFINED_WITHOUT_GUESS
    first = without_duplicates(candidates, source.middle, most)
    fits = _refined(part, source.middle, first, query, clearance)
    second = [fit.candidate for fit in fits[:REFINED_TWICE]]
    return _refined(part, source.middle, second, query, clearance)


def _refined(
    part: Volume, middle: np.ndarray, candidates: Sequence[Candidate], query: Query, clearance: float
) -> list[Fit]:
    """The refined candidates, the best first, without those farther from the guess than a guess is ever off."""
    fits = []
    for candidate in candidates:
        pose, rms = refine(part, middle, candidate, clearance, STIFFNESS)
        goal_from_now = candidate.cavity.world_from_plate @ pose
        if query.guess is None or _within_guess_error(goal_from_now, query.guess, query.pivot):
            outline = outline_misfit(part, candidate.cavity, pose, clearance)
            misfit = rms + outline + DEPTH_COST * min(candidate.depth_difference, MOST_DEPTH)
            fits.append(Fit(goal_from_now, misfit, replace(candidate, plate_from_now=pose)))
    return sorted(fits, key=_rounded_misfit)


def _rounded_misfit(fit: Fit) -> float:
    """[m] by which fits are sorted; of equal ones the first candidate is the first."""
    return round(fit.misfit, MISFIT_DECIMALS)


def find_cavities(source: Source, query: Query) -> list[Cavity]:
    """The cavities of all plates near the guess; of all plates where there is no guess."""
    guessed = None if query.guess is None else query.guess.apply(query.pivot)
    box = None if guessed is None else guessed + np.array([[-SIDE / 2], [SIDE / 2]])
    points, normals, area = source.oriented_points(box)
    planes = find_planes(points, normals, area, source.noise, stream(0, "registration", query.id))
    frames = [plane_frame(plane, plane.point if guessed is None else guessed) for plane in planes]
    noise = source.noise.distance
    cavities = [find_cavity(source.plate(plate_grid(frame, SIDE)), frame, noise) for frame in frames]
    return [cavity for cavity in cavities if cavity is not None]


def confidence(misfit: float, volumes: str) -> float:
    """The share of fits with such a misfit [m] that are seated, for the volumes of SEATED."""
    half, spread = SEATED[volumes]
    return round(float(1 / (1 + np.exp((misfit - half) / spread))), CONFIDENCE_DECIMALS)


def _down_normals(source: Source, part: Volume, query: Query, cavities: Sequence[Cavity]) -> list[np.ndarray]:
    """Normals (3,) of the faces that may go onto a cavity's floor; without a guess the part lies as it is inserted."""
    if query.guess is None:
        return [DOWN]
    back = query.guess.inverse()
    guessed = [back.rotate(cavity.world_from_plate.rotate(DOWN)) for cavity in cavities]
    middle = part.grid.world(np.argwhere(part.occupied)).mean(0)
    angle = source.noise.angle
    cone = MAX_ANGLE + SLACK_ANGLE + angle
    faces = standing_faces(surface_points(part), middle, angle, np.array(guessed), cone)
    return [face.normal for face in faces] or guessed  # where no such face is observed, the guess gives the direction


def _within_guess_error(goal_from_now: Pose, guess: Pose, pivot: np.ndarray) -> bool:
    """Whether a motion is as near to the guess as a goal is."""
    offset = np.abs(goal_from_now.apply(pivot) - guess.apply(pivot)).max()
    angle = float((goal_from_now @ guess.inverse()).angle())
    return bool(offset <= MAX_OFFSET + 2 * SLACK_OFFSET and angle <= MAX_ANGLE + 2 * SLACK_ANGLE)
