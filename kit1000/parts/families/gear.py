"""Gears: spur gears with a plain bore, sector gears with a hub arm, and racks.

A keyway or lightening holes would spoil the exact symmetry of a full wheel without showing in its outline, so they
belong to the sector gears, whose outline differs at every angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import CrossSection, Manifold, Symmetry


@dataclass(frozen=True)
class Gear:
    """A wheel about z standing on z = 0; a sector is symmetric about +x, a rack runs along x."""

    kind: str  # spur, sector or rack
    teeth: int
    module_mm: float
    width: float
    bore: float  # 0 for a pinion cut on its shaft
    hub: float
    hub_height: float  # how far the hub stands above the web, 0 for none
    recess: float  # depth of the turned recess in the web from both sides, 0 for none
    sweep_deg: float  # angle of a sector's toothed rim
    lightening: int  # openings in the web of a sector, screw holes of a rack
    key: float  # width of the keyway of a sector, 0 for none
    chamfer: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Gear:
        kind = cad.pick(rng, "spur", "spur", "sector", "sector", "rack")
        teeth = {"spur": int(rng.integers(18, 29)), "sector": int(rng.integers(24, 40))}.get(kind, 60)
        module = {"spur": cad.span(rng, 38, 44) / teeth, "sector": cad.span(rng, 56, 70) / teeth}.get(
            kind, cad.span(rng, 1, 2.2)
        )
        hub = cad.span(rng, 12, 18)
        return cls(
            kind=kind,
            teeth=teeth,
            module_mm=round(module, 3),
            width=cad.span(rng, 5, 12) if kind != "rack" else cad.span(rng, 8, 14),
            bore=cad.span(rng, 0.4, 0.65, 0.01) * hub if kind != "spur" or cad.chance(rng, 0.6) else 0.0,
            hub=hub,
            hub_height=cad.span(rng, 4, 14) if kind != "rack" and cad.chance(rng, 0.65) else 0.0,
            recess=cad.span(rng, 1, 2) if kind == "spur" and cad.chance(rng, 0.5) else 0.0,
            sweep_deg=cad.span(rng, 55, 110, 1),
            lightening=int(rng.integers(0, 4)),
            key=cad.span(rng, 2.5, 4) if kind == "sector" and cad.chance(rng, 0.5) else 0.0,
            chamfer=cad.span(rng, 0.3, 0.6) if cad.chance(rng, 0.5) else 0.0,
        )

    def solid(self) -> Manifold:
        if self.kind == "rack":
            return self._rack()
        wheel = cad.prism(self._wheel(), self.width, chamfer=0.0)
        if self.recess > 0:
            web = cad.circle(self._root - 3) - cad.circle(self.hub)
            for z in (-1, self.width - self.recess):
                wheel -= cad.at(cad.prism(web, self.recess + 1), z=z)
        body = cad.join(wheel, cad.at(cad.cylinder(self.hub, self.width + self.hub_height, self.chamfer)))
        if self.bore == 0:
            return body
        opening = cad.bore(self.bore, self.key, 0.4 * self.key)
        return body - cad.at(cad.prism(opening, 100), z=-1)

    def symmetry(self) -> Symmetry:
        if self.kind == "spur":
            return cad.cyclic(self.teeth) if self.hub_height > 0 else cad.dihedral(self.teeth)
        if self.kind == "sector" and self.hub_height == 0:
            return cad.cyclic(2, (1, 0, 0))
        return cad.none()

    @property
    def _root(self) -> float:
        """Root diameter."""
        return (self.teeth - 2.5) * self.module_mm

    def _wheel(self) -> CrossSection:
        wheel = cad.gear(self.teeth, self.module_mm)
        if self.kind == "spur":
            return wheel
        rim = cad.sector(3 * self._root, -self.sweep_deg / 2, self.sweep_deg / 2)
        inner = cad.circle(self._root - 7)
        arm = cad.hull_2d(cad.circle(self.hub + 2), inner ^ rim) ^ cad.circle(self._root - 4)
        plate = ((wheel - inner) ^ rim) + arm
        return plate - self._openings()

    def _openings(self) -> CrossSection:
        """Lightening holes of a sector between hub and rim."""
        inner, outer = self.hub / 2 + 1 + 2.5, self._root / 2 - 3.5 - 2
        d = min(outer - inner, 9.0)
        if self.lightening == 0 or d < 3:
            return CrossSection()
        middle = (inner + outer) / 2
        step = np.degrees((d + 2) / middle)
        usable = max(self.sweep_deg - np.degrees((d + 4) / middle), 0)
        n = min(self.lightening, 1 + int(usable / step))
        angles = (np.arange(n) - (n - 1) / 2) * step
        points = [cad.bolt_circle(2 * middle, 1, float(angle))[0] for angle in angles]
        return cad.holes(d, points)

    def _rack(self) -> Manifold:
        """Straight teeth towards +y on a bar, with a foot plate for screws towards -y that starts at one end."""
        pitch, depth, back = np.pi * self.module_mm, 2.25 * self.module_mm, 5.0
        count = max(4, int(38 / pitch))
        length = count * pitch
        tooth = np.array([(-0.43 * pitch, 0), (-0.13 * pitch, depth), (0.13 * pitch, depth), (0.43 * pitch, 0)])
        teeth = [cad.polygon(tooth + ((k - (count - 1) / 2) * pitch, 0)) for k in range(count)]
        bar = cad.rectangle(length, back).translate((0, 0.01 - back / 2)) + CrossSection.compose(teeth)
        long = length * (1 - 0.12 * self.lightening)
        foot = cad.rectangle(long, self.hub, 2).translate(((long - length) / 2, 2 - back - self.hub / 2))
        screws = cad.grid(2 + self.lightening % 2, 1, 0.36 * long, 0)
        foot -= cad.holes(4, screws).translate(((long - length) / 2, 1 - back - self.hub / 2))
        return cad.prism(bar, self.width) + cad.prism(foot, 0.35 * self.width + 1)
