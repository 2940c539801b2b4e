"""Registration that fills the part down to the table: all candidates are refined, and the best fit wins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kit1000.registration.choice.fits import STIFFNESS, Fit, ranked
from kit1000.registration.geometry.expected_relief import outline_misfit
from kit1000.registration.inputs.volume_sources import Source
from kit1000.registration.refinement.walls import refine
from kit1000.registration.search.candidates import find_candidates, within_guess_error
from kit1000.registration.search.correlation import Candidate, without_duplicates
from kit1000.values import Query
from kit1000.voxels import Volume

REFINED, REFINED_WITHOUT_GUESS = 6, 4  # candidates of each plate that are refined
REFINED_TWICE = 3  # the best of them, with the part's sweep in the refined rotation
DEPTH_COST, MOST_DEPTH = 0.5, 1e-3  # cost of a depth that differs from the expected one, per metre, up to so many [m]


def register_columns(source: Source, query: Query, clearance: float) -> list[Fit]:
    """All fits of a part in the cavities it may belong to, the best first. clearance: [m]."""
    part = source.part()
    candidates = find_candidates(source, part, query, clearance)
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
        if within_guess_error(goal_from_now, query):
            outline = outline_misfit(part, candidate.cavity, pose, clearance)
            misfit = rms + outline + DEPTH_COST * min(candidate.depth_difference, MOST_DEPTH)
            fits.append(Fit(goal_from_now, misfit, misfit, replace(candidate, plate_from_now=pose)))
    return ranked(fits)
