"""Machined blocks: a block with a corner milled out, an edge stepped or bevelled, a groove, openings and pockets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import Axis, CrossSection, Manifold, Symmetry


@dataclass(frozen=True)
class Opening:
    """A cut of one outline into a face of the block, through or blind."""

    outline: str  # round, hex, square, triangle or long
    size: float
    face: Axis
    across: float  # place on the face, as a part of its half width: below 0, away from the milled corner
    up: float
    depth: float  # as a part of the block, 0 for a through cut

    @classmethod
    def draw(cls, rng: np.random.Generator, smallest: float) -> Opening:
        faces: tuple[Axis, ...] = ("x", "y", "z", "z")
        return cls(
            outline=cad.pick(rng, "round", "round", "hex", "square", "triangle", "long"),
            size=round(cad.span(rng, 0.18, 0.45, 0.01) * smallest, 1),
            face=cad.pick(rng, *faces),
            across=cad.span(rng, -0.45, 0.0, 0.05),
            up=cad.span(rng, -0.45, 0.0, 0.05),
            depth=cad.span(rng, 0.2, 0.5, 0.02) if cad.chance(rng, 0.75) else 0.0,
        )

    def profile(self) -> CrossSection:
        if self.outline == "round":
            return cad.circle(self.size)
        if self.outline == "long":
            return cad.slot(1.7 * self.size, 0.8 * self.size)
        sides = {"triangle": 3, "square": 4, "hex": 6}[self.outline]
        return cad.ngon(sides, self.size)


@dataclass(frozen=True)
class Block:
    """A block x by y by z on z = 0; the milled corner is at (+x, +y, top), the worked edge at -x along y."""

    x: float
    y: float
    z: float
    corner: tuple[float, float, float]  # what is milled out of the corner along x, y, z
    edge: str  # plain, step, bevel or round
    edge_x: float
    edge_z: float
    groove: float  # width of a groove across the top along x, 0 for none
    groove_at: float  # its place, as a part of the half width y
    groove_depth: float
    notch: float  # side of a square notch down the whole edge at (-x, +y), 0 for none
    left: bool  # mirrored, the milled corner at -y
    openings: tuple[Opening, ...]

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Block:
        x = cad.span(rng, 32, 44)
        cube = cad.chance(rng, 0.25)
        y = x if cube else cad.span(rng, 0.45, 0.9, 0.01) * x
        z = x if cube else cad.span(rng, 0.22, 0.7, 0.01) * x
        corner = tuple(round(cad.span(rng, low, 0.6, 0.01) * side, 1) for low, side in ((0.3, x), (0.35, y), (0.3, z)))
        edge = cad.pick(rng, "plain", "step", "step", "bevel", "bevel", "round")
        groove = round(cad.span(rng, 0.16, 0.3, 0.01) * y, 1) if cad.chance(rng, 0.35) else 0.0
        count = cad.pick(rng, 0, 1, 1, 2, 2, 3)
        return cls(
            x=x,
            y=round(y, 1),
            z=round(z, 1),
            corner=(corner[0], corner[1] + 0.7, corner[2] + 0.3),
            edge=edge,
            edge_x=round(cad.span(rng, 0.17, 0.33, 0.01) * x, 1),
            edge_z=round(cad.span(rng, 0.25, 0.55, 0.01) * z, 1),
            groove=groove,
            groove_at=cad.span(rng, -0.5, 0.1, 0.05),
            groove_depth=round(cad.span(rng, 0.2, 0.4, 0.01) * z, 1),
            notch=round(cad.span(rng, 0.14, 0.3, 0.01) * y, 1) if cad.chance(rng, 0.35) else 0.0,
            left=cad.chance(rng, 0.5),
            openings=tuple(Opening.draw(rng, min(x, y, z)) for _ in range(count)),
        )

    def solid(self) -> Manifold:
        cx, cy, cz = self.corner
        body = self._edged()
        body -= cad.at(cad.box(2 * cx, 2 * cy, 2 * cz), self.x / 2, self.y / 2, self.z - cz)
        if self.groove > 0:
            place = (0, self.groove_at * self.y / 2, self.z)
            body = cad.pocket(body, cad.rectangle(2 * self.x, self.groove), self.groove_depth, place)
        if self.notch > 0:
            size = 2 * self.notch
            body -= cad.at(cad.box(size, size, 2 * self.z), -self.x / 2, self.y / 2, -self.z / 2)
        for opening in self.openings:
            body = self._opened(body, opening)
        body = max(body.decompose(), key=Manifold.volume)  # a deep cut may part off a sliver
        return cad.mirrored(body, "y") if self.left else body

    def symmetry(self) -> Symmetry:
        return cad.none()  # the milled corner is the only one, and its three sides differ

    def _edged(self) -> Manifold:
        """The block with its worked edge, as a profile in xz extruded along y."""
        left, right, a, b = -self.x / 2, self.x / 2, self.edge_x, self.edge_z
        top = {
            "plain": [(left, self.z)],
            "step": [(left + a, self.z), (left + a, self.z - b), (left, self.z - b)],
            "bevel": [(left + a, self.z), (left, self.z - b)],
            "round": cad.arc_points((left + a, self.z - a), a, 90, 180).tolist(),
        }[self.edge]
        side = cad.polygon([(left, 0), (right, 0), (right, self.z), *top])
        return cad.at(cad.along(cad.prism(side, self.y), "-y"), y=self.y / 2)

    def _opened(self, body: Manifold, opening: Opening) -> Manifold:
        half = {"x": self.x / 2, "y": self.y / 2, "z": self.z / 2}
        wide, high = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}[opening.face]
        middle = np.array([0.0, 0.0, self.z / 2])
        middle["xyz".index(wide)] += opening.across * half[wide]
        middle["xyz".index(high)] += opening.up * half[high]
        middle["xyz".index(opening.face)] += half[opening.face]
        depth = 2 * half[opening.face] * opening.depth if opening.depth > 0 else None
        return cad.pocket(body, opening.profile(), depth, middle.tolist(), opening.face)
