"""Bushings, spacers and collars: turned sleeves, clamping collars with ears, and sleeves on a two-flat flange."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import Manifold, Symmetry


@dataclass(frozen=True)
class Bushing:
    """A sleeve about z standing on z = 0; ears and set-screw bosses point to +x."""

    kind: str  # turned, clamp, flats or boss
    d: float
    bore: float
    length: float
    flange: float  # diameter of the flange at the foot, 0 for none
    flange_thickness: float
    relief: float  # wider diameter in the middle of the bore (turned), 0 for none
    reach: float  # how far ears or boss stand out of the sleeve
    slit: float
    screw: float
    slots: int  # slots across the upper end of a sleeve with two flats

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Bushing:
        kind = cad.pick(rng, "turned", "clamp", "clamp", "flats", "boss")
        d = cad.span(rng, 18, 32)
        flanged = kind in ("turned", "flats", "boss") and (kind == "flats" or cad.chance(rng, 0.55))
        length = cad.span(rng, 14, 38) if kind != "clamp" else cad.span(rng, 9, 18)
        return cls(
            kind=kind,
            d=d,
            bore=cad.span(rng, 0.4, 0.78, 0.01) * d if kind != "boss" else cad.span(rng, 0.4, 0.6, 0.01) * d,
            length=length,
            flange=d + (cad.span(rng, 16, 20) if kind == "flats" else cad.span(rng, 6, 13)) if flanged else 0.0,
            flange_thickness=cad.span(rng, 2, 4),
            relief=cad.span(rng, 0.25, 0.6, 0.05) if kind == "turned" and cad.chance(rng, 0.4) else 0.0,
            reach=cad.span(rng, 8, 13),
            slit=cad.span(rng, 2, 3),
            screw=cad.span(rng, 3, 5),
            slots=cad.pick(rng, 0, 1) if kind == "flats" else 0,
        )

    def solid(self) -> Manifold:
        return {"turned": self._turned, "clamp": self._clamp, "flats": self._flats, "boss": self._boss}[self.kind]()

    def symmetry(self) -> Symmetry:
        if self.kind == "turned":
            return cad.free() if self.flange > 0 else cad.free_flipped()
        if self.kind == "clamp":
            return cad.cyclic(2, (1, 0, 0))
        return cad.cyclic(2) if self.kind == "flats" else cad.none()

    def _sleeve(self) -> Manifold:
        """The turned body, flange included, without bore."""
        r, c, h = self.d / 2, 0.06 * self.d, self.length
        if self.flange == 0:
            return cad.revolved([(0, 0), (r - c, 0), (r, c), (r, h - c), (r - c, h), (0, h)])
        f, t = self.flange / 2, self.flange_thickness
        return cad.revolved([(0, 0), (f, 0), (f, t), (r, t), (r, h - c), (r - c, h), (0, h)])

    def _turned(self) -> Manifold:
        sleeve = cad.drill(self._sleeve(), self.bore)
        if self.relief == 0:
            return sleeve
        wide, margin = self.bore + self.relief * (self.d - self.bore), 0.22 * self.length
        groove = [(0, margin), (wide / 2, margin), (wide / 2, self.length - margin), (0, self.length - margin)]
        return sleeve - cad.revolved(groove)

    def _clamp(self) -> Manifold:
        """A collar slit at +x between two ears that one screw pulls together."""
        outer, tip = self.d / 2, self.d / 2 + self.reach
        ear = self.slit + 2 * max(4.0, 0.22 * self.d)
        body = cad.circle(self.d) + cad.rectangle(tip, ear, 1.5).translate((tip / 2, 0))
        body -= cad.circle(self.bore) + cad.rectangle(2 * tip, self.slit).translate((tip, 0))
        collar = cad.prism(body, self.length, chamfer=0.6)
        screw = min(self.screw, self.reach - 4, self.length - 5)
        return cad.drill(collar, screw, (outer + self.reach / 2 + 0.5, 0, self.length / 2), "y")

    def _flats(self) -> Manifold:
        """The flange milled to two flats as wide as the sleeve."""
        keep = cad.rectangle(self.flange + 2, self.d + 0.5)
        sleeve = cad.drill(self._sleeve() ^ cad.prism(keep, 100), self.bore)
        reach = (self.flange + self.d) / 4
        sleeve = cad.drill(sleeve, min(self.screw, (self.flange - self.d) / 2 - 3.5), [(reach, 0), (-reach, 0)])
        if self.slots == 0:
            return sleeve
        return cad.pocket(sleeve, cad.rectangle(2 * self.flange, 0.2 * self.d), 0.25 * self.length, (0, 0, self.length))

    def _boss(self) -> Manifold:
        """A sleeve with a block for the set screw along its whole length."""
        outline = cad.hull_2d(
            cad.circle(0.7 * self.d), cad.rectangle(1, 0.5 * self.d).translate((self.d / 2 + self.reach - 0.5, 0))
        )
        body = cad.join(self._sleeve(), cad.prism(outline, self.length))
        body = cad.drill(body, self.bore)
        return cad.drill(body, self.screw, (self.d, 0, 0.5 * self.length + 2), "x", depth=self.d)
