"""Flanges: a plate for bolts around a bore, often with a hub; the outline follows the bolts or a cut side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import CrossSection, Manifold, Symmetry

BOLTS = {"oval": 2, "lobed3": 3, "lobed4": 4, "triangle": 3, "square": 4, "cut": 4, "tongue": 4}
"""Number of bolts of each outline."""


@dataclass(frozen=True)
class Flange:
    """The plate stands on z = 0, the bore runs along z, the first bolt is at +x (to the corners of a square)."""

    outline: str
    size: float  # bolt circle diameter
    bolt: float
    rim: float  # material around each bolt
    thickness: float
    bore: float
    hub: float  # outer diameter of the hub
    hub_height: float  # 0 for a plain plate
    hub_kind: str  # straight or conical
    counterbore: float  # depth of a wider seat in the bore from below, 0 for none
    cut: float  # how far from the centre the cut side stands, as a part of the radius
    key: float  # width of the keyway, 0 for none
    chamfer: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Flange:
        outline = cad.pick(rng, *BOLTS)
        hub = cad.span(rng, 13, 22)
        bolt = cad.span(rng, 3, 5.5)
        asymmetric = outline in ("cut", "tongue")
        return cls(
            outline=outline,
            size=hub + bolt + cad.span(rng, 6, 13),
            bolt=bolt,
            rim=cad.span(rng, 2.5, 4),
            thickness=cad.span(rng, 2.4, 6),
            bore=cad.span(rng, 0.4, 0.72, 0.01) * hub,
            hub=hub,
            hub_height=cad.span(rng, 6, 24) if cad.chance(rng, 0.75) else 0.0,
            hub_kind=cad.pick(rng, "straight", "straight", "conical"),
            counterbore=cad.span(rng, 1.5, 2.5) if cad.chance(rng, 0.3) else 0.0,
            cut=cad.span(rng, 0.45, 0.65, 0.01),
            key=cad.span(rng, 2.5, 4) if asymmetric and cad.chance(rng, 0.5) else 0.0,
            chamfer=cad.span(rng, 0.5, 1) if cad.chance(rng, 0.4) else 0.0,
        )

    def solid(self) -> Manifold:
        plate = cad.prism(self._plate(), self.thickness, chamfer_top=self.chamfer)
        if self.hub_height > 0:
            top = self.hub if self.hub_kind == "straight" else 0.5 * (self.hub + self.bore)
            plate = cad.join(plate, cad.at(cad.cone(self.hub, top, self.hub_height), z=self.thickness - 0.01))
        opening = cad.bore(self.bore, self.key, 0.4 * self.key).extrude(100).translate((0, 0, -10))
        body = plate - opening
        if self.counterbore > 0:
            seat = 0.5 * (self.bore + self.hub)
            body -= cad.prism(cad.circle(seat), self.counterbore + 1).translate((0, 0, -1))
        return body

    def symmetry(self) -> Symmetry:
        if self.outline in ("cut", "tongue"):
            return cad.none() if self._sided else cad.cyclic(2, (1, 0, 0))
        n = BOLTS[self.outline]
        return cad.cyclic(n) if self._sided else cad.dihedral(n)

    @property
    def _sided(self) -> bool:
        """Top and bottom differ."""
        return self.hub_height > 0 or self.counterbore > 0 or self.chamfer > 0

    def _plate(self) -> CrossSection:
        n = BOLTS[self.outline]
        points = cad.bolt_circle(self.size, n, 45 if self.outline in ("square", "cut", "tongue") else 0)
        lug = cad.circle(self.bolt + 2 * self.rim)
        lugs = [lug.rotate(cad.bearing(x, y)).translate((x, y)) for x, y in points]
        middle = cad.circle(self.hub + 3)
        outer = self.size + self.bolt + 2 * self.rim
        if self.outline in ("oval", "triangle"):
            plate = cad.hull_2d(middle, *lugs)
        elif self.outline.startswith("lobed"):
            plate = middle + CrossSection.compose([cad.hull_2d(cad.circle(self.hub * 0.7), one) for one in lugs])
        elif self.outline == "square":
            side = self.size / np.sqrt(2) + self.bolt + 2 * self.rim
            plate = cad.rectangle(side, side, self.bolt / 2 + self.rim) + middle
        elif self.outline == "cut":
            reach = max(self.cut * outer / 2, self.hub / 2 + 1)
            plate = cad.circle(outer) ^ cad.rectangle(outer, 2 * outer).translate((reach - outer / 2, 0))
            points = [p for p in points if p[0] < 0]
        else:
            plate = cad.circle(outer) + cad.rectangle(outer * 0.8, outer * 0.55, 3).translate((outer * 0.4, 0))
            points = [*(p for p in points if p[0] < 0), (outer * 0.8 - self.bolt - 1, 0.0)]
        return plate - cad.holes(self.bolt, points)
