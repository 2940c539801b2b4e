"""Lever: a bored hub with one or two arms (straight, dog-legged, bell crank) with an eye, slot or pin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.numerics.trigonometry import cosine, sine
from kit1000.parts import cad
from kit1000.symmetry import Symmetry


@dataclass(frozen=True)
class Lever:
    """The hub stands on the origin along z, the first arm runs along +x; all lengths in mm."""

    kind: str  # "straight", "dogleg" or "bell"
    end: str  # "eye", "slot" or "pin"
    hub: float  # diameter
    hub_h: float
    bore: float
    keyed: bool  # a keyway in the bore, on the lever's own axis
    web: float  # thickness of the arms
    flush: bool  # the web lies on the hub's lower face, not at half its height
    arm_a: float  # from the hub's centre to the end's
    arm_b: float  # the second arm; 0: none
    bend_deg: float  # from the first arm to the second, or at the knee of a dog-leg
    end_d: float
    end_h: float
    window: bool  # a slot through the first arm's web

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Lever:
        kind = str(rng.choice(["straight", "dogleg", "bell"], p=[0.2, 0.3, 0.5]))
        end = str(rng.choice(["eye", "slot", "pin"], p=[0.55, 0.25, 0.2]))
        hub = cad.span(rng, 27, 32) if kind == "straight" else cad.span(rng, 17, 23)
        arm_a = cad.span(rng, 30, 38)
        equal = cad.chance(rng, 0.35)
        hub_h = cad.span(rng, 13, 20)
        web = cad.span(rng, 4.5, 7.5)
        return cls(
            kind=kind,
            end=end,
            hub=hub,
            hub_h=hub_h,
            bore=hub * cad.span(rng, 0.42, 0.58, 0.01),
            keyed=cad.chance(rng, 0.4),
            web=web,
            flush=bool(end == "pin" or cad.chance(rng, 0.4)),
            arm_a=arm_a,
            arm_b=0.0 if kind == "straight" else arm_a * (1.0 if equal else cad.span(rng, 0.5, 0.7, 0.01)),
            bend_deg=cad.span(rng, 35, 60) if kind == "dogleg" else cad.span(rng, 75, 125),
            end_d=cad.span(rng, 10.5, 14),
            end_h=cad.span(rng, web, 0.9 * hub_h),
            window=not (kind == "bell" and equal) and cad.chance(rng, 0.4),
        )

    def solid(self) -> Manifold:
        bottom = 0.0 if self.flush else -self.web / 2
        hub = cad.cylinder(self.hub, self.hub_h, chamfer=0.8)
        lever = cad.at(hub, z=0.0 if self.flush else -self.hub_h / 2)
        lever += cad.at(cad.prism(self._web(), self.web), z=bottom)
        for place, angle_deg in self._ends():
            lever = self._ended(lever, place, angle_deg)
        bore = cad.circle(self.bore)
        if self.keyed:
            key = cad.rectangle(self.bore / 2 + 0.14 * self.bore, 0.28 * self.bore)
            bore += key.translate((self.bore / 4 + 0.07 * self.bore, 0)).rotate(self._axis_deg())
        return lever - cad.at(cad.prism(bore, 3 * self.hub_h), z=-1.5 * self.hub_h)

    def symmetry(self) -> Symmetry:
        balanced = self.kind == "straight" or (self.kind == "bell" and self.arm_a == self.arm_b)
        if self.flush or not balanced:
            return Symmetry.none()
        axis = np.radians(self._axis_deg())
        return Symmetry.cyclic(2, (float(cosine(axis)), float(sine(axis)), 0))

    def _axis_deg(self) -> float:
        """Direction of the line that halves the lever."""
        return self.bend_deg / 2 if self.kind == "bell" else 0.0

    def _ends(self) -> list[tuple[tuple[float, float], float]]:
        """Centre (x, y) and direction [deg] of each end."""
        bend = np.radians(self.bend_deg)
        turn = (float(self.arm_b * cosine(bend)), float(self.arm_b * sine(bend)))
        if self.kind == "bell":
            return [((self.arm_a, 0.0), 0.0), (turn, self.bend_deg)]
        if self.kind == "dogleg":
            return [((0.7 * self.arm_a + turn[0], turn[1]), self.bend_deg)]
        return [((self.arm_a, 0.0), 0.0)]

    def _web(self) -> CrossSection:
        """The tapered arms as seen from above."""
        hub, end = cad.circle(0.85 * self.hub), cad.circle(0.9 * self.end_d)
        if self.kind == "dogleg":
            (place, _), knee = self._ends()[0], cad.circle(self.end_d).translate((0.7 * self.arm_a, 0))
            web = (hub + knee).hull() + (knee + end.translate(place)).hull()
        else:
            web = hub
            for place, _ in self._ends():
                web += (hub + end.translate(place)).hull()
        return web - self._window() if self.window else web

    def _window(self) -> CrossSection:
        start = self.hub / 2 + 1.5
        stop = (0.7 if self.kind == "dogleg" else 1.0) * self.arm_a - self.end_d / 2 - 1.5
        length, width = max(stop - start, 4.5), 4.0
        return cad.slot(length, width).translate((start + length / 2, 0))

    def _ended(self, lever: Manifold, place: tuple[float, float], angle_deg: float) -> Manifold:
        """The lever with an eye, a slot or a standing pin at one end."""
        x, y = place
        if self.end == "pin":
            return lever + cad.at(cad.cylinder(0.75 * self.end_d, self.hub_h + 6, chamfer=0.8), x, y)
        boss = cad.cylinder(self.end_d, self.end_h)
        lever += cad.at(boss, x, y, 0.0 if self.flush else -self.end_h / 2)
        hole = cad.circle(0.48 * self.end_d)
        if self.end == "slot":
            hole = cad.slot(0.75 * self.end_d, 0.4 * self.end_d).rotate(angle_deg)
        return lever - cad.at(cad.prism(hole, 4 * self.end_h), x, y, -2 * self.end_h)
