"""Which plate a part belongs to: the posterior over all assignments of the parts of a scene to its plates.

Without a guess a part may fit another plate nearly as well as its own. Each kit is for one part, and the image shows
all parts. So a plate that another part fits far better is not this part's. Of the other parts it is unknown whether
they lie as they are inserted; where they do not, their misfits say nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import compress

import numpy as np

from kit1000.numerics.linear_algebra import length
from kit1000.registration.choice.fits import Fit
from kit1000.registration.geometry.observed_cavity import VOXEL, Cavity
from kit1000.sim.layout import UPRIGHT_SHARE

DOUBTFUL = 1e-3  # [m] of misfit: while a fit in another plate has less than so much more, other parts are asked
MOST_PLATES = 12  # that are told apart: the sums are over all sets of them
APART = 0.03  # [m] between the middles of cavities in different plates
RIGHT = {
    "ideal": (2.95e-3, 0.29e-3),
    "photoneo": (3.2e-3, 0.4e-3),
    "d415": (4.6e-3, 1.1e-3),
    "restored": (3.9e-3, 0.6e-3),
}
"""Logistic curve of each kind of image: the misfit [m] at which a plate is as likely the right one as not, and the
spread, fitted to the places of the split val."""
NO_FIT = -2.0  # log odds of a plate in which no fit was refined: the image contradicts all of them


def assigned(fits: Sequence[Fit], others: Iterable[Sequence[Fit]], kind: str) -> list[Fit]:
    """The fits of a part, the best first; first of all those in the plate that the part most likely belongs to.

    Args:
        fits: of the part, the best first.
        others: those of each other part of the scene; read only where two plates fit about as well.
        kind: of the image, in RIGHT.
    """
    nearest = np.sort(least_misfits(fits, _middles(fits)))[:2]
    if len(nearest) < 2 or nearest[1] - nearest[0] > DOUBTFUL:
        return list(fits)
    parts = [fits, *others]
    middles = _middles([fit for part in parts for fit in part])[:MOST_PLATES]
    half, spread = RIGHT[kind]
    misfits = np.stack([least_misfits(part, middles) for part in parts])
    posterior = plate_posterior(np.where(np.isfinite(misfits), (half - misfits) / spread, NO_FIT))
    best = int(np.argmax(np.where(np.isfinite(misfits[0]), posterior, -1.0)))
    there = [_plate(fit.candidate.cavity, middles) == best for fit in fits]
    return [*compress(fits, there), *compress(fits, np.logical_not(there))]


def plate_posterior(odds: np.ndarray) -> np.ndarray:
    """(plates,) the probability of each plate to be that of the first part; the rest is that of plates not found.

    odds: (parts, plates) log odds by the misfits of each part alone. Those of the other parts count as far as these
    are likely to lie as they are inserted.
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


def least_misfits(fits: Sequence[Fit], middles: Sequence[np.ndarray]) -> np.ndarray:
    """(plates,) [m] the least misfit of the fits in each plate; infinite where there is none."""
    least = np.full(len(middles), np.inf)
    for fit in fits:
        plate = _plate(fit.candidate.cavity, middles)
        if plate is not None:
            least[plate] = min(least[plate], fit.misfit)
    return least


def _middles(fits: Sequence[Fit]) -> list[np.ndarray]:
    """(3,) [m] world, each: the middles of the cavities of the fits, one for each plate."""
    middles: list[np.ndarray] = []
    for fit in fits:
        if _plate(fit.candidate.cavity, middles) is None:
            middles.append(_middle(fit.candidate.cavity))
    return middles


def _plate(cavity: Cavity, middles: Sequence[np.ndarray]) -> int | None:
    """The first of the plates whose cavity is this one, as found for any part; None where there is none."""
    middle = _middle(cavity)
    return next((plate for plate, other in enumerate(middles) if length(middle - other) < APART), None)


def _middle(cavity: Cavity) -> np.ndarray:
    """(3,) [m] world: of a cavity, on the face of its plate."""
    cells = np.argwhere(cavity.region).mean(0) - (len(cavity.region) - 1) / 2
    return cavity.world_from_plate.apply(np.append(cells * VOXEL, 0.0))
