"""Frames: thin-walled rings and bezels with mounting ears, a bar across, a lip and a cable gate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import CrossSection, Manifold, Symmetry


@dataclass(frozen=True)
class Frame:
    """A closed wall around an opening, standing on z = 0; the first ear reaches out at +y."""

    outline: str  # box, rounded, house or dee
    x: float
    y: float
    height: float
    wall: float
    ears: int  # 1: at +y, 2: another at -y further to -x, 0: a bezel without ears
    ear: float  # diameter of an ear
    ear_height: float  # at least half of the wall, so that it shows whichever side is up
    screw: float
    bar: float  # width of the bar across, 0 for none
    bar_at: float  # its place, as a part of the half length x
    lip: float  # how far a lip at the foot reaches into the opening, 0 for none
    gate: float  # width of the gate cut into the upper rim of the wall at +y, 0 for none
    windows: int  # round openings in the wall at -y

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Frame:
        x = cad.span(rng, 32, 46)
        height = cad.span(rng, 8, 11) if cad.chance(rng, 0.5) else cad.span(rng, 12, 26)
        ear = cad.span(rng, 8, 11)
        outline = cad.pick(rng, "box", "rounded", "house", "dee")
        ears = cad.pick(rng, 1, 2) if outline in ("box", "rounded") else cad.pick(rng, 0, 1, 2)
        return cls(
            outline=outline,
            x=x,
            y=round(cad.span(rng, 0.5, 0.85, 0.01) * x, 1),
            height=height,
            wall=cad.span(rng, 1.9, 2.6),
            ears=ears,
            ear=ear,
            ear_height=round(cad.span(rng, 0.5, 0.65, 0.05) * height, 1) if cad.chance(rng, 0.5) else height,
            screw=cad.span(rng, 3, 4.2),
            bar=cad.span(rng, 2, 4) if ears and cad.chance(rng, 0.4) else 0.0,
            bar_at=cad.span(rng, -0.3, 0.3, 0.05),
            lip=cad.span(rng, 1.5, 3) if ears and cad.chance(rng, 0.4) else 0.0,
            gate=cad.span(rng, 7, 12) if ears and cad.chance(rng, 0.5) else 0.0,
            windows=cad.pick(rng, 0, 1, 2) if ears else 0,
        )

    def solid(self) -> Manifold:
        outer, inner = self._outline(), self._outline().offset(-self.wall)
        body = cad.prism(outer - inner, self.height)
        extra = []
        if self.lip > 0:
            extra.append(cad.prism(outer - inner.offset(-self.lip), 1.9))
        if self.bar > 0:
            across = cad.rectangle(self.bar, 2 * self.y).translate((self.bar_at * self.x / 2, 0)) ^ outer
            extra.append(cad.prism(across, min(0.6 * self.height, 8)))
        extra += [cad.prism(ear - outer.offset(-0.5 * self.wall), self.ear_height) for ear in self._ears()]
        body = cad.join(body, *extra)
        for x, y in self._screws():
            body = cad.drill(body, self.screw, (x, y))
        return self._opened(body)

    def symmetry(self) -> Symmetry:
        return cad.none() if self.ears else cad.cyclic(2, (1, 0, 0))  # a bezel is bare

    def _outline(self) -> CrossSection:
        x, y = self.x, self.y
        if self.outline == "box":
            return cad.rectangle(x, y, 1.0)
        if self.outline == "rounded":
            return cad.rectangle(x, y, 0.28 * y)
        if self.outline == "house":
            gable = cad.polygon([(-x / 2, -y / 2), (0.2 * x, -y / 2), (x / 2, 0), (0.2 * x, y / 2), (-x / 2, y / 2)])
            return cad.rounded(gable, 2)
        return cad.hull_2d(
            cad.rectangle(x / 2, y, 1).translate((-x / 4, 0)), cad.circle(y).translate((x / 2 - y / 2, 0))
        )

    def _screws(self) -> list[tuple[float, float]]:
        """Centres of the ears: they stand clear of the wall."""
        aside = self.y / 2 + self.ear / 2 - 1
        first = (0.12 * self.x, aside)
        return [first, (-0.34 * self.x, -aside)][: self.ears]

    def _ears(self) -> list[CrossSection]:
        return [
            cad.hull_2d(
                cad.circle(self.ear).translate(place),
                cad.rectangle(self.ear + 4, 2).translate((place[0], np.sign(place[1]) * (self.y / 2 - 1))),
            )
            for place in self._screws()
        ]

    def _opened(self, body: Manifold) -> Manifold:
        if self.gate > 0:
            gate = cad.at(cad.box(self.gate, 3 * self.wall, self.height), -0.2 * self.x, self.y / 2, 0.45 * self.height)
            body -= gate
        pitch = 0.22 * self.x
        for k in range(self.windows):
            d = min(0.5 * self.height, 0.6 * pitch)
            place = (0.1 * self.x - k * pitch, 0, 0.55 * self.height)
            tool = cad.at(cad.along(cad.prism(cad.circle(d), self.y / 2 + 9), "-y"), *place)
            body -= tool
        return body
