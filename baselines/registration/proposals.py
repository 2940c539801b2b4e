"""Registration as a source of proposals: all its fits of a part, for a person to choose among."""

from __future__ import annotations

from typing import Any

from baselines.catalog import weight_paths
from baselines.registration import METHODS
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
        weights: dict[str, Any] = weight_paths(METHODS["registration-completed"].weights)
        super().__init__(dataset, **weights)
