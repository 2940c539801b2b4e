"""Registration as a source of proposals: all its fits of a part, for a person to choose among."""

from __future__ import annotations

from baselines.catalog import WEIGHTS
from baselines.registration.method import Registration
from kit1000.dataset.reader import Dataset
from kit1000.predictor import PredictedMotion
from kit1000.values import Query, TrueGeometry


class ProposingRegistration(Registration):
    """Registration that hands out all its fits, each with the share of such fits that are seated."""

    def propose(self, query: Query, geometry: TrueGeometry | None = None) -> list[PredictedMotion]:
        """All fits, the best first."""
        return self.motions(query, geometry)


class CompletingRegistration(ProposingRegistration):
    """The same with networks that complete the part and restore noisy images, as `registration-completed`."""

    def __init__(self, dataset: Dataset) -> None:
        super().__init__(
            dataset,
            completion=WEIGHTS / "completion",
            noisy_completion=WEIGHTS / "completion-d415",
            restoration=WEIGHTS / "restoration",
        )
