"""Yoke: a fork of two cross-bored prongs on a shank or a foot, at times with a lug or a boss at its side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad


@dataclass(frozen=True)
class Yoke:
    """The prongs stand along z on either side of the gap, `gap` wide in x; the pin bore runs along x."""

    gap: float
    prong: float  # thickness of a prong
    depth: float  # of the fork along y, and diameter of the prong ends
    reach: float  # from the top of the crotch to the pin
    crotch: float  # thickness of the bridge under the gap
    round_crotch: bool
    pin: float
    foot: str  # "round" or "hex" shank, or "plate"
    foot_d: float  # across the shank, or what the plate stands out beyond the fork along y
    foot_h: float
    bore: float  # along z through foot and bridge; 0: none
    boss: float  # collar on the outside of the prong at +x
    other_boss: float  # the same at -x
    lug: float  # arm at +y, from the fork's face to its eye; 0: none
    stub: float  # how much lower the prong at -x ends, flat; 0: as high as the other

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Yoke:
        keyed = cad.pick(rng, "even", "even", "boss", "lug", "stub", "lug")
        gap, prong, depth = cad.span(rng, 8, 13), cad.span(rng, 5.5, 8), cad.span(rng, 17, 23)
        foot = cad.pick(rng, "round", "hex", "plate", "plate")
        if keyed == "lug":  # it would stand over the plate's bolts
            foot = cad.pick(rng, "round", "hex")
        boss = cad.span(rng, 2, 4) if keyed == "even" and cad.chance(rng, 0.4) else 0.0
        reach = cad.span(rng, 12, 17)
        return cls(
            gap=gap, prong=prong, depth=depth, reach=reach, crotch=cad.span(rng, 6, 10),
            round_crotch=cad.chance(rng, 0.5), foot=foot,
            pin=round(depth * cad.span(rng, 0.32, 0.5, 0.01), 1),
            foot_d=cad.span(rng, 9, 12) if foot == "plate" else cad.span(rng, 13, min(depth, 18)),
            foot_h=cad.span(rng, 4, 6) if foot == "plate" else cad.span(rng, 8, 16),
            bore=cad.pick(rng, 0.0, 5.0, 6.5, 8.0), boss=cad.span(rng, 9, 12) if keyed == "boss" else boss,
            other_boss=boss, lug=cad.span(rng, 10, 16) if keyed == "lug" else 0.0,
            stub=reach + 0.25 * depth if keyed == "stub" else 0.0,
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        width, level = self.gap + 2 * self.prong, self.crotch + self.reach
        fork = cad.at(cad.along(cad.prism(self._side(level), width, chamfer=0.6), "x"), x=-width / 2)
        collars: list[tuple[float, cad.Axis]] = [(self.boss, "x"), (self.other_boss, "-x")]
        for boss, axis in collars:
            if boss > 0:
                collar = cad.cylinder(0.8 * self.depth, width / 2 + boss)
                fork += cad.at(cad.along(collar, axis), z=level)
        fork = cad.drill(fork, self.pin, (0, 0, level), "x")
        if self.stub > 0:
            waste = cad.box(width, 2 * self.depth, 100)
            fork -= cad.at(waste, x=-width / 2, z=level + self.depth / 2 - self.stub)
        fork = cad.pocket(fork, self._gap(level), None, (0, 0, 0), "y")
        fork += self._foot() if self.lug == 0 else self._foot() + self._lug()
        return cad.drill(fork, self.bore) if self.bore > 0 else fork

    def symmetry(self) -> cad.Symmetry:
        even = self.boss == self.other_boss and self.lug == self.stub == 0
        return cad.cyclic(2, (0, 0, 1)) if even else cad.none()

    def _side(self, level: float) -> cad.CrossSection:
        """The fork as seen along the pin."""
        base = cad.rectangle(self.depth, self.crotch).translate((0, self.crotch / 2))
        return cad.hull_2d(base, cad.circle(self.depth).translate((0, level)))

    def _gap(self, level: float) -> cad.CrossSection:
        """The opening between the prongs as seen along y."""
        top = level + self.depth
        gap = cad.rectangle(self.gap, top).translate((0, self.crotch + top / 2))
        if not self.round_crotch:
            return gap
        low = self.crotch + self.gap / 2
        upper = cad.rectangle(self.gap, top).translate((0, low + top / 2))
        return upper + cad.circle(self.gap).translate((0, low))

    def _foot(self) -> cad.Manifold:
        """What the fork stands on, overlapping its bridge by 1 mm."""
        if self.foot == "plate":
            width, long = self.gap + 2 * self.prong, self.depth + 2 * self.foot_d
            plate = cad.rectangle(width, long, 4)
            plate -= cad.holes(4.0, cad.grid(2, 2, width - 9, long - 9))
            return cad.at(cad.prism(plate, self.foot_h + 1, chamfer_top=0.6), z=-self.foot_h)
        shank = cad.circle(self.foot_d) if self.foot == "round" else cad.ngon(6, self.foot_d)
        return cad.at(cad.prism(shank, self.foot_h + 1, chamfer_bottom=1), z=-self.foot_h)

    def _lug(self) -> cad.Manifold:
        """An arm with an eye, level with the bridge."""
        eye = cad.circle(11).translate((0, self.depth / 2 + self.lug))
        arm = cad.hull_2d(cad.rectangle(self.gap + self.prong, self.depth / 2), eye)
        return cad.prism(arm - cad.circle(5).translate((0, self.depth / 2 + self.lug)), self.crotch)
