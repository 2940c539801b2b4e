"""The method from end to end: plates, cavities, coarse search, refinement, and the choice among what fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from baselines.completion.planes import find_planes, frame_on
from baselines.registration.cavity import Cavity, find_cavity, plate_grid
from baselines.registration.faces import standing_faces
from baselines.registration.outline import outline_misfit
from baselines.registration.refine import refine
from baselines.registration.search import Candidate, Window, coarse_search, distinct
from baselines.registration.sources import DepthSource, Source, TrueSource
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.rng import stream
from kit1000.values import Query, Truth
from kit1000.voxels import Volume, surface_points

SOURCES = ("depth", "truth")
SLACK_OFFSET, SLACK_ANGLE = 1.5e-3, np.radians(2.5)  # looked at beyond the largest error of a guess
SIDE = 0.144  # [m] of a plate's relief: the window of a guess and a part's half width on either side
REFINED, REFINED_ANYWHERE = 6, 4  # candidates of each plate, with a guess and without
POLISHED = 3  # fits that are refined once more
STIFFNESS = 1.0  # of the contact between the face that looks down and the floor
SURPRISE, USUAL = 0.5, 1e-3  # what a depth that is not the usual one costs, a metre, up to [m]
DOWN = np.array([0.0, 0.0, -1.0])
SEATED = {"truth": (5.5e-3, 0.4e-3), "ideal": (6.0e-3, 1.4e-3), "d415": (-6.8e-3, 7.1e-3)}
"""By the kind of volumes: the misfit [m] at which half of the answers are seated, and the spread of the logistic curve,
fitted to the validation split."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A refined answer."""

    goal_from_now: Pose
    misfit: float
    """[m] what is left: of the cavity's points, of its outline, and of its depth."""
    candidate: Candidate
    """Where to go on."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Predicts by registration: what the part would cut into a plate is compared with what is cut into the plates."""

    dataset: Dataset
    source: str = "depth"
    """depth: the query's image and masks; truth: the true volumes."""
    clearances: tuple[float, ...] = ()
    """[m] to try, the one that fits best counts; by default the one that the dataset publishes."""

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise InputError(f"source {self.source!r}: expected one of {', '.join(SOURCES)}")

    @property
    def uses_true_geometry(self) -> bool:
        """Whether it needs the truth."""
        return self.source == "truth"

    def __call__(self, query: Query, truth: Truth | None = None) -> PredictedMotion:
        """The best fit; where nothing fits, the guess or no motion, without confidence."""
        source = self._source(query, truth)
        tried = self.clearances or (self.dataset.summary["config"]["clearance"],)
        fits = sorted(chain.from_iterable(register(source, query, c) for c in tried), key=lambda fit: fit.misfit)
        if not fits:
            return PredictedMotion(Pose.identity() if query.guess is None else query.guess, 0.0)
        kind = "truth" if self.uses_true_geometry else query.sensor
        return PredictedMotion(fits[0].goal_from_now, confidence(fits[0].misfit, kind))

    def _source(self, query: Query, truth: Truth | None) -> Source:
        if self.source == "depth":
            return DepthSource(query)
        if truth is None:
            raise InputError(f"{query.id}: true volumes want the truth; say dataset.split(NAME, truth=True)")
        geometry = self.dataset.geometry
        assembly = geometry.assembly(truth.assembly_id)
        mount = next(mount for mount in assembly.mounts if mount.kit.id == truth.part_id)
        stands = truth.world_from_kit @ mount.assembly_from_kit.inverse()
        part = (geometry.part(truth.part_id).mesh, truth.world_from_part)
        return TrueSource(part, ((assembly.mesh, stands),))


def register(source: Source, query: Query, clearance: float) -> list[Fit]:
    """All fits of a part in the kits it may belong to, the best first. clearance: [m]."""
    part = source.part()
    if not part.occupied.any():
        return []
    cavities = find_cavities(source, query)
    if not cavities:
        return []
    window = Window(query.pivot, query.guess, MAX_ANGLE + SLACK_ANGLE, MAX_OFFSET + SLACK_OFFSET)
    downs = _downs(source, part, query, cavities)
    found = coarse_search(part, source.middle, downs, cavities, clearance, window)
    first = distinct(found, source.middle, REFINED if query.guess is not None else REFINED_ANYWHERE)
    fits = _refined(part, source.middle, first, query, clearance)
    again = [fit.candidate for fit in fits[:POLISHED]]  # with the part's sweep at the turn that was found
    return _refined(part, source.middle, again, query, clearance)


def _refined(
    part: Volume, middle: np.ndarray, candidates: Sequence[Candidate], query: Query, clearance: float
) -> list[Fit]:
    """Candidates after refinement, the best first; those are left out that the guess cannot have meant."""
    fits = []
    for candidate in candidates:
        pose, rest = refine(part, middle, candidate, clearance, STIFFNESS)
        goal_from_now = candidate.cavity.world_from_plate @ pose
        if query.guess is None or _near(goal_from_now, query.guess, query.pivot):
            outline = outline_misfit(part, candidate.cavity, pose, clearance)
            misfit = rest + outline + SURPRISE * min(candidate.surprise, USUAL)
            fits.append(Fit(goal_from_now, misfit, replace(candidate, plate_from_now=pose)))
    return sorted(fits, key=lambda fit: fit.misfit)


def find_cavities(source: Source, query: Query) -> list[Cavity]:
    """The cavities of all plates near the guess, or of all plates."""
    home = None if query.guess is None else query.guess.apply(query.pivot)
    box = None if home is None else home + np.array([[-SIDE / 2], [SIDE / 2]])
    points, normals, area = source.oriented_points(box)
    planes = find_planes(points, normals, area, source.near, source.flat, stream(0, "registration", query.id))
    frames = [frame_on(plane, plane.point if home is None else home) for plane in planes]
    cavities = [find_cavity(source.plate(plate_grid(frame, SIDE)), frame, source.near) for frame in frames]
    return [cavity for cavity in cavities if cavity is not None]


def confidence(misfit: float, kind: str) -> float:
    """The share of fits that are seated among those with such a misfit [m], for a kind of volumes in SEATED."""
    half, spread = SEATED[kind]
    return float(1 / (1 + np.exp((misfit - half) / spread)))


def _downs(source: Source, part: Volume, query: Query, cavities: Sequence[Cavity]) -> list[np.ndarray]:
    """The normals that may point into a cavity, (3,) each; a part to be placed without a guess lies upright."""
    if query.guess is None:
        return [DOWN]
    back = query.guess.inverse()
    meant = [back.rotate(cavity.world_from_plate.rotate(DOWN)) for cavity in cavities]
    middle = part.grid.world(np.argwhere(part.occupied)).mean(0)
    cone = MAX_ANGLE + SLACK_ANGLE + source.flat
    faces = standing_faces(surface_points(part), middle, source.flat, np.array(meant), cone)
    # Where no face was seen that may look down, the guess says which way is down.
    return [face.normal for face in faces] or meant


def _near(goal_from_now: Pose, guess: Pose, pivot: np.ndarray) -> bool:
    """Whether a motion is one that the guess may have meant."""
    offset = np.abs(goal_from_now.apply(pivot) - guess.apply(pivot)).max()
    turn = float((goal_from_now @ guess.inverse()).angle())
    return bool(offset <= MAX_OFFSET + 2 * SLACK_OFFSET and turn <= MAX_ANGLE + 2 * SLACK_ANGLE)
