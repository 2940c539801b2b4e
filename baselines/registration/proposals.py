"""Registration as a source of proposals: all its fits of a part, for a person to choose among."""

from __future__ import annotations

from baselines.registration.method import Registration, confidence
from kit1000.predictor import PredictedMotion
from kit1000.values import Query, TrueGeometry


class ProposingRegistration(Registration):
    """Registration that hands out all its fits, each with the share of such fits that are seated."""

    def propose(self, query: Query, geometry: TrueGeometry | None = None) -> list[PredictedMotion]:
        """All fits, the best first."""
        return [
            PredictedMotion(fit.goal_from_now, confidence(fit.doubt, self.source, query.sensor))
            for fit in self.fits(query, geometry)
        ]
