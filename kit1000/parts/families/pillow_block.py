"""Pillow block: a bearing housing standing on one or two drilled feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad


@dataclass(frozen=True)
class PillowBlock:
    """The bore runs along y, `centre` above the sole; the feet reach out along x."""

    bore: float
    wall: float  # of the housing around the bore
    width: float  # of the housing, along y
    centre: float
    left: float  # what the feet stand out beyond the housing; 0: no foot on that side
    right: float
    sole: float  # thickness of the feet
    depth: float  # of the feet, along y
    bolt: float
    bolts: int  # in each foot, side by side along y
    sunk: bool  # bolt heads in counterbores
    nose: float  # collar around the bore on the +y side; 0: none
    square: bool  # a square housing, or one round about the bore
    relief: float  # height of the arch milled under the sole
    split: float  # saw cut that lets the cap clamp; 0: none

    @classmethod
    def draw(cls, rng: np.random.Generator) -> PillowBlock:
        keyed = cad.pick(rng, "twin", "twin", "long foot", "one foot", "nose", "nose and foot")
        bore, wall, width = cad.span(rng, 12, 20), cad.span(rng, 3.5, 5.5), cad.span(rng, 12, 18)
        bolts = cad.pick(rng, 1, 2)
        bolt = cad.span(rng, 3.4, 4.5 if bolts == 2 else 6.0)
        foot = cad.span(rng, 9, 14)
        short = {"long foot": foot - 8.0, "nose and foot": foot - 7.5, "one foot": 0.0}.get(keyed, foot)
        grown = cad.span(rng, 9, 14) if keyed == "one foot" else 0.0
        width_of_feet = max(width + cad.pick(rng, 0.0, 0.0, 6.0, 10.0), 20.0 if bolts == 2 else 0.0)
        return cls(
            bore=bore, wall=wall, width=width, centre=round(bore / 2 + wall + cad.span(rng, 1, 12), 1),
            left=max(short, 0.0) if short > 7 else 0.0, right=foot + grown, sole=cad.span(rng, 5, 8),
            depth=width_of_feet, bolt=bolt, bolts=bolts, sunk=cad.chance(rng, 0.4),
            nose=cad.span(rng, 10, 13) if keyed.startswith("nose") else 0.0, square=cad.chance(rng, 0.35),
            relief=cad.pick(rng, 0.0, 1.5, 2.5), split=cad.pick(rng, 0.0, 0.0, 1.6),
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        block = cad.along(cad.prism(self._front(), self.width, chamfer=0.6), "-y")
        block = cad.at(block, y=self.width / 2) + self._feet()
        if self.nose > 0:
            collar = cad.along(cad.cylinder(self.bore + 1.4 * self.wall, self.nose + self.width / 2), "y")
            block += cad.at(collar, z=self.centre)
        block = cad.drill(block, self.bore, (0, 0, self.centre), "y")
        if self.relief > 0:
            arch = cad.rectangle(0.7 * (self.bore + 2 * self.wall), 200)
            block = cad.pocket(block, arch, self.relief, axis="-z")
        return self._clamped(block)

    def symmetry(self) -> cad.Symmetry:
        return cad.cyclic(2, (0, 0, 1)) if self.left == self.right and self.nose == 0 else cad.none()

    def _front(self) -> cad.CrossSection:
        """The housing as seen along the bore, y up."""
        across = self.bore + 2 * self.wall
        body = cad.rectangle(across, self.sole).translate((0, self.sole / 2))
        if self.square:
            top = cad.rectangle(across, across, 3).translate((0, self.centre))
        else:
            top = cad.circle(across).translate((0, self.centre))
        return cad.hull_2d(body, top)

    def _feet(self) -> cad.Manifold:
        """The sole plate with its bolt holes."""
        half = self.bore / 2 + self.wall
        long = self.left + self.right + 2 * half
        plate = cad.rectangle(long, self.depth, 3).translate(((self.right - self.left) / 2, 0))
        feet = cad.prism(plate, self.sole, chamfer_top=0.8)
        head = (1.8 * self.bolt, 0.45 * self.sole) if self.sunk else None
        for foot, side in ((self.left, -1), (self.right, 1)):
            if foot > 0:
                rows = cad.grid(1, self.bolts, 0, self.depth - 2.6 * self.bolt)
                mouths = [(side * (half + foot - 0.5 * min(foot, 12)), y, self.sole) for _, y in rows]
                feet = cad.drill(feet, self.bolt, mouths, counterbore=head)
        return feet

    def _clamped(self, block: cad.Manifold) -> cad.Manifold:
        """The saw cut from the top into the bore, or an oil hole where there is none."""
        top = (0, 0, self.centre)
        if self.split > 0:
            return cad.pocket(block, cad.rectangle(self.split, 200), 0.1, top)
        return cad.drill(block, 2.6, top, depth=0.1)
