"""Pulleys: V-grooved, flat, crowned by flanges, stepped or toothed, with hubs and spokes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import CrossSection, Manifold, Symmetry

LIP_MM = 1.9
"""Thickness of a belt's side discs."""


@dataclass(frozen=True)
class Pulley:
    """A wheel about z standing on z = 0."""

    kind: str  # vee, flat, stepped or toothed
    d: float
    width: float
    groove: float  # depth of the groove, or height of the flanges, or of the step
    teeth: int  # of a toothed pulley
    bore: float
    hub: float
    hub_height: float
    web: float  # width of the web between hub and rim; the full width means a solid wheel
    spokes: int  # 0 for a closed web
    flanges: int  # discs beside the belt of a flat or toothed pulley

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Pulley:
        kind = cad.pick(rng, "vee", "flat", "stepped", "toothed")
        width, hub, d = cad.span(rng, 9, 18), cad.span(rng, 11, 17), cad.span(rng, 34, 45)
        spoked = kind != "stepped" and cad.chance(rng, 0.3)
        flanges = cad.pick(rng, 0, 1, 2)
        webbed = spoked or cad.chance(rng, 0.5) or (kind == "flat" and flanges == 0)
        return cls(
            kind=kind,
            d=d,
            width=width,
            groove=cad.span(rng, 2, 4.5),
            teeth=int(rng.integers(20, 31)),
            bore=cad.span(rng, 0.4, 0.65, 0.01) * hub,
            hub=hub,
            hub_height=cad.span(rng, 4, 14) if cad.chance(rng, 0.6) else 0.0,
            web=cad.span(rng, 0.35, 0.7, 0.05) * width if webbed else width,
            spokes=cad.pick(rng, 3, 4) if spoked and kind != "toothed" else 0,
            flanges=flanges,
        )

    def solid(self) -> Manifold:
        wheel = self._toothed() if self.kind == "toothed" else cad.revolved(self._rim())
        wheel = wheel - self._hollow()
        body = cad.join(wheel, cad.cylinder(self.hub, self.width + self.hub_height, 0.6))
        return cad.drill(body, self.bore)

    def symmetry(self) -> Symmetry:
        sided = self.hub_height > 0 or self.kind == "stepped" or (self.kind != "vee" and self.flanges == 1)
        n = self.teeth if self.kind == "toothed" else self.spokes
        if n:
            return cad.cyclic(n) if sided else cad.dihedral(n)
        return cad.free() if sided else cad.free_flipped()

    @property
    def _inner(self) -> float:
        """Inner diameter of the rim."""
        deepest = self.groove + (LIP_MM if self.kind == "toothed" else 0)
        return max(self.d - 2 * deepest - 5, self.hub + 1)

    def _rim(self) -> list[tuple[float, float]]:
        """(r, z) of the wheel without its web's recesses."""
        r, w, g = self.d / 2, self.width, self.groove
        if self.kind == "vee":
            land, floor = 0.16 * w, 0.1 * w
            middle = w / 2
            belt = [(r, land), (r - g, middle - floor), (r - g, middle + floor), (r, w - land)]
            return [(0, 0), (r, 0), *belt, (r, w), (0, w)]
        if self.kind == "stepped":
            return [(0, 0), (r, 0), (r, 0.4 * w), (r - g, 0.4 * w + 0.3 * g), (r - g, w), (0, w)]
        low = [(r, 0), (r, LIP_MM), (r - g, LIP_MM)] if self.flanges > 0 else [(r - g, 0)]
        high = [(r - g, w - LIP_MM), (r, w - LIP_MM), (r, w)] if self.flanges > 1 else [(r - g, w)]
        return [(0, 0), *low, *high, (0, w)]

    def _toothed(self) -> Manifold:
        tip = self.d - 2 * self.groove if self.flanges else self.d
        wheel = cad.prism(cad.gear(self.teeth, tip / (self.teeth + 2), 2), self.width)
        for k in range(self.flanges):
            wheel += cad.at(cad.cylinder(tip + 3, LIP_MM), z=k * (self.width - LIP_MM))
        return wheel

    def _hollow(self) -> Manifold:
        """What is cut out of the web on both sides, and the windows between spokes."""
        inner = min(self._inner, 0.8 * self.d)
        side = (self.width - self.web) / 2
        if side < 0.5 or inner < self.hub + 4:
            return Manifold()
        annulus = cad.ring(inner, self.hub)
        cut = cad.join(
            cad.at(cad.prism(annulus, side + 1), z=-1), cad.at(cad.prism(annulus, side + 1), z=self.width - side)
        )
        if self.spokes == 0:
            return cut
        half = 180 / self.spokes - 10
        window = cad.rounded(annulus ^ cad.sector(2 * inner, -half, half), 1.2)
        windows = CrossSection.compose([window.rotate(k * 360 / self.spokes) for k in range(self.spokes)])
        return cut + cad.at(cad.prism(windows, 50), z=-1)
