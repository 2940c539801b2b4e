"""Cam: a disc cam (pear, oval, trefoil, sector or snail) on a bored and keyed hub."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.numerics.trigonometry import cosine, sine
from kit1000.parts import cad
from kit1000.symmetry import Symmetry

LOBES = {"oval": 2, "trefoil": 3}  # forms that repeat around the shaft


@dataclass(frozen=True)
class Cam:
    """The shaft is the z axis, the highest lift lies along +x; all lengths in mm."""

    form: str  # "pear", "oval", "trefoil", "sector" or "snail"
    circle: float  # radius of the base circle
    lift: float
    nose: float  # diameter of the nose
    sector_deg: float  # of a sector cam
    disc: float  # thickness of the disc
    chamfer: float
    hub: float  # diameter
    hub_up: float  # how far the hub stands above the disc
    hub_down: float  # how far below
    bore: float
    keyed: bool
    holes: int  # lightening holes on an arc around the hub
    hole: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Cam:
        form = cad.pick(rng, "pear", "pear", "oval", "trefoil", "sector", "snail")
        circle = cad.span(rng, 14, 17)
        hub = cad.span(rng, 16, 20)
        up = cad.span(rng, 8, 13)
        sides = str(rng.choice(["one", "both", "none"], p=[0.5, 0.3, 0.2]))
        return cls(
            form=form,
            circle=circle,
            lift=cad.span(rng, 10, 15) * (0.85 if form in LOBES else 1.0),
            nose=cad.span(rng, 9, 13),
            sector_deg=cad.span(rng, 70, 150, 5),
            disc=cad.span(rng, 12, 16) if sides == "none" else cad.span(rng, 6, 10),
            chamfer=cad.pick(rng, 0, 0.8, 1.2),
            hub=hub,
            hub_up=0.0 if sides == "none" else up,
            hub_down=0.5 * up if sides == "both" and form == "snail" else (up if sides == "both" else 0.0),
            bore=hub * cad.span(rng, 0.45, 0.56, 0.01),
            keyed=form not in LOBES and cad.chance(rng, 0.6),
            holes=cad.pick(rng, 0, 1) if form == "pear" else int(rng.integers(0, 4)),
            hole=cad.span(rng, 3.5, 5),
        )

    def solid(self) -> Manifold:
        disc = self._outline() - cad.holes(self.hole, self._hole_places())
        cam = cad.prism(disc, self.disc, chamfer=self.chamfer)
        hub = cad.cylinder(self.hub, self.hub_down + self.disc + self.hub_up)
        cam += cad.at(hub, z=-self.hub_down)
        bore = cad.circle(self.bore)
        if self.keyed:
            bore += cad.rectangle(0.64 * self.bore, 0.28 * self.bore).translate((0.32 * self.bore, 0))
        return cam - cad.at(cad.prism(bore, 200), z=-100)

    def symmetry(self) -> Symmetry:
        same_sides = self.hub_up == self.hub_down
        if self.form in LOBES:
            up, lobes = (0, 0, 1), LOBES[self.form]
            return Symmetry.dihedral(lobes, up, (1, 0, 0)) if same_sides else Symmetry.cyclic(lobes, up)
        if same_sides and self.form != "snail":
            return Symmetry.cyclic(2, (1, 0, 0))
        return Symmetry.none()

    def _outline(self) -> CrossSection:
        """The disc as seen along the shaft."""
        tip = self.circle + self.lift
        if self.form == "snail":  # the radius falls evenly over one turn
            turn = np.linspace(0, 1, 97)
            radius, angle = tip - self.lift * turn, 2 * np.pi * turn
            return cad.polygon(np.stack([radius * cosine(angle), radius * sine(angle)], axis=1))
        if self.form == "sector":
            wedge = cad.sector(2 * tip, -self.sector_deg / 2, self.sector_deg / 2)
            return cad.rounded(wedge + cad.circle(1.3 * self.hub), 2.0)
        nose = cad.circle(self.nose).translate((tip - self.nose / 2, 0))
        if self.form == "pear":
            return cad.hull_2d(cad.circle(2 * self.circle), nose)
        lobe = cad.hull_2d(nose, cad.circle(1.3 * self.circle))
        outline = cad.circle(2 * self.circle if self.form == "oval" else 1.5 * self.circle)
        for k in range(LOBES[self.form]):
            outline += lobe.rotate(360 * k / LOBES[self.form])
        return outline

    def _hole_places(self) -> list[tuple[float, float]]:
        """Lightening holes: in each lobe and nose, else on an arc that is even about +x (-x for a snail)."""
        nose = self.circle + self.lift - self.nose / 2
        if self.form in LOBES:
            return cad.bolt_circle(2 * nose, LOBES[self.form]) if self.holes else []
        if self.form == "pear":
            return [(nose, 0.0)] * self.holes
        if self.form == "sector":
            reach, start, spread = (self.circle + self.lift) / 2 + 0.33 * self.hub, 0, self.sector_deg / 3
        else:
            reach, start, spread = self.circle / 2 + self.hub / 4 + 2, 180, 55.0
        angles = start + spread * (np.arange(self.holes) - (self.holes - 1) / 2)
        return [(float(reach * cosine(a)), float(reach * sine(a))) for a in np.radians(angles)]
