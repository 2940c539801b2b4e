"""Fits: refined candidates, their rank, and how far the best one is ahead."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kit1000.numerics.linear_algebra import length
from kit1000.pose import Pose
from kit1000.registration.search.correlation import Candidate

STIFFNESS = 1.0  # of the contact between the part's lower face and the floor
MISFIT_DECIMALS = 9  # of a metre: fits that differ by less are equal
SAME_DISTANCE, SAME_ANGLE = 1e-3, np.radians(3)  # [m], [rad] within which two poses are one
LARGEST_LEAD = 5e-3  # [m]


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


def moved(fit: Fit, goal_from_now: Pose) -> Fit:
    """A fit with another motion; its misfit and doubt stay."""
    plate_from_now = fit.candidate.cavity.world_from_plate.inverse() @ goal_from_now
    return replace(fit, goal_from_now=goal_from_now, candidate=replace(fit.candidate, plate_from_now=plate_from_now))


def ranked(fits: Iterable[Fit]) -> list[Fit]:
    """The fits, the best first; of equal ones the first stays the first."""
    return sorted(fits, key=lambda fit: round(fit.misfit, MISFIT_DECIMALS))


def least_misfit(fits: Iterable[Fit]) -> float:
    """[m] the misfit of the best fit, on the grid on which fits are ranked; infinite where there is none."""
    return min((round(fit.misfit, MISFIT_DECIMALS) for fit in fits), default=np.inf)


def same_pose(a: Pose, b: Pose, point: np.ndarray) -> bool:
    """Whether two motions move a point (3,) [m] to one place and differ little in rotation."""
    near = length(a.apply(point) - b.apply(point)) < SAME_DISTANCE
    return bool(near and (a @ b.inverse()).angle() < SAME_ANGLE)


def lead(fit: Fit, fits: Sequence[Fit], point: np.ndarray) -> float:
    """[m] by which the misfit of a fit is less than the least of those in other poses; negative if it is more.

    LARGEST_LEAD at most, and where there is no other. point: (3,) [m] of the part now.
    """
    others = [other.misfit for other in fits if not same_pose(other.goal_from_now, fit.goal_from_now, point)]
    return min(min(others, default=np.inf) - fit.misfit, LARGEST_LEAD)
