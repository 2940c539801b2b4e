"""Connector: a plug or socket housing on a flange, with rows of contacts, screw ears and a keying latch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.parts import cad
from kit1000.symmetry import Symmetry


@dataclass(frozen=True)
class Connector:
    """The flange lies on the xy plane, rows of contacts run along x, the mouth opens up; lengths in mm."""

    contacts: str  # "sockets" (bores through a solid body) or "pins" (in a shell, out below)
    columns: int
    rows: int
    pitch: float
    contact: float  # diameter of a bore, side of a square pin
    margin: float  # of the body around the contacts
    height: float  # of the body above the flange
    wall: float  # of a shell
    flange_t: float
    ears: int  # 2: at both ends, 1: at -x only, 0: none
    ear: float  # length of an ear
    latch: float  # how far a latch stands out at +y, 0: none
    latch_w: float
    latch_x: float
    tail: float  # length of the pins below the flange
    step: float  # depth of the step cut into the body at -y, 0: none

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Connector:
        contacts = cad.pick(rng, "sockets", "pins")
        rows, pitch = cad.pick(rng, 2, 3), cad.span(rng, 5.4, 6.6)
        contact = cad.span(rng, 2.6, 3.6) if contacts == "sockets" else cad.span(rng, 2.4, 2.8)
        two_fold = cad.chance(rng, 0.3)
        ears = 2 if two_fold else cad.pick(rng, 0, 1, 1, 2)
        margin = cad.span(rng, 3.2, 4.4) + (2 if contacts == "pins" else 0)
        columns = 3 if ears == 2 else cad.pick(rng, 4, 5)
        body = (columns - 1) * pitch + 2 * margin
        latch_w = cad.span(rng, 8, 11)
        latched = not two_fold and (ears != 1 or cad.chance(rng, 0.6))
        return cls(
            contacts=contacts,
            columns=columns,
            rows=rows,
            pitch=pitch,
            contact=contact,
            margin=margin,
            height=cad.span(rng, 9, 15),
            wall=cad.span(rng, 2.6, 3.2),
            flange_t=cad.span(rng, 3, 4.5),
            ears=ears,
            ear=cad.span(rng, 9, 12),
            latch=cad.span(rng, 8, 10) if latched else 0.0,
            latch_w=latch_w,
            latch_x=cad.pick(rng, 0.0, (body - latch_w) / 2 - 1),
            tail=cad.span(rng, 4, 7) if contacts == "pins" else 0.0,
            step=0.0 if two_fold or contacts == "pins" else cad.pick(rng, 0.0, 0.45) * rows * pitch,
        )

    def solid(self) -> Manifold:
        wide, deep = self._body()
        outline = cad.rectangle(wide, deep, radius=1.2)
        top = self.flange_t + self.height
        parts = [cad.prism(self._flange(), self.flange_t)]
        if self.contacts == "sockets":
            parts.append(cad.prism(outline, top))
        else:
            parts.append(cad.prism(outline - cad.rectangle(wide - 2 * self.wall, deep - 2 * self.wall), top))
            pins = [cad.rectangle(self.contact, self.contact).translate(place) for place in self._places()]
            parts.append(cad.at(cad.prism(CrossSection.compose(pins), self.tail + top - 2), z=-self.tail))
        if self.latch > 0:
            parts.append(self._latch(deep, top))
        connector = cad.join(*parts)
        if self.contacts == "sockets":
            connector -= cad.at(cad.prism(cad.holes(self.contact, self._places()), top + 2), z=-1)
        if self.step > 0:
            waste = cad.box(wide + 2, 2 * self.step, top)
            connector -= cad.at(waste, y=-deep / 2, z=self.flange_t + 0.3 * self.height)
        return connector

    def symmetry(self) -> Symmetry:
        keyed = self.ears == 1 or self.latch > 0 or self.step > 0
        return Symmetry.none() if keyed else Symmetry.cyclic(2, (0, 0, 1))

    def _body(self) -> tuple[float, float]:
        """Length and width of the body around the contacts."""
        around = 2 * self.margin
        return (self.columns - 1) * self.pitch + around, (self.rows - 1) * self.pitch + around

    def _places(self) -> list[tuple[float, float]]:
        """Centres of the contacts."""
        return cad.grid(self.columns, self.rows, self.pitch, self.pitch)

    def _flange(self) -> CrossSection:
        """The body's foot and its ears with their screw holes."""
        wide, deep = self._body()
        flange = cad.rectangle(wide + 2, deep + 2, radius=1.2)
        for side in (-1, 1)[: self.ears]:
            x = side * (wide / 2 + self.ear / 2)
            end = cad.circle(self.ear).translate((x, 0))
            ear = cad.hull_2d(end, cad.rectangle(2, 1.5 * self.ear).translate((side * wide / 2, 0)))
            flange = flange + ear - cad.circle(0.42 * self.ear).translate((x, 0))
        return flange

    def _latch(self, deep: float, top: float) -> Manifold:
        """A hooked block on the side of the body at +y, with a ramp towards the mouth."""
        out, high = self.latch, 0.85 * top
        ramp = cad.polygon([(-1, 0), (out, 0), (out, 0.5 * top), (0.4 * out, high), (-1, high)])
        latch = cad.along(cad.prism(ramp, self.latch_w), "x")
        return cad.at(latch, self.latch_x - self.latch_w / 2, deep / 2)
