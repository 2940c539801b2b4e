"""Flanges: a plate for bolts around a bore, often with a hub; the outline follows the bolts or a cut side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts.cad import (
    CrossSection,
    Manifold,
    Symmetry,
    at,
    bolt_circle,
    bore,
    chance,
    circle,
    cone,
    cyclic,
    dihedral,
    holes,
    hull_2d,
    join,
    none,
    pick,
    prism,
    rectangle,
    span,
)  # fmt: skip

BOLTS = {"oval": 2, "lobed3": 3, "lobed4": 4, "triangle": 3, "square": 4, "cut": 4, "tongue": 4}
"""Number of bolts of each outline."""


@dataclass(frozen=True)
class Flange:
    """The plate stands on z = 0, the bore runs along z, the first bolt looks to +x (to the corners of a square)."""

    outline: str
    size: float
    """bolt circle diameter"""
    bolt: float
    rim: float
    """material around each bolt"""
    thickness: float
    bore: float
    hub: float
    """outer diameter of the hub"""
    hub_height: float
    """0 for a plain plate"""
    hub_kind: str
    """straight or conical"""
    counterbore: float
    """depth of a wider seat in the bore from below, 0 for none"""
    cut: float
    """how far from the centre the cut side stands, as a part of the radius"""
    key: float
    """width of the keyway, 0 for none"""
    chamfer: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Flange:
        outline = pick(rng, *BOLTS)
        hub = span(rng, 13, 22)
        bolt = span(rng, 3, 5.5)
        asymmetric = outline in ("cut", "tongue")
        return cls(
            outline=outline,
            size=hub + bolt + span(rng, 6, 13),
            bolt=bolt,
            rim=span(rng, 2.5, 4),
            thickness=span(rng, 3, 7),
            bore=span(rng, 0.4, 0.72, 0.01) * hub,
            hub=hub,
            hub_height=span(rng, 6, 24) if chance(rng, 0.75) else 0.0,
            hub_kind=pick(rng, "straight", "straight", "conical"),
            counterbore=span(rng, 1.5, 2.5) if chance(rng, 0.3) else 0.0,
            cut=span(rng, 0.45, 0.65, 0.01),
            key=span(rng, 2.5, 4) if asymmetric and chance(rng, 0.5) else 0.0,
            chamfer=span(rng, 0.5, 1) if chance(rng, 0.4) else 0.0,
        )

    def solid(self) -> Manifold:
        plate = prism(self._plate(), self.thickness, chamfer_top=self.chamfer)
        if self.hub_height > 0:
            top = self.hub if self.hub_kind == "straight" else 0.5 * (self.hub + self.bore)
            plate = join(plate, at(cone(self.hub, top, self.hub_height), z=self.thickness - 0.01))
        opening = bore(self.bore, self.key, 0.4 * self.key).extrude(100).translate((0, 0, -10))
        body = plate - opening
        if self.counterbore > 0:
            seat = 0.5 * (self.bore + self.hub)
            body -= prism(circle(seat), self.counterbore + 1).translate((0, 0, -1))
        return body

    def symmetry(self) -> Symmetry:
        if self.outline in ("cut", "tongue"):
            return none() if self._sided else cyclic(2, (1, 0, 0))
        n = BOLTS[self.outline]
        return cyclic(n) if self._sided else dihedral(n)

    @property
    def _sided(self) -> bool:
        """Top and bottom differ."""
        return self.hub_height > 0 or self.counterbore > 0 or self.chamfer > 0

    def _plate(self) -> CrossSection:
        n = BOLTS[self.outline]
        points = bolt_circle(self.size, n, 45 if self.outline in ("square", "cut", "tongue") else 0)
        lug = circle(self.bolt + 2 * self.rim)
        lugs = [lug.rotate(np.degrees(np.arctan2(y, x))).translate((x, y)) for x, y in points]
        middle = circle(self.hub + 3)
        outer = self.size + self.bolt + 2 * self.rim
        if self.outline in ("oval", "triangle"):
            plate = hull_2d(middle, *lugs)
        elif self.outline.startswith("lobed"):
            plate = middle + CrossSection.compose([hull_2d(circle(self.hub * 0.7), one) for one in lugs])
        elif self.outline == "square":
            side = self.size / np.sqrt(2) + self.bolt + 2 * self.rim
            plate = rectangle(side, side, self.bolt / 2 + self.rim) + middle
        elif self.outline == "cut":
            reach = max(self.cut * outer / 2, self.hub / 2 + 1)
            plate = circle(outer) ^ rectangle(outer, 2 * outer).translate((reach - outer / 2, 0))
            points = [p for p in points if p[0] < 0]
        else:
            plate = circle(outer) + rectangle(outer * 0.8, outer * 0.55, 3).translate((outer * 0.4, 0))
            points = [*(p for p in points if p[0] < 0), (outer * 0.8 - self.bolt - 1, 0.0)]
        return plate - holes(self.bolt, points)
