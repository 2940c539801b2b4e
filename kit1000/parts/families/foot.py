"""Foot: a screwed-down sole with an upright, a post or tube on ribs, or the two walls of a corner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad


@dataclass(frozen=True)
class Foot:
    """The sole lies on z = 0, centred."""

    form: str  # "tube", "post" or "corner"
    length: float
    width: float
    sole: float  # thickness
    corner: float  # radius of the sole's corners
    height: float  # of the upright over z = 0
    across: float  # the post's width or the tube's diameter
    shift: float  # of the upright from the sole's centre, towards -x
    bore: float  # of the tube, or the pocket of the post
    through: bool  # the bore goes through the sole
    wall: float  # thickness of ribs and corner walls
    short: float  # height of the corner's second wall
    bolt: float
    slotted: bool  # bolt slots in the sole, or countersunk holes
    cross: float  # cross hole through the upright; 0: none
    ribs: bool  # a gusset along the sole on either side of the upright that has room for it

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Foot:
        form = cad.pick(rng, "tube", "post", "post", "corner")
        length, width = cad.span(rng, 40, 52), cad.span(rng, 24, 32)
        across = cad.span(rng, 15, 20)
        even = form != "corner" and cad.chance(rng, 0.3)
        height = cad.span(rng, 26, 40) if form == "corner" else cad.span(rng, 22, 44)
        return cls(
            form=form, length=length, width=width, sole=cad.span(rng, 5, 7.5),
            corner=cad.pick(rng, 0.0, 4.0, 8.0),
            height=height, across=across,
            shift=0.0 if even else round((length - across) / 2 - cad.pick(rng, 0.0, 2.0), 1),
            bore=round(across - 2 * cad.span(rng, 2.5, 4.5), 1), through=cad.chance(rng, 0.6),
            wall=cad.span(rng, 2.2, 5.5), short=round(height * cad.span(rng, 0.45, 0.7, 0.01), 1),
            bolt=cad.span(rng, 3.6, 5.2), slotted=cad.chance(rng, 0.5), cross=cad.pick(rng, 0.0, 3.4, 5.0),
            ribs=cad.chance(rng, 0.75),
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        sole = cad.box(self.length, self.width, self.sole, radius=0 if self.form == "corner" else self.corner)
        if self.form == "corner":
            return self._bolted(self._walled(sole))
        foot = sole + cad.at(self._post(), -self.shift)
        if self.ribs:
            foot += self._ribs()
        mouth = (-self.shift, 0, self.height)
        opening = cad.circle(self.bore) if self.form == "tube" else cad.rectangle(self.bore, self.bore, 1)
        foot = cad.pocket(foot, opening, None if self.through else self.height - self.sole, mouth)
        if self.cross > 0:
            foot = cad.drill(foot, self.cross, (-self.shift, 0, self.height - 1.6 * self.cross), "y")
        return self._bolted(foot)

    def symmetry(self) -> cad.Symmetry:
        even = self.form != "corner" and self.shift == 0
        return cad.cyclic(2, (0, 0, 1)) if even else cad.none()

    def _post(self) -> cad.Manifold:
        """The upright before it is bored."""
        round_post = self.form == "tube"
        profile = cad.circle(self.across) if round_post else cad.rectangle(self.across, self.across, 2)
        return cad.prism(profile, self.height, chamfer_top=0.8)

    def _ribs(self) -> cad.Manifold:
        """Gussets from the upright out over the sole, 1 mm inside its outer edge."""
        ribs = cad.Manifold()
        for hand in (1, -1):
            start = -self.shift + hand * 0.42 * self.across
            free = self.length / 2 - 1 - hand * start
            if free > 6:
                rib = cad.gusset(free, 0.75 * (self.height - self.sole), self.wall)
                ribs += cad.at(cad.rotated(rib, "z", 0 if hand > 0 else 180), start, z=self.sole - 0.01)
        return ribs

    def _walled(self, sole: cad.Manifold) -> cad.Manifold:
        """The sole with a long wall at -y and a lower one at -x, each with its holes."""
        long = cad.rectangle(self.length, self.height).translate((0, self.height / 2))
        short = cad.rectangle(self.width, self.short).translate((0, self.short / 2))
        level, pitch = (self.height + self.sole) / 2, 0.45 * self.length
        if self.slotted:
            long -= cad.slot(pitch + 2 * self.bolt, 1.3 * self.bolt).translate((0.06 * self.length, level))
        else:
            long -= cad.holes(self.bolt, [(0.06 * self.length + k * pitch / 2, level) for k in (-1, 1)])
        short -= cad.circle(self.bolt).translate((0, (self.short + self.sole) / 2))
        back = cad.at(cad.along(cad.prism(long, self.wall), "-y"), y=self.wall - self.width / 2)
        return sole + back + cad.at(cad.along(cad.prism(short, self.wall), "x"), x=-self.length / 2)

    def _bolted(self, foot: cad.Manifold) -> cad.Manifold:
        """The foot with the bolt holes of its sole, on whichever side of the upright is free."""
        row = self.width - 2.4 * self.bolt
        if self.form == "corner":
            spots = [(self.length / 2 - 1.5 * self.bolt, self.wall / 2), (0.0, self.wall / 2)]
        else:
            reach = self.length / 2 - 1.4 * self.bolt
            spots = [(x, y) for x, y in cad.grid(2, 2, 2 * reach, row) if self.shift == 0 or x > 0]
        if self.slotted and self.form != "corner":
            for x, y in spots:
                place = (x - 0.5 * self.bolt * np.sign(x), y, self.sole)
                foot = cad.pocket(foot, cad.slot(2.2 * self.bolt, self.bolt), None, place)
            return foot
        return cad.drill(foot, self.bolt, [(x, y, self.sole) for x, y in spots], countersink=1.8 * self.bolt)
