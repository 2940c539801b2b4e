"""Angle brackets: a foot and an upright plate, stiffened by ribs, with screw holes, slots or a bearing seat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import CrossSection, Manifold, Symmetry


@dataclass(frozen=True)
class Bracket:
    """An L in the xz plane: the foot runs from x = 0 along +x, the upright stands at x = 0, both centred in y."""

    foot: float
    height: float
    width: float
    foot_thickness: float
    wall: float
    upright: str  # square, round, tapered or bearing
    foot_holes: str  # pair, row, slots, four or none
    hole: float
    top_width: float
    bore: float
    ribs: int  # 0, 1 in the middle (at the side when a bore needs the room), 2 at both sides
    rib_reach: float
    rib_wall: float
    boss: float  # how far a ring stands out around the bore, 0 for none

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Bracket:
        upright = cad.pick(rng, "square", "round", "tapered", "bearing")
        width = cad.span(rng, 20, 38)
        foot = cad.span(rng, 22, 42)
        height = foot + cad.pick(rng, -1, 1) * cad.span(rng, 8, 16)
        height = float(np.clip(height, 20, 50))
        plain = upright in ("square", "tapered") and cad.chance(rng, 0.3)
        bearing = upright in ("round", "bearing")
        return cls(
            foot=foot if abs(foot - height) >= 7 else height + 9,
            height=height,
            width=width,
            foot_thickness=cad.span(rng, 2, 4.5),
            wall=cad.span(rng, 2, 4.2),
            upright=upright,
            foot_holes="none" if plain else cad.pick(rng, "pair", "row", "slots", "four"),
            hole=cad.span(rng, 3, 5.5),
            top_width=cad.span(rng, 0.45, 0.8, 0.05) * width,
            bore=cad.span(rng, 0.3, 0.6, 0.01) * min(width, height - 12)
            if bearing
            else 0.0
            if plain
            else cad.span(rng, 3, 6),
            ribs=cad.pick(rng, 0, 2) if bearing else cad.pick(rng, 0, 1, 2),
            rib_reach=cad.span(rng, 0.4, 0.85, 0.05),
            rib_wall=cad.span(rng, 1.9, 3),
            boss=cad.span(rng, 2, 5) if bearing and cad.chance(rng, 0.5) else 0.0,
        )

    def solid(self) -> Manifold:
        foot = cad.prism(self._foot_plate(), self.foot_thickness)
        upright = cad.at(cad.along(cad.prism(self._upright_plate(), self.wall), "x"), z=0)
        body = cad.join(foot, upright, *self._ribs(), *self._boss())
        return cad.drill(body, self.bore, (0, 0, self._bore_height), "x") if self._has_bore else body

    def symmetry(self) -> Symmetry:
        return cad.none()  # mirrored left to right, but no rotation

    @property
    def _has_bore(self) -> bool:
        return self.upright in ("round", "bearing")

    @property
    def _bore_height(self) -> float:
        highest = self.height - max(self.bore / 2 + 4, self.width / 2 if self.upright == "round" else 0)
        return max(highest, self.foot_thickness + self.bore / 2 + 1.5 + (3.5 if self.boss else 0))

    def _foot_plate(self) -> CrossSection:
        plate = cad.rectangle(self.foot, self.width, min(5, self.width / 5)).translate((self.foot / 2, 0))
        plate += cad.rectangle(self.foot / 2, self.width).translate((self.foot / 4, 0))
        inner, outer = self.wall + self.hole / 2 + 2.5, self.foot - self.hole / 2 - 2.5
        side = self.width / 2 - self.hole / 2 - max(2.5, self.rib_wall + 1 if self.ribs == 2 else 0)
        middle, edge = (inner + outer) / 2, max(side, self.hole * 0.5 + 1)
        if self.foot_holes == "slots":
            long_hole = cad.slot(max((outer - inner) * 0.7, self.hole + 2), self.hole)
            return plate - long_hole.translate((middle, edge)) - long_hole.translate((middle, -edge))
        if self.foot_holes == "none":
            return plate
        rows = {"pair": [middle], "row": [outer], "four": [inner, outer]}[self.foot_holes]
        return plate - cad.holes(self.hole, [(x, s * edge) for x in rows for s in (-1, 1)])

    def _upright_plate(self) -> CrossSection:
        """Outline in (y, z) of the upright, its foot at z = 0."""
        base = cad.rectangle(self.width, 8).translate((0, 4))
        if self.upright == "round":
            return cad.hull_2d(base, cad.circle(self.width).translate((0, self.height - self.width / 2)))
        if self.upright == "tapered":
            plate = cad.hull_2d(base, cad.rectangle(self.top_width, 2).translate((0, self.height - 1)))
        else:
            plate = cad.rectangle(self.width, self.height, 2).translate((0, self.height / 2)) + base
        if self.upright == "bearing" or self.bore == 0:
            return plate
        edge = (self.top_width if self.upright == "tapered" else self.width) / 2 - self.bore / 2 - 2.5
        if edge < self.bore:
            return plate - cad.circle(self.bore).translate((0, self.height - self.bore / 2 - 4))
        return plate - cad.holes(self.bore, [(s * edge, self.height - self.bore / 2 - 3.5) for s in (-1, 1)])

    def _ribs(self) -> list[Manifold]:
        reach = self.rib_reach * (self.foot - self.wall)
        rise = self.rib_reach * (self.height - self.foot_thickness - (2 if self._has_bore else 8))
        rib = cad.at(cad.gusset(reach, rise, self.rib_wall), self.wall - 0.01, 0, self.foot_thickness - 0.01)
        aside = cad.at(rib, y=self.width / 2 - self.rib_wall / 2)
        return {0: [], 1: [rib], 2: [aside, cad.mirrored(aside, "y")]}[self.ribs]

    def _boss(self) -> list[Manifold]:
        if self.boss <= 0:
            return []
        ring = cad.along(cad.prism(cad.circle(self.bore + 7), self.wall + self.boss), "x")
        return [cad.at(ring, z=self._bore_height)]
