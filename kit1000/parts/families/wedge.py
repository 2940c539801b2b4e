"""Angle blocks: ramps, V-blocks and sloped feet, holed, pocketed or opened from the side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import CrossSection, Manifold, Symmetry


@dataclass(frozen=True)
class Wedge:
    """A profile in the xz plane, the foot on z = 0, extruded along y and centred in it."""

    kind: str  # ramp, vee or trapezoid
    length: float
    height: float
    width: float
    land: float  # flat at the top
    heel: float  # height of the lower end
    toe: float  # length of the foot plate beyond the slope, 0 for none
    hole: float
    holes: int
    window: float  # opening from side to side, wall left around it; 0 for none
    pocket: float  # opening from below, wall left around it; 0 for none
    notch: float  # width of a slot along the slope, 0 for none

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Wedge:
        kind = cad.pick(rng, "ramp", "ramp", "trapezoid", "vee")
        length = cad.span(rng, 30, 46)
        opened = cad.pick(rng, "no", "no", "window", "window", "pocket") if kind != "vee" else "no"
        return cls(
            kind=kind,
            length=length,
            height=cad.span(rng, 16, 34),
            width=cad.span(rng, 14, 34),
            land=cad.span(rng, 4, 10) if kind != "vee" else cad.span(rng, 3, 6),
            heel=cad.span(rng, 3, 8),
            toe=cad.span(rng, 9, 14) if kind == "ramp" and cad.chance(rng, 0.5) else 0.0,
            hole=cad.span(rng, 3, 6),
            holes=cad.pick(rng, 0, 0, 1, 2),
            window=cad.span(rng, 2.1, 3.8) if opened == "window" else 0.0,
            pocket=cad.span(rng, 2, 3.2) if opened == "pocket" else 0.0,
            notch=cad.span(rng, 0.25, 0.45, 0.05)
            if kind != "vee" and opened != "pocket" and cad.chance(rng, 0.35)
            else 0.0,
        )

    def solid(self) -> Manifold:
        profile = self._profile()
        if self.window > 0:
            profile -= self._opening(profile)
        body = cad.at(
            cad.along(cad.prism(profile, self.width, chamfer=0.4 if self.window == 0 else 0), "-y"), y=self.width / 2
        )
        if self.pocket > 0:
            body -= self._hollow()
        if self.notch > 0:
            body = self._notched(body)
        return self._drilled(body)

    def symmetry(self) -> Symmetry:
        return cad.cyclic(2) if self.kind == "vee" else cad.none()

    def _profile(self) -> CrossSection:
        left, right, top = -self.length / 2, self.length / 2, self.height
        if self.kind == "vee":
            half = self.length / 2 - self.land
            deep = min(half, top - 8)
            block = cad.rectangle(self.length, top).translate((0, top / 2))
            relief = cad.rectangle(3, 3).translate((0, top - deep))
            return block - cad.polygon([(-half, top), (0, top - deep), (half, top)]) - relief
        foot = [(left, 0), (right, 0), (right, self.heel)]
        if self.kind == "trapezoid":
            return cad.polygon([*foot, (left + 4 + self.land, top), (left + 4, top), (left, 0.5 * self.heel)])
        step = [(right - self.toe, self.heel), (right - self.toe, self.heel + 2)] if self.toe > 0 else []
        return cad.polygon([*foot, *step, (left + self.land, top), (left, top)])

    def _opening(self, profile: CrossSection) -> CrossSection:
        """What a window takes away: the profile without a frame, its corners rounded."""
        return cad.rounded(profile.offset(-self.window), 1.5)

    def _hollow(self) -> Manifold:
        inside = self._profile().offset(-self.pocket)
        inside = inside + inside.translate((0, -self.pocket - 1))
        width = self.width - 2 * self.pocket
        return cad.at(cad.along(cad.prism(inside, width), "-y"), y=width / 2)

    def _notched(self, body: Manifold) -> Manifold:
        """An adjusting slot open at the low end."""
        cut = cad.slot(0.7 * self.length, self.notch * self.width)
        return cad.pocket(body, cut, None, (self.length / 2, 0, 0))

    def _drilled(self, body: Manifold) -> Manifold:
        """Screws down through the block, their heads sunk to leave a floor."""
        if self.holes == 0 or (self.notch > 0 and self.kind != "vee"):
            return body
        x = 0.0 if self.kind == "vee" else -0.1 * self.length
        spread = self.width / 4 if self.holes == 2 and self.width > 4 * self.hole else 0.0
        points = [(x, spread, 4.0), (x, -spread, 4.0)] if spread else [(x, 0.0, 4.0)]
        head = None if self.kind == "vee" else (min(1.8 * self.hole, 0.4 * self.width), 0.0)
        return cad.drill(body, self.hole, points, counterbore=head)
