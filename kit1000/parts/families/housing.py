"""Housing: an open box with screw bosses, ribs, windows and mounting lugs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.parts import cad
from kit1000.symmetry import Symmetry


@dataclass(frozen=True)
class Housing:
    """The floor lies on the xy plane, the box opens upward; all lengths in mm."""

    outline: str  # "rect", "cut" (one corner), "step" (an L) or "round" (one end)
    length: float  # along x
    width: float
    height: float
    wall: float
    floor: float
    corner: float  # radius of the outer corners
    notch: float  # size of the cut corner or of the step
    boss: float  # diameter of the screw bosses, 0: none
    boss_hole: float
    lugs: int  # mounting ears: 0, 1, or 2 on opposite ends
    lug: float  # how far an ear stands out
    lug_shift: float  # sideways, opposite ways on the two ends
    opening: float  # diameter of the hole in the middle of the floor, 0: none
    ribs: int  # across the inside of the floor
    window: bool  # a slot through one long wall

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Housing:
        lugs = int(rng.choice([0, 1, 2], p=[0.4, 0.3, 0.3]))
        length = cad.span(rng, 40, 50) - 4 * lugs
        width = length * (cad.span(rng, 0.58, 0.74, 0.01) + 0.06 * lugs)
        outline = str(rng.choice(["rect", "cut", "step", "round"], p=[0.4, 0.2, 0.2, 0.2]))
        opening = cad.pick(rng, 0.0, cad.span(rng, 8, 14))
        boss = float(rng.choice([0, cad.span(rng, 6.5, 8)], p=[0.25, 0.75]))
        two_fold = outline == "rect" and lugs != 1
        return cls(
            outline=outline,
            length=length,
            width=width,
            height=cad.span(rng, 14, 24),
            wall=cad.span(rng, 2.0, 3.6),
            floor=cad.span(rng, 3, 5),
            corner=cad.span(rng, 1.5, 5),
            notch=width * cad.span(rng, 0.38, 0.5, 0.01),
            boss=boss,
            boss_hole=boss * cad.span(rng, 0.4, 0.5, 0.01),
            lugs=lugs,
            lug=cad.span(rng, 8, 10),
            lug_shift=cad.pick(rng, 0.0, 0.25) * width,
            opening=opening,
            ribs=cad.pick(rng, 0, 2) if opening else cad.pick(rng, 0, 1, 2),
            window=not two_fold and cad.chance(rng, 0.5),
        )

    def solid(self) -> Manifold:
        outside = self._outline()
        inside = outside.offset(-self.wall)
        box = cad.prism(outside, self.height)
        box -= cad.at(cad.prism(inside, self.height), z=self.floor)
        box += self._furniture(inside)
        for side in (1, -1)[: self.lugs]:
            box += self._lug(side)
        if self.opening > 0:
            box = cad.drill(box, self.opening)
        if self.boss > 0:
            for place in self._boss_places():
                box = cad.drill(box, self.boss_hole, at=(*place, 0))
        if self.window:
            room = self.height - self.floor
            slot = cad.box(0.3 * self.length, 2 * self.wall + 2, 0.5 * room)
            box -= cad.at(slot, -0.1 * self.length, -self.width / 2, self.floor + 0.2 * room)
        return box

    def symmetry(self) -> Symmetry:
        two_fold = self.outline == "rect" and self.lugs != 1
        return Symmetry.cyclic(2, (0, 0, 1)) if two_fold else Symmetry.none()

    def _outline(self) -> CrossSection:
        """The outside as seen from above; cut-outs lie at +x +y."""
        sheet = cad.rectangle(self.length, self.width)
        x, y, cut = self.length / 2, self.width / 2, self.notch
        if self.outline == "cut":
            sheet -= cad.polygon([(x + 1, y + 1), (x - cut - 1, y + 1), (x + 1, y - cut - 1)])
        elif self.outline == "step":
            sheet -= cad.rectangle(2.4 * cut, 2 * cut).translate((x, y))
        elif self.outline == "round":
            end = cad.circle(self.width).translate((x - y, 0))
            sheet = cad.rectangle(self.length - y, self.width).translate((-y / 2, 0)) + end
        return cad.rounded(sheet, self.corner)

    def _boss_places(self) -> list[tuple[float, float]]:
        """Centres of the bosses: in the corners that every outline keeps, mirrored when the box has a two-fold axis."""
        x, y = self.length / 2 - 0.55 * self.boss, self.width / 2 - 0.55 * self.boss
        if self.outline == "rect":
            return [(x, y), (-x, y), (x, -y), (-x, -y)]
        return [(-x, y), (-x, -y)] if self.outline == "round" else [(-x, y), (-x, -y), (x, -y)]

    def _furniture(self, inside: CrossSection) -> Manifold:
        """Bosses and ribs, grown half a wall into the box."""
        room = inside.offset(self.wall / 2)
        height = self.height - self.floor
        things = Manifold()
        if self.boss > 0:
            for place in self._boss_places():
                things += cad.prism(room ^ cad.circle(self.boss).translate(place), self.floor + 0.8 * height)
        for k in range(self.ribs):
            x = (k - (self.ribs - 1) / 2) * 0.32 * self.length
            rib = cad.rectangle(0.9 * self.wall, self.width).translate((x, 0))
            things += cad.prism(room ^ rib, self.floor + 0.4 * height)
        return things

    def _lug(self, side: int) -> Manifold:
        """An ear on the end at -x (side 1) or +x (side -1), with its screw hole."""
        wide = 0.4 * self.width
        x = wide / 2 - self.lug
        ear = cad.hull_2d(cad.rectangle(2, wide).translate((2, 0)), cad.circle(wide).translate((x, 0)))
        ear -= cad.circle(0.45 * wide).translate((x, 0))
        placed = cad.at(cad.prism(ear, self.floor + 1), -self.length / 2, self.lug_shift)
        return placed if side == 1 else cad.rotated(placed, "z", 180)
