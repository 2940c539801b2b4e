"""Dovetail: the male rail or the female bed of a slide, on a screwed base, with or without an end stop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.numerics.trigonometry import tangent
from kit1000.parts import cad
from kit1000.symmetry import Symmetry


@dataclass(frozen=True)
class Dovetail:
    """The slide runs along y, its base stands on the xy plane; all lengths in mm."""

    female: bool
    length: float
    base: float  # width of the base
    base_t: float  # thickness of the base, below a groove too
    neck: float  # narrow width of the dovetail
    rise: float  # height of the dovetail
    flank_deg: float  # of the dovetail's sides against the base
    rail: float  # length of the rail or of the groove's block; less than `length`: a foot stands out at -y
    offset: float  # of the dovetail from the middle of the base, towards +x
    stop: float  # thickness of an end stop at +y, 0: none
    cut: float  # size of the corner cut off at +x +y, 0: none
    holes: int  # in each row of screws
    hole: float
    counterbore: bool
    relief: float  # width of the channel under the base, 0: none

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Dovetail:
        female, length = cad.chance(rng, 0.5), cad.span(rng, 40, 50)
        neck, rise = cad.span(rng, 9, 12), cad.span(rng, 7, 10)
        base = round(neck + 1.3 * rise + cad.span(rng, 18, 22), 1)
        even = cad.chance(rng, 0.3)
        form = "even" if even else cad.pick(rng, "stop", "foot", "offset", "foot and offset", "cut", "cut")
        return cls(
            female=female,
            length=length,
            base=base,
            base_t=cad.span(rng, 5, 7.5),
            neck=neck,
            rise=rise,
            flank_deg=cad.pick(rng, 55.0, 60.0),
            rail=length - (cad.span(rng, 11, 16) if "foot" in form else 0.0),
            offset=cad.span(rng, 6, 7.5) if "offset" in form and not female else 0.0,
            stop=cad.span(rng, 8, 12) if form == "stop" or (form == "offset" and female) else 0.0,
            cut=cad.span(rng, 12, 16) if form == "cut" else 0.0,
            holes=cad.pick(rng, 0, 1, 2, 3),
            hole=cad.span(rng, 3.4, 4.6),
            counterbore=cad.chance(rng, 0.5),
            relief=cad.span(rng, 10, 14) if cad.chance(rng, 0.6) else 0.0,
        )

    def solid(self) -> Manifold:
        slide = cad.box(self.base, self.length, self.base_t)
        slide += cad.at(self._extruded(self._section(), self.rail), y=(self.length - self.rail) / 2)
        if self.stop > 0:
            stop = cad.box(self.base, self.stop, self.base_t + self.rise)
            slide += cad.at(stop, y=(self.length - self.stop) / 2)
        if self.relief > 0:
            slide -= cad.at(cad.box(self.relief, self.length + 2, 2 + 0.35 * self.base_t), z=-2)
        if self.cut > 0:
            x, y, reach = self.base / 2 + 1, self.length / 2 + 1, self.cut + 2
            corner = cad.polygon([(x, y), (x - reach, y), (x, y - reach)])
            slide -= cad.at(cad.prism(corner, 4 * self.base_t + 4 * self.rise), z=-1)
        bore = (1.7 * self.hole, 0.45 * self.base_t) if self.counterbore else None
        mouths = [(x, y, self.base_t) for x, y in self._screws()]
        return cad.drill(slide, self.hole, mouths, counterbore=bore) if mouths else slide

    def symmetry(self) -> Symmetry:
        even = self.rail == self.length and self.offset == self.stop == self.cut == 0
        return Symmetry.cyclic(2, (0, 0, 1)) if even else Symmetry.none()

    def _section(self) -> CrossSection:
        """The dovetail seen along -y, sunk 1 mm into the base; x across, y up."""
        low, high = self.base_t - 1, self.base_t + self.rise
        spread = self.rise / tangent(np.radians(self.flank_deg))
        narrow, wide = self.neck / 2, self.neck / 2 + spread
        if not self.female:
            right = [(narrow, low), (narrow, self.base_t), (wide, high)]
            outline = [*right, *((-x, y) for x, y in reversed(right))]
            return cad.polygon(outline).translate((self.offset, 0))
        half = max(wide + 4, 0.42 * self.base)
        jaws = cad.rectangle(2 * half, high - low).translate((0, (low + high) / 2))
        groove = [(wide, self.base_t), (narrow, high + 0.001), (-narrow, high + 0.001), (-wide, self.base_t)]
        return jaws - cad.polygon(groove)

    def _extruded(self, section: CrossSection, length: float) -> Manifold:
        """A section drawn as (x, z), extruded along y, its middle at y = 0."""
        return cad.at(cad.along(cad.prism(section, length), "-y"), y=length / 2)

    def _screws(self) -> list[tuple[float, float]]:
        """One row in a groove, else one on each side of the rail, or on the side an offset or cut leaves."""
        pitch = (self.length - self.stop - 8) / max(self.holes, 1)
        row = [(0.0, y - self.stop / 2) for _, y in cad.grid(1, self.holes, 0, pitch)]
        if self.female:
            return row
        clear = self.offset - self.neck / 2 - self.rise / tangent(np.radians(self.flank_deg))
        x = float(clear - self.base / 2) / 2
        return [(side * x, y) for side in ((1,) if self.offset or self.cut else (1, -1)) for _, y in row]
