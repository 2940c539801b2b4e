"""Elbow: a bent pipe or duct with a flange on one end or both, sometimes on a duck foot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.numerics.trigonometry import cosine, sine
from kit1000.parts import cad
from kit1000.symmetry import Symmetry

BEND_STEP_DEG = 15.0  # the bend is a chain of straight pieces this long


@dataclass(frozen=True)
class Elbow:
    """The bend's axis is z, the first end points along -y; all lengths in mm."""

    duct: str  # "round" or "square" section
    flange: str  # "round", "square" or "oval"
    outside: float  # across the pipe
    bore: float
    radius: float  # of the bend's middle line
    bend_deg: float
    leg_a: float
    leg_b: float
    flange_d: float
    flange_t: float
    bolts: int  # on a round flange
    both: bool  # a flange on the second end too
    foot: bool

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Elbow:
        outside = cad.span(rng, 15, 20)
        flange_d = outside + cad.span(rng, 12, 15)
        duct = cad.pick(rng, "round", "round", "square")
        bend_deg = cad.pick(rng, 60.0, 75.0, 90.0, 90.0, 90.0)
        leg = cad.span(rng, 7, 11) + (flange_d - outside) / 3
        both = cad.chance(rng, 0.65)
        equal = both and cad.chance(rng, 0.4)
        return cls(
            duct=duct,
            flange="square" if duct == "square" else cad.pick(rng, "round", "square", "oval"),
            outside=outside,
            bore=outside - 2 * cad.span(rng, 3, 4.4),
            radius=outside / 2 + cad.span(rng, 3, 9),
            bend_deg=bend_deg,
            leg_a=leg,
            leg_b=leg if equal else leg + cad.span(rng, 10, 16),
            flange_d=flange_d,
            flange_t=cad.span(rng, 4, 6.5),
            bolts=cad.pick(rng, 3, 4, 6),
            both=both,
            foot=bend_deg == 90 and cad.chance(rng, 0.35),
        )

    def solid(self) -> Manifold:
        inside = self.flange_t / 2  # the pipe ends within its flange: no faces that only touch
        ends = self.leg_a - inside, self.leg_b - (inside if self.both else 0)
        elbow = self._swept(self._section(self.outside), *ends)
        flange = cad.at(cad.prism(self._flange(), self.flange_t), z=-self.flange_t)
        elbow += cad.at(cad.along(flange, "-y"), self.radius, -self.leg_a)
        if self.both:
            far = cad.along(cad.rotated(flange, "z", 180), "y")
            bend = np.radians(self.bend_deg)
            x = self.radius * cosine(bend) - self.leg_b * sine(bend)
            y = self.radius * sine(bend) + self.leg_b * cosine(bend)
            elbow += cad.at(cad.rotated(far, "z", self.bend_deg), x, y)
        if self.foot:
            elbow += self._foot()
        return elbow - self._swept(self._section(self.bore), self.leg_a + 5, self.leg_b + 5)

    def symmetry(self) -> Symmetry:
        if self.foot or not self.both or self.leg_a != self.leg_b:
            return Symmetry.none()
        half = np.radians(self.bend_deg / 2)
        return Symmetry.cyclic(2, (float(cosine(half)), float(sine(half)), 0))

    def _section(self, across: float) -> CrossSection:
        return cad.circle(across) if self.duct == "round" else cad.rectangle(across, across, across / 6)

    def _swept(self, section: CrossSection, leg_a: float, leg_b: float) -> Manifold:
        """The section led through leg, bend and leg.

        Extruded in unit steps, then bent: level 0 is the first end, levels 1 to last - 1 stand on the
        bend, the last level is the second end.
        """
        last = int(np.ceil(self.bend_deg / BEND_STEP_DEG)) + 2
        bend = np.radians(self.bend_deg)

        def bent(points: np.ndarray) -> np.ndarray:
            level = np.round(points[:, 2])
            angle = bend * np.clip((level - 1) / (last - 2), 0, 1)
            ahead = np.where(level == 0, -leg_a, 0.0)
            ahead += np.where(level == last, leg_b, 0.0)
            out = self.radius + points[:, 0]
            x = out * cosine(angle) - ahead * sine(angle)
            y = out * sine(angle) + ahead * cosine(angle)
            return np.stack([x, y, -points[:, 1]], axis=1)

        return section.extrude(last, last - 1).warp_batch(bent)

    def _flange(self) -> CrossSection:
        """The flange with its bolt holes, seen along the pipe; x points away from the bend's axis."""
        margin = (self.flange_d - self.outside) / 2
        reach = (self.flange_d + self.outside) / 4
        if self.flange == "oval":
            ear = cad.circle(1.1 * margin)
            ears = ear.translate((0, reach)), ear.translate((0, -reach))
            outline = cad.hull_2d(cad.circle(self.outside + 4), *ears)
            places = [(0.0, reach), (0.0, -reach)]
        elif self.flange == "square":
            side = 0.9 * self.flange_d
            outline = cad.rectangle(side, side, margin / 3)
            places = cad.grid(2, 2, side - 0.9 * margin, side - 0.9 * margin)
        else:
            outline = cad.circle(self.flange_d)
            places = cad.bolt_circle(2 * reach, self.bolts)
        for place in places:
            outline -= cad.circle(0.48 * margin).translate(place)
        return outline

    def _foot(self) -> Manifold:
        """A duck foot: a drilled sole opposite the first flange, on a column under the bend."""
        sole_y = self.radius + self.outside / 2 + 4
        column = cad.prism(cad.rectangle(0.5 * self.outside, 0.8 * self.outside), sole_y)
        sole = cad.rectangle(1.2 * self.outside, self.flange_d, radius=2)
        sole -= cad.holes(4.4, [(0, 0.4 * self.flange_d), (0, -0.4 * self.flange_d)])
        foot = column + cad.at(cad.prism(sole, self.flange_t), z=sole_y - self.flange_t)
        return cad.at(cad.along(foot, "y"), self.radius)
