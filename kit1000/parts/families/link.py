"""Link: a connecting rod between two eyes, straight, forked or dog-legged, its web pocketed or plain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad


@dataclass(frozen=True)
class Link:
    """Alike above and below the xy plane; the big eye is at the origin, the small one at +x."""

    pitch: float  # between the eyes along x
    offset: float  # of the small eye along y; 0: a straight link
    knee: float  # where the offset begins, from the big eye
    big: float  # outer diameters of the eyes
    small: float
    big_bore: float
    small_bore: float
    big_t: float  # thicknesses
    small_t: float
    web_t: float
    web: float  # width of the web at the knee
    pocket: float  # depth of the pockets that make the web an I section; 0: none
    fork: float  # gap that splits the big eye at mid-height; 0: none
    brace: bool  # a hole through the middle of the web
    bolted: bool  # a rod cap: ears beside the big eye, with bolts along x

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Link:
        twin = cad.chance(rng, 0.2)
        bent = not twin and cad.chance(rng, 0.55)
        form = cad.pick(rng, "plain", "fork") if twin or bent else cad.pick(rng, "plain", "fork", "bolted")
        big = cad.span(rng, 25, 31)
        small = big if twin else cad.span(rng, 12, big - 11)
        big_t = cad.span(rng, 15, 19)
        pitch = cad.span(rng, 38, 42) if twin else cad.span(rng, 28, 36)
        small_t = big_t if twin else cad.span(rng, 7.5, big_t - 6.5)
        web_t = cad.span(rng, 6.5, min(small_t, 9))
        wall = cad.span(rng, 4, 7.5)
        bore = round(big - 2 * wall, 1)
        return cls(
            pitch=pitch, offset=cad.pick(rng, -1, 1) * cad.span(rng, 16, 22) if bent else 0.0,
            knee=pitch / 2 if twin else round(pitch * cad.span(rng, 0.4, 0.6, 0.01), 1), big=big, small=small,
            big_bore=bore,
            small_bore=bore if twin else round(small - 2 * min(wall, 3.5), 1), big_t=big_t,
            small_t=small_t, web_t=web_t,
            web=cad.span(rng, 13, 19), pocket=round(0.3 * web_t, 1) if cad.chance(rng, 0.55) else 0.0,
            fork=round(0.36 * big_t, 1) if form == "fork" and not twin else 0.0,
            brace=cad.chance(rng, 0.4), bolted=form == "bolted",
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        link = self._slab(self._web(), self.web_t)
        if self.pocket > 0:
            tool = cad.at(cad.prism(self._web(inset=2.2), self.web_t), z=self.web_t / 2 - self.pocket)
            link -= tool + cad.mirrored(tool, "z")
        if self.brace:
            link -= self._slab(cad.circle(0.42 * self.web).translate((self.knee, 0)), 2 * self.web_t)
        link += self._slab(cad.circle(self.big), self.big_t)
        link += self._slab(cad.circle(self.small).translate(self._end()), self.small_t)
        if self.bolted:
            link += self._ears()
        bores = cad.circle(self.big_bore) + cad.circle(self.small_bore).translate(self._end())
        link -= self._slab(bores, 2 * self.big_t)
        if self.fork > 0:
            reach = self.big / 2 + 1
            mouth = cad.rectangle(4 * reach, 4 * reach).translate((-1.2 * reach, 0))
            link -= self._slab(mouth, self.fork)
        return link

    def symmetry(self) -> cad.Symmetry:
        if self.offset != 0:
            return cad.none()
        alike = (self.big, self.big_bore, self.big_t) == (self.small, self.small_bore, self.small_t)
        if alike and self.fork == 0 and not self.bolted and self.knee == self.pitch / 2:
            return cad.dihedral(2, (0, 0, 1), (1, 0, 0))
        return cad.cyclic(2, (1, 0, 0))

    def _end(self) -> tuple[float, float]:
        """Centre of the small eye."""
        return (self.pitch, self.offset)

    def _slab(self, profile: cad.CrossSection, thickness: float) -> cad.Manifold:
        """The profile extruded up and down from the middle plane."""
        return cad.at(cad.prism(profile, thickness), z=-thickness / 2)

    def _web(self, inset: float = 0.0) -> cad.CrossSection:
        """The arm from eye to eye over the knee, drawn in by `inset`."""
        knee = cad.circle(self.web - 2 * inset).translate((self.knee, 0))
        small = cad.circle(0.8 * self.small - 2 * inset).translate(self._end())
        return cad.hull_2d(cad.circle(0.8 * self.big - 2 * inset), knee) + cad.hull_2d(knee, small)

    def _ears(self) -> cad.Manifold:
        """Two bolt ears beside the big eye."""
        across = self.big + 13
        bar = cad.at(cad.box(9, across, 0.7 * self.big_t, radius=3), z=-0.35 * self.big_t)
        return cad.drill(bar, 3.4, [(0, side * (across / 2 - 3.7), 0) for side in (-1, 1)], "x")
