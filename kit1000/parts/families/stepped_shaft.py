"""Stepped shafts: journals, a collar, and where it carries torque an eccentric, a cut collar or a crank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import Manifold, Symmetry


@dataclass(frozen=True)
class SteppedShaft:
    """The shaft stands along z: lower journal, collar, upper journal, smaller end. The collar's mark is at +x."""

    kind: str  # plain, cut, eccentric or crank
    lower: float
    lower_length: float
    collar: float
    collar_width: float
    upper: float
    upper_length: float
    end: float
    end_length: float  # 0 for a shaft without the smaller end
    bore: float  # hole along the axis, 0 for a full shaft
    mark: float  # depth of the cut, offset of the eccentric or reach of the crank
    key: float  # width of the key seat in the upper journal, 0 for none
    chamfer: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> SteppedShaft:
        kind = cad.pick(rng, "plain", "cut", "cut", "cut", "eccentric", "crank")
        lower = cad.span(rng, 8, 16)
        wider = {"cut": (14, 20), "crank": (4, 8)}.get(kind, (9, 18))
        collar = lower + cad.span(rng, *wider)
        mark = {
            "cut": (collar - lower) / 2 - 0.5,
            "eccentric": max(6, 0.25 * collar),
            "crank": cad.span(rng, 14, 24),
        }.get(kind, 0.0)
        upper = round(cad.span(rng, 0.7, 1.2, 0.05) * lower, 1)
        end = round(cad.span(rng, 0.55, 0.7, 0.05) * lower, 1) if cad.chance(rng, 0.5) else 0.0
        turned = kind == "plain"
        keyed = not turned and cad.chance(rng, 0.45)
        bore = min(upper, end or upper, lower) - cad.span(rng, 3.6, 5)  # leaves walls of 1.8 mm and more
        return cls(
            kind=kind,
            lower=lower,
            lower_length=cad.span(rng, 8, 18) if turned else cad.span(rng, 2.5, 7),
            collar=collar,
            collar_width=cad.span(rng, 5, 10),
            upper=upper,
            upper_length=cad.span(rng, 4, 14) if turned else cad.span(rng, 9, 20),
            end=min(end, 0.85 * upper),
            end_length=cad.span(rng, 4, 9) if end else 0.0,
            bore=bore if bore > 2 and not keyed and cad.chance(rng, 0.6) else 0.0,
            mark=mark,
            key=round(cad.span(rng, 0.25, 0.3, 0.01) * upper, 2) if keyed else 0.0,
            chamfer=cad.span(rng, 0.4, 1.0),
        )

    def solid(self) -> Manifold:
        body = cad.join(cad.revolved(self._journals()), self._collar())
        if self.key > 0:
            length = 0.7 * self.upper_length
            middle = self.lower_length + self.collar_width + 1 + length / 2
            seat = cad.slot(length, self.key).rotate(90)
            body = cad.pocket(body, seat, 0.5 * self.key, (self.upper / 2, 0, middle), "x")
        return cad.drill(body, self.bore) if self.bore > 0 else body

    def symmetry(self) -> Symmetry:
        if self.kind != "plain":
            return cad.none()
        return cad.free() if not self._even else cad.free_flipped()

    @property
    def _even(self) -> bool:
        return self.lower == self.upper and self.lower_length == self.upper_length and self.end_length == 0

    def _journals(self) -> list[tuple[float, float]]:
        """(r, z) of everything that is round about the axis, z = 0 at the foot."""
        c, top = self.chamfer, self.lower_length + self.collar_width + self.upper_length
        low, high, end = self.lower / 2, self.upper / 2, self.end / 2
        waist = self.lower_length + 0.5 * self.collar_width
        loop = [(0, 0), (low - c, 0), (low, c), (low, waist), (high, waist)]
        if self.end_length > 0:
            tip = top + self.end_length
            return [*loop, (high, top), (end, top), (end, tip - c), (end - c, tip), (0, tip)]
        return [*loop, (high, top - c), (high - c, top), (0, top)]

    def _collar(self) -> Manifold:
        disc = cad.circle(self.collar)
        if self.kind == "cut":
            disc -= cad.rectangle(self.collar, 2 * self.collar).translate((self.collar - self.mark, 0))
        elif self.kind == "eccentric":
            disc = disc.translate((self.mark, 0))
        elif self.kind == "crank":
            disc = cad.hull_2d(disc, cad.circle(0.8 * self.collar).translate((self.mark, 0)))
        plate = cad.prism(disc, self.collar_width, chamfer=min(self.chamfer, 0.6))
        if self.kind == "crank":
            plate = cad.drill(plate, 0.4 * self.collar, (self.mark, 0))
        return cad.at(plate, z=self.lower_length)
