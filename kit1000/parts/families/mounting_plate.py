"""Mounting plate: a thick plate with pads, windows, screw slots, a cut corner, a raised edge, a pocket."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.parts import cad
from kit1000.symmetry import Symmetry


@dataclass(frozen=True)
class MountingPlate:
    """The plate lies on the xy plane, centred; pads and edge rise from it; all lengths in mm."""

    outline: str  # "rect", "cut", "step", "tee" or "ear"
    length: float  # along x
    width: float
    thick: float
    corner: float  # radius of the outer corners
    notch: float  # size of what the outline leaves out at +x +y, or of the ear
    window: str  # "none", "round", "slot" or "frame"
    window_d: float
    hole: float
    counterbore: bool
    slots: bool  # slots instead of round screw holes
    pads: str  # "none", "round" or "rail"
    pad_h: float
    edge: float  # height of the raised edge at -x, 0: none
    chamfer: float
    hollow: bool  # the underside is pocketed, but for a rim and the screws

    @classmethod
    def draw(cls, rng: np.random.Generator) -> MountingPlate:
        length = cad.span(rng, 44, 54)
        width = length * cad.span(rng, 0.6, 0.78, 0.01)
        outline = cad.pick(rng, "rect", "cut", "step", "tee", "ear", "ear", "step")
        pads = cad.pick(rng, "none", "round", "round", "rail")
        edge = 0.0 if outline == "rect" else float(cad.pick(rng, 0.0, cad.span(rng, 14, 20)))
        flat = pads == "none" and edge == 0
        return cls(
            outline=outline,
            length=length,
            width=width,
            thick=cad.span(rng, 10, 13) if flat else cad.span(rng, 4.5, 6),
            corner=cad.span(rng, 2, 6) if outline in ("rect", "cut") else cad.span(rng, 1.5, 3.5),
            notch=width * cad.span(rng, 0.36, 0.46, 0.01),
            window=cad.pick(rng, "none", "round", "slot", "frame"),
            window_d=width * cad.span(rng, 0.3, 0.36, 0.01),
            hole=cad.span(rng, 3.4, 5),
            counterbore=not flat and cad.chance(rng, 0.5),
            slots=cad.chance(rng, 0.35),
            pads=pads,
            pad_h=cad.span(rng, 7, 11),
            edge=edge,
            chamfer=cad.pick(rng, 0.0, 0.6, 1.0),
            hollow=flat and outline in ("cut", "step", "ear") and cad.chance(rng, 0.8),
        )

    def solid(self) -> Manifold:
        outline, top = self._outline(), self.thick
        plate = cad.prism(outline, self.thick, chamfer=self.chamfer)
        if self.pads != "none":
            top += self.pad_h
            plate += cad.prism(self._pads(outline), top)
        if self.edge > 0:
            strip = cad.rectangle(5, 2 * self.width).translate((2.5 - self.length / 2, 0))
            plate += cad.prism(outline ^ strip, self.edge)
        if self.hollow:
            plate -= cad.at(cad.prism(self._hollow(outline), self.thick - 3), z=-1)
        screw = cad.slot(1.8 * self.hole, self.hole) if self.slots else cad.circle(self.hole)
        places = self._screws()
        through = CrossSection.compose([self._window(), *(screw.translate(place) for place in places)])
        plate -= cad.at(cad.prism(through, 3 * top), z=-top)
        if not self.counterbore or self.slots:
            return plate
        seats = CrossSection.compose([cad.circle(1.7 * self.hole).translate(place) for place in places])
        return plate - cad.at(cad.prism(seats, top), z=top - 0.4 * self.thick)

    def symmetry(self) -> Symmetry:
        same_faces = self.pads == "none" and self.edge == 0 and not self.counterbore
        if self.outline == "rect":
            return Symmetry.dihedral(2, (0, 0, 1), (1, 0, 0)) if same_faces else Symmetry.cyclic(2, (0, 0, 1))
        return Symmetry.cyclic(2, (1, 0, 0)) if self.outline == "tee" and same_faces else Symmetry.none()

    def _outline(self) -> CrossSection:
        """The plate as seen from above."""
        x, y, cut = self.length / 2, self.width / 2, self.notch
        sheet = cad.rectangle(self.length, self.width)
        if self.outline == "cut":
            sheet -= cad.polygon([(x + 1, y + 1), (x - cut - 1, y + 1), (x + 1, y - cut - 1)])
        elif self.outline == "step":
            sheet -= cad.rectangle(2.6 * cut, 2 * cut).translate((x, y))
        elif self.outline == "tee":
            for side in (-1, 1):
                sheet -= cad.rectangle(2 * cut, 1.3 * cut).translate((x, side * y))
        elif self.outline == "ear":
            sheet = cad.rectangle(self.length - cut, self.width).translate((-cut / 2, 0))
            sheet += cad.rectangle(cut + 4, 1.1 * cut).translate((x - cut / 2 - 2, 0.55 * cut - y))
        return cad.rounded(sheet, self.corner)

    def _window(self) -> CrossSection:
        d = self.window_d
        shapes = {
            "none": CrossSection(),
            "round": cad.circle(d),
            "slot": cad.slot(1.5 * d, 0.7 * d),
            "frame": cad.rectangle(1.5 * d, d, 2),
        }
        return shapes[self.window]

    def _hollow(self, outline: CrossSection) -> CrossSection:
        """The pocket's outline: a rim stays, so do a wall around the window and a boss at each screw."""
        rim = 3.6
        bosses = [cad.circle(2.6 * self.hole).translate(place) for place in self._screws()]
        wall = self._window().offset(rim) if self.window != "none" else CrossSection()
        return outline.offset(-rim) - CrossSection.compose([wall, *bosses])

    def _screws(self) -> list[tuple[float, float]]:
        """Screw holes in the corners that the outline keeps."""
        x, y = self.length / 2 - 1.8 * self.hole, self.width / 2 - 1.6 * self.hole
        near = -x + (3 if self.edge > 0 else 0)
        corners = [(near, y), (near, -y)]
        if self.outline == "rect":
            return [*corners, (x, y), (x, -y)]
        if self.outline in ("cut", "step"):
            return [*corners, (x, -y)]
        return [*corners, (x, 0.0 if self.outline == "tee" else 0.55 * self.notch - self.width / 2)]

    def _pads(self, outline: CrossSection) -> CrossSection:
        """Raised lands: a round one at each screw, or a rail along the two long edges."""
        if self.pads == "round":
            pads = cad.holes(2.4 * self.hole, self._screws())
        else:
            rail = cad.rectangle(self.length, 2.6 * self.hole)
            y = self.width / 2 - 1.3 * self.hole
            pads = rail.translate((0, y)) + rail.translate((0, -y))
        return outline ^ pads
