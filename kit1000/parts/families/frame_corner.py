"""Frame corner: three perpendicular arms, sockets for square or round tubes or pegs for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad


@dataclass(frozen=True)
class FrameCorner:
    """The outer corner is at the origin; the arms run along +x, +y and +z."""

    across: float  # width of the arms
    arm_x: float  # from the outer corner to the end of the arm
    arm_y: float
    arm_z: float
    kind: str  # "square" or "round" socket, or "peg"
    wall: float  # around the socket, or the step down to the peg
    depth: float  # of the shortest arm's socket, from its end; the length of a peg
    screw: float  # cross hole through each arm; 0: none
    web: float  # thickness of the gussets between the arms; 0: none
    rise: float  # legs of the gussets, from the arms' inner corner
    corner: float  # edge of the cube taken off at the outer corner; 0: none

    @classmethod
    def draw(cls, rng: np.random.Generator) -> FrameCorner:
        keyed = cad.pick(rng, "even", "long", "long", "three lengths", "three lengths")
        across = cad.span(rng, 15, 19)
        kind = cad.pick(rng, "square", "square", "round", "peg")
        screw = cad.span(rng, 3.2, 4.2) if cad.chance(rng, 0.65) else 0.0
        short = across + cad.span(rng, 14, 18)
        second = short + cad.span(rng, 7.5, 9) if keyed == "three lengths" else short
        third = short if keyed == "even" else second + cad.span(rng, 8, 11)
        lengths = (short, second, third)
        if cad.chance(rng, 0.5):
            lengths = (second, short, third)
        return cls(
            across=across, arm_x=lengths[0], arm_y=lengths[1], arm_z=lengths[2], kind=kind,
            wall=cad.span(rng, 2.6, 3.8), depth=round(short - across + cad.pick(rng, -4, -2), 1),
            screw=screw, web=0.0 if kind == "peg" else cad.pick(rng, 0.0, 4.0, 5.5),
            rise=round(min(short - across - 2.2 * screw, 11), 1),
            corner=cad.pick(rng, 0.0, 0.0, 4.0, 6.0),
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        half = self.across / 2
        bodies, cuts = [], []
        for times, length in enumerate((self.arm_z, self.arm_x, self.arm_y)):
            body, cut = self._arm(length)
            bodies.append(_cycled(body, times))
            cuts.append(_cycled(cut, times))
        if self.corner > 0:
            nick = 2 * self.corner
            cuts.append(cad.at(cad.box(nick, nick, nick), z=-self.corner))
        frame = cad.join(*bodies) - cad.join(*cuts)
        if self.web == 0:
            return frame
        inner = self.across - 1
        rib = cad.at(cad.gusset(self.rise + 1, self.rise + 1, self.web), inner, half, inner)
        return frame + cad.join(*(_cycled(rib, times) for times in range(3)))

    def symmetry(self) -> cad.Symmetry:
        even = self.arm_x == self.arm_y == self.arm_z
        return cad.cyclic(3, (1, 1, 1)) if even else cad.none()

    def _arm(self, length: float) -> tuple[cad.Manifold, cad.Manifold]:
        """The arm along +z, and what is cut from it."""
        half, inner = self.across / 2, self.across - 2 * self.wall
        profile = cad.circle(inner) if self.kind == "round" else cad.rectangle(inner, inner, 1)
        cross = cad.Manifold()
        if self.screw > 0:
            level = length - (self.depth / 2 if self.kind == "peg" else 1.4 * self.screw)
            cross = cad.at(cad.along(cad.cylinder(self.screw, 2 * self.across), "x"), -self.across, z=level)
        if self.kind == "peg":
            body = cad.box(self.across, self.across, length - self.depth)
            body += cad.prism(profile, length, chamfer_top=1)
            return cad.at(body, half, half), cad.at(cross, half, half)
        body = cad.box(self.across, self.across, length)
        cross += cad.at(cad.prism(profile, self.depth + 1), z=length - self.depth)
        return cad.at(body, half, half), cad.at(cross, half, half)


def _cycled(solid: cad.Manifold, times: int) -> cad.Manifold:
    """The solid rotated by 120 degrees `times` times about the diagonal (1, 1, 1): z to x, x to y, y to z."""
    for _ in range(times):
        solid = cad.rotated(cad.rotated(solid, "z", 90), "y", 90)
    return solid
