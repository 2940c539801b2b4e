"""Fits: refined candidates and their rank."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from baselines.registration.search import Candidate
from kit1000.pose import Pose

STIFFNESS = 1.0  # of the contact between the part's lower face and the floor
MISFIT_DECIMALS = 9  # of a metre: fits that differ by less are equal


@dataclass(frozen=True, eq=False)
class Fit:
    """A refined candidate."""

    goal_from_now: Pose
    misfit: float
    """[m] the least is the best; which residuals it adds up is the method's."""
    doubt: float
    """[m] the less, the likelier is it to be seated; may weigh the same residuals differently."""
    candidate: Candidate
    """In the refined pose, for a second refinement."""


def ranked(fits: Iterable[Fit]) -> list[Fit]:
    """The fits, the best first; of equal ones the first stays the first."""
    return sorted(fits, key=lambda fit: round(fit.misfit, MISFIT_DECIMALS))
