"""Servo horn: a splined hub carrying one to four tapered arms with rows of holes or slots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.numerics.trigonometry import cosine, sine
from kit1000.parts import cad

LENGTHS = {
    "single": (1.0, 0.0, 0.0, 0.0),
    "double": (1.0, 0.0, 1.0, 0.0),
    "offset double": (1.0, 0.0, 0.55, 0.0),
    "corner": (1.0, 0.62, 0.0, 0.0),
    "tee": (0.62, 1.0, 0.62, 0.0),
    "cross": (1.0, 1.0, 1.0, 1.0),
    "long cross": (1.0, 0.6, 1.0, 0.6),
    "stepped cross": (1.0, 0.6, 0.55, 0.6),
}
"""Length of the arms along +x, +y, -x, -y as shares of the longest."""
TEETH = 12
"""Teeth of the socket: a multiple of 3 and 4, so that every form keeps its symmetry."""


@dataclass(frozen=True)
class ServoHorn:
    """The arms lie on z = 0, the hub stands on the origin along +z."""

    form: str  # a name of LENGTHS, or "star": three equal arms
    arm: float  # length of the longest arm, from the hub's centre to the centre of its tip
    hub: float  # diameter
    hub_h: float  # over z = 0
    root: float  # width of an arm at the hub
    tip: float  # width of an arm at its end
    web: float  # thickness of the arms
    spline: float  # diameter of the toothed socket
    socket: float  # depth of the socket, from the hub's end
    screw: float  # hole through the rest
    hole: float  # in the arms
    slotted: bool  # one slot in each arm, or a row of holes
    tip_boss: float  # height over z = 0 of a collar at the tip of every arm; 0: none

    @classmethod
    def draw(cls, rng: np.random.Generator) -> ServoHorn:
        form = cad.pick(rng, "star", *LENGTHS)
        slender = form in ("single", "double", "offset double")
        hub = cad.span(rng, 24, 28) if slender else cad.span(rng, 18, 24)
        web, tip = cad.span(rng, 5.5, 8), cad.span(rng, 10, 14)
        hub_h = web + cad.span(rng, 10, 15)
        return cls(
            form=form, arm=cad.span(rng, 20, 24) if form == "double" else cad.span(rng, 22, 28), hub=hub,
            hub_h=hub_h, tip=tip, web=web,
            root=round(hub * cad.span(rng, 0.8, 0.98, 0.01), 1),
            spline=round(hub * cad.span(rng, 0.45, 0.6, 0.01), 1),
            socket=round(hub_h * cad.span(rng, 0.4, 0.7, 0.01), 1), screw=cad.span(rng, 3, 4.5),
            hole=round(tip * cad.span(rng, 0.3, 0.45, 0.01), 1), slotted=cad.chance(rng, 0.4),
            tip_boss=round(0.6 * hub_h, 1) if "cross" not in form and cad.chance(rng, 0.35) else 0.0,
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        arms = self._arms()
        web = cad.circle(self.hub)
        for length, angle_deg in arms:
            web += self._arm(length).rotate(angle_deg)
        for length, angle_deg in arms:
            web -= self._openings(length).rotate(angle_deg)
        horn = cad.prism(web, self.web) + cad.prism(cad.circle(self.hub), self.hub_h, chamfer_top=0.7)
        if self.tip_boss > 0:
            for length, angle_deg in arms:
                collar = cad.tube(self.tip, self.hole, self.tip_boss)
                horn += cad.rotated(cad.at(collar, length), "z", angle_deg)
        horn = cad.pocket(horn, self._spline(), self.socket, (0, 0, self.hub_h))
        return cad.drill(horn, self.screw)

    def symmetry(self) -> cad.Symmetry:
        fold = {"star": 3, "double": 2, "cross": 4, "long cross": 2}.get(self.form, 1)
        return cad.cyclic(fold, (0, 0, 1)) if fold > 1 else cad.none()

    def _arms(self) -> list[tuple[float, float]]:
        """Length and direction [deg] of each arm."""
        if self.form == "star":
            return [(self.arm, 120.0 * k) for k in range(3)]
        shares = LENGTHS[self.form]
        return [(share * self.arm, 90.0 * k) for k, share in enumerate(shares) if share > 0]

    def _arm(self, length: float) -> cad.CrossSection:
        """A tapered arm along +x."""
        root = cad.rectangle(0.1, self.root)
        return cad.hull_2d(root, cad.circle(self.tip).translate((length, 0)))

    def _openings(self, length: float) -> cad.CrossSection:
        """The slot or the row of holes in an arm along +x."""
        start, end = self.hub / 2 + self.hole / 2 + 1.6, length
        if self.slotted and self.tip_boss == 0 and end - start > self.hole:
            return cad.slot(end - start + self.hole, self.hole).translate(((start + end) / 2, 0))
        count = 1 if self.tip_boss > 0 else min(3, max(1, int((end - start) / (2 * self.hole)) + 1))
        stations = np.linspace(end, end - 2 * self.hole * (count - 1), count)
        return cad.holes(self.hole, [(float(x), 0.0) for x in stations])

    def _spline(self) -> cad.CrossSection:
        """The toothed socket: points alternating between two circles."""
        angles = np.arange(2 * TEETH) * np.pi / TEETH
        radii = np.where(np.arange(2 * TEETH) % 2, 0.44, 0.5) * self.spline
        return cad.polygon(np.column_stack([radii * cosine(angles), radii * sine(angles)]))
