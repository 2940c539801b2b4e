"""Hinge: one leaf, flat, strap-shaped or bent up, with the knuckles of its barrel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.parts import cad
from kit1000.symmetry import Symmetry

KNUCKLES = {  # which pieces of the barrel belong to this leaf, in parts of its length along y
    "one": ((0.3, 0.7),),
    "two": ((0.0, 0.32), (0.68, 1.0)),
    "end": ((0.0, 0.45),),
    "uneven": ((0.0, 0.2), (0.45, 0.75)),
}


@dataclass(frozen=True)
class Hinge:
    """The barrel runs along y at x = 0, the leaf extends along +x; all lengths in mm."""

    outline: str  # "plain", "strap", "cut" (one corner) or "ear"
    knuckles: str  # a key of KNUCKLES
    length: float  # of the barrel
    leaf: float  # from the barrel's axis to the far edge
    thick: float
    barrel: float  # outside diameter
    pin: float
    centred: bool  # the leaf meets the barrel at its axis, else at its side
    bend: float  # height of a flange bent up at the far edge, 0: flat
    narrow: float  # width of a strap's end, of an ear, or size of the cut corner
    screws: int
    screw: float
    countersunk: bool

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Hinge:
        outline = cad.pick(rng, "plain", "strap", "cut", "ear")
        length, barrel = cad.span(rng, 34, 44), cad.span(rng, 11, 14)
        centred = outline in ("plain", "strap") and cad.chance(rng, 0.4)
        bend = 0.0 if centred or outline == "strap" else float(cad.pick(rng, 0.0, cad.span(rng, 14, 20)))
        knuckles = cad.pick(rng, "one", "two") if centred else cad.pick(rng, *KNUCKLES)
        screw = cad.span(rng, 3.5, 5)
        return cls(
            outline=outline,
            knuckles=knuckles,
            length=length,
            leaf=cad.span(rng, 36, 44) if outline == "strap" else cad.span(rng, 28, 38),
            thick=cad.span(rng, 4, 6),
            barrel=barrel,
            pin=barrel * cad.pick(rng, 0.4, 0.5),
            centred=centred,
            bend=bend,
            narrow=length * cad.span(rng, 0.36, 0.46, 0.01),
            screws=cad.pick(rng, 2, 3, 4),
            screw=screw,
            countersunk=not centred and cad.chance(rng, 0.5),
        )

    def solid(self) -> Manifold:
        low = (self.barrel - self.thick) / 2 if self.centred else 0.0
        leaf = cad.at(cad.prism(self._outline(), self.thick), z=low)
        for start, end in self._gaps():
            clear = cad.box(self.barrel + 2, (end - start) * self.length, 3 * self.barrel)
            leaf -= cad.at(clear, 0, (start + end - 1) / 2 * self.length, -self.barrel)
        if self.bend > 0:
            strip = cad.rectangle(2 * self.thick, 2 * self.length).translate((self.leaf, 0))
            leaf += cad.prism(self._outline() ^ strip, self.bend)
            y = 0.0 if self.outline == "plain" else -self.narrow / 2
            leaf = cad.drill(leaf, self.screw, (self.leaf, y, (self.bend + self.thick) / 2), axis="x")
        hinge = leaf + self._barrel()
        sink = 1.8 * self.screw if self.countersunk else 0.0
        mouths = [(*p, low + self.thick) for p in self._screws()]
        hinge = cad.drill(hinge, self.screw, mouths, countersink=sink)
        return cad.drill(hinge, self.pin, (0, 0, self.barrel / 2), axis="y")

    def symmetry(self) -> Symmetry:
        return Symmetry.cyclic(2, (1, 0, 0)) if self.centred else Symmetry.none()

    def _barrel(self) -> Manifold:
        pieces = []
        for start, end in KNUCKLES[self.knuckles]:
            knuckle = cad.along(cad.cylinder(self.barrel, (end - start) * self.length), "-y")
            pieces.append(cad.at(knuckle, y=(end - 0.5) * self.length, z=self.barrel / 2))
        return cad.join(*pieces)

    def _gaps(self) -> list[tuple[float, float]]:
        """The gaps between the knuckles of this leaf, for those of the other leaf."""
        edges = [0.0, *(edge for piece in KNUCKLES[self.knuckles] for edge in piece), 1.0]
        pairs = zip(edges[::2], edges[1::2], strict=True)
        # The outer gaps reach past the leaf, so that no skin is left at its ends.
        return [(a - 0.1 * (a == 0), b + 0.1 * (b == 1)) for a, b in pairs if b > a]

    def _outline(self) -> CrossSection:
        """The leaf as seen from above."""
        far, half = self.leaf, self.length / 2
        plate = cad.rectangle(far, self.length).translate((far / 2, 0))
        if self.outline == "strap":
            end = cad.circle(self.narrow).translate((far - self.narrow / 2, 0))
            return cad.hull_2d(cad.rectangle(self.barrel, self.length).translate((self.barrel / 2, 0)), end)
        if self.outline == "cut":
            reach = self.narrow + 1
            corner = [(far + 1, half + 1), (far - reach, half + 1), (far + 1, half - reach)]
            return plate - cad.polygon(corner)
        if self.outline == "ear":
            return plate - cad.rectangle(0.9 * far, 2 * self.narrow).translate((far, half))
        return plate

    def _screws(self) -> list[tuple[float, float]]:
        """Screw holes clear of the barrel, the bend and the outline; even about the x axis if the leaf is."""
        near = self.barrel / 2 + 1.6 * self.screw
        far = self.leaf - 1.5 * self.screw - (self.thick if self.bend > 0 else 0)
        edge, middle = self.length / 2 - 1.4 * self.screw, (near + far) / 2
        if self.outline == "strap":
            return [(far, 0.0), (near, 0.6 * edge), (near, -0.6 * edge)][: 3 if self.screws > 2 else 1]
        roomy = far - near > 2.5 * self.screw
        columns = [near, far] if roomy and self.screws == 4 else [middle]
        high = edge if self.outline == "plain" else -0.1 * self.length
        return [(x, y) for x in columns for y in (high, -edge)]
