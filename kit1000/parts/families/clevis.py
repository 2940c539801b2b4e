"""Clevises: two ears with a pin hole on a shank, a socket or a mounting foot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import CrossSection, Manifold, Symmetry


@dataclass(frozen=True)
class Clevis:
    """The fork opens to +z; the pin runs along y at x = `offset`. The bridge stands on z = 0."""

    gap: float
    ear: float  # thickness of one ear
    ear_width: float
    pin: float
    reach: float  # from the bridge's top to the pin
    bridge: float
    offset: float  # how far the ears lean to +x, 0 when they stand upright
    stem: str  # shank, socket, foot or side_foot
    stem_size: float
    stem_length: float
    hole: float
    tip: str  # round or square ends of the ears
    unequal: float  # by how much the ear at +y is longer

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Clevis:
        ear_width, gap, ear = cad.span(rng, 14, 24), cad.span(rng, 8, 18), cad.span(rng, 2.8, 6)
        outer = gap + 2 * ear
        stem = cad.pick(rng, "shank", "socket", "foot", "side_foot")
        return cls(
            gap=gap,
            ear=ear,
            ear_width=ear_width,
            pin=cad.span(rng, 0.3, 0.55, 0.01) * ear_width,
            reach=cad.span(rng, 0.6, 1.1, 0.05) * ear_width + 3,
            bridge=cad.span(rng, 2.8, 7),
            offset=cad.span(rng, 8, 14) if cad.chance(rng, 0.35) else 0.0,
            stem=stem,
            stem_size=cad.span(rng, 0.45, 0.85, 0.05) * min(outer, ear_width),
            stem_length=cad.span(rng, 8, 20) if stem in ("shank", "socket") else cad.span(rng, 14, 22),
            hole=cad.span(rng, 3, 5),
            tip=cad.pick(rng, "round", "round", "square"),
            unequal=cad.span(rng, 7, 11) if cad.chance(rng, 0.25) else 0.0,
        )

    def solid(self) -> Manifold:
        outer = self.gap + 2 * self.ear
        bridge = cad.at(cad.box(self.ear_width, outer, self.bridge), z=0)
        ears = [self._ear(-1, 0.0), self._ear(1, self.unequal)]
        body = cad.drill(cad.join(bridge, *ears), self.pin, (self.offset, 0, self.bridge + self.reach), "y")
        return body + self._stem(outer) if self.stem != "socket" else self._socketed(body, outer)

    def symmetry(self) -> Symmetry:
        upright = self.offset == 0 and self.unequal == 0 and self.stem != "side_foot"
        return cad.cyclic(2) if upright else cad.none()

    def _ear(self, side: int, longer: float) -> Manifold:
        tip_height = self.bridge + self.reach
        root = cad.rectangle(self.ear_width, self.bridge).translate((0, self.bridge / 2))
        end = cad.circle(self.ear_width) if self.tip == "round" else cad.rectangle(self.ear_width, self.ear_width, 1.5)
        outline = cad.hull_2d(root, end.translate((self.offset, tip_height + longer)))
        # laid along -y the plate reaches from y = 0 down to -thickness
        plate = cad.at(cad.along(cad.prism(outline, self.ear), "-y"), y=self.ear / 2)
        return cad.at(plate, y=side * (self.gap + self.ear) / 2)

    def _stem(self, outer: float) -> Manifold:
        if self.stem == "shank":
            chamfer = min(1.0, self.stem_size / 8)
            shank = cad.prism(cad.circle(self.stem_size), self.stem_length + 0.1, chamfer_bottom=chamfer)
            return cad.at(shank, z=-self.stem_length)
        foot = cad.prism(self._foot(outer), self.bridge)
        return cad.at(foot, x=0)

    def _foot(self, outer: float) -> CrossSection:
        """A plate level with the bridge: to both sides, or to +x only."""
        inset = self.hole / 2 + 2.5
        if self.stem == "foot":
            long = self.ear_width + 2 * (self.hole + 6)
            corners = cad.grid(2, 2, long - 2 * inset, outer - 2 * inset)
            return cad.rectangle(long, outer, 3) - cad.holes(self.hole, corners)
        x0, x1 = -self.ear_width / 2, self.ear_width / 2 + self.stem_length
        plate = cad.rectangle(x1 - x0, outer, 3).translate(((x0 + x1) / 2, 0))
        reach = x1 - inset
        return plate - cad.holes(self.hole, [(reach, outer / 2 - inset), (reach, inset - outer / 2)])

    def _socketed(self, body: Manifold, outer: float) -> Manifold:
        """A round neck with a blind hole for a rod, drilled from below through the bridge."""
        neck_d = min(self.stem_size + 4, outer, self.ear_width)
        neck = cad.at(cad.cylinder(neck_d, self.stem_length + 0.1), z=-self.stem_length)
        return cad.drill(body + neck, 0.5 * neck_d, (0, 0, -self.stem_length), "-z", self.stem_length + self.bridge + 1)
