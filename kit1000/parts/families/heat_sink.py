"""Heat sinks: straight fins or rows of pins on a base plate with mounting ears."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import Manifold, Symmetry


@dataclass(frozen=True)
class HeatSink:
    """Fins stand along y on a base x by y; the base reaches past them by an ear at +x."""

    fins: int
    fin: float  # thickness of a fin
    gap: float
    length: float  # of the fins, along y
    base: float  # thickness of the base
    height: float  # of the fins above the base
    ear: float  # how far the base reaches out at +x
    ear_width: float  # of that ear, as a part of the length; the ear sits at the end of -y
    screw: float  # 0 for a sink that is glued
    rows: int  # cross cuts that make pins of the fins, 0 for plain fins
    low: int  # how many fins at -x are cut down to half their height
    shelf: float  # how far the fins end before the base at -y, 0 for full length

    @classmethod
    def draw(cls, rng: np.random.Generator) -> HeatSink:
        fin, gap = cad.span(rng, 1.8, 2.4), cad.span(rng, 2.2, 4.0)
        fins = max(4, int(cad.span(rng, 22, 34) / (fin + gap)))
        return cls(
            fins=fins,
            fin=fin,
            gap=gap,
            length=cad.span(rng, 20, 42),
            base=cad.span(rng, 2, 5),
            height=cad.span(rng, 7, 20),
            ear=cad.span(rng, 8, 14),
            ear_width=cad.span(rng, 0.35, 0.65, 0.05),
            screw=cad.pick(rng, 0.0, cad.span(rng, 3, 4.2)),
            rows=cad.pick(rng, 0, 0, 0, 2, 3),
            low=cad.pick(rng, 0, 0, 1, 2),
            shelf=cad.span(rng, 6.5, 10) if cad.chance(rng, 0.4) else 0.0,
        )

    def solid(self) -> Manifold:
        x, y = self._width, self.length
        foot = cad.rectangle(x, y, 1)
        ear_y = self.ear_width * y
        foot += cad.rectangle(self.ear + 2, ear_y, 2).translate((x / 2 + self.ear / 2 - 1, (ear_y - y) / 2))
        if self.screw > 0:
            foot -= cad.circle(self.screw).translate((x / 2 + self.ear / 2, (ear_y - y) / 2))
        body = cad.join(cad.prism(foot, self.base), *self._fins())
        for k in range(self.rows):
            place = (0, (k + 1) * y / (self.rows + 1) - y / 2, self.base)
            body -= cad.at(cad.box(x + 1, self.gap, self.height + 1), *place)
        return body

    def symmetry(self) -> Symmetry:
        return cad.none()

    @property
    def _width(self) -> float:
        return self.fins * self.fin + (self.fins - 1) * self.gap

    def _fins(self) -> list[Manifold]:
        pitch, length = self.fin + self.gap, self.length - self.shelf
        fins = []
        for k in range(self.fins):
            tall = self.height * (0.5 if k < self.low else 1.0)
            place = (k * pitch + self.fin / 2 - self._width / 2, self.shelf / 2, 0)
            fins.append(cad.at(cad.box(self.fin, length, self.base + tall), *place))
        return fins
