"""Where parts may snap: all fits that a method proposes, and of those the ones near the hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.editor.session import PartEdit, distance, same_motion
from kit1000.pose import Pose
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET

SAME_POSITION, SAME_ANGLE = 1e-3, float(np.radians(1.5))  # [m], [rad] of two fits that a person cannot tell apart
LET_GO_POSITION, LET_GO_ANGLE = 5e-3, float(np.radians(5))  # [m], [rad] from a fit: letting go there takes it


@dataclass(frozen=True, eq=False)
class Proposal:
    """A fit that a method proposes."""

    goal_from_now: Pose
    confidence: float  # 0 to 1: the share of such fits that are seated


@dataclass
class PartProposals:
    """All that a method has proposed for a part."""

    pivot: np.ndarray  # (3,) [m] of the part at its recorded pose
    found: Sequence[Proposal] | None = None  # without a guess; None until they are known
    answers: Sequence[Proposal] = ()  # to the latest guess
    guess: Pose | None = None  # that guess
    failure: str = ""  # why there are none

    def near(self, edit: PartEdit) -> list[Proposal]:
        """The fits within reach of the hand, the best first, no two alike.

        A part that the hand has turned is snapped as the method answers to that guess, then onto fits in about that
        rotation; one that it has only moved, onto the surest fit in any rotation.
        """
        hand = edit.goal_from_now
        answers = self.answers if self.guess is not None and same_motion(hand, self.guess) else ()
        reached = [fit for fit in (*answers, *(self.found or ())) if _within_reach(fit, hand, self.pivot)]
        ranked = sorted(reached, key=lambda fit: -fit.confidence)
        if edit.turned:
            first = [fit for fit in answers[:1] if fit in reached]
            ranked.sort(key=lambda fit: _angle(fit, hand) > MAX_ANGLE)
            ranked = [*first, *ranked]
        return distinct(ranked, self.pivot)

    def best(self) -> Proposal | None:
        """The surest fit found without a guess."""
        return max(self.found or (), key=lambda fit: fit.confidence, default=None)


def distinct(proposals: Iterable[Proposal], pivot: np.ndarray) -> list[Proposal]:
    """The proposals without those that differ from an earlier one by less than a person can tell. pivot: (3,) [m]."""
    kept: list[Proposal] = []
    for proposal in proposals:
        differences = (distance(proposal.goal_from_now, other.goal_from_now, pivot) for other in kept)
        if not any(shift < SAME_POSITION and angle < SAME_ANGLE for shift, angle in differences):
            kept.append(proposal)
    return kept


def takes_by_letting_go(proposal: Proposal, edit: PartEdit, pivot: np.ndarray) -> bool:
    """Whether the hand has let go so near to a fit that it means it. pivot: (3,) [m]."""
    shift, angle = distance(proposal.goal_from_now, edit.goal_from_now, pivot)
    return shift <= LET_GO_POSITION and angle <= LET_GO_ANGLE


def _within_reach(proposal: Proposal, hand: Pose, pivot: np.ndarray) -> bool:
    """Whether a fit takes the pivot to within the largest offset of a guess, along each axis."""
    apart = proposal.goal_from_now.apply(pivot) - hand.apply(pivot)
    return bool(np.abs(apart).max() <= MAX_OFFSET)


def _angle(proposal: Proposal, hand: Pose) -> float:
    return float((proposal.goal_from_now @ hand.inverse()).angle())
