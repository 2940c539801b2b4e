"""Knob: a hand grip (star, bar, wing, pointer or turned) on a bored hub."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.parts import cad
from kit1000.symmetry import Symmetry


@dataclass(frozen=True)
class Knob:
    """The grip lies on the xy plane, its first lobe along +x, the hub stands on it; all lengths in mm."""

    grip: str  # "star", "bar", "wing", "pointer" or "turned"
    lobes: int  # of a star
    across: float  # widest diameter of the grip
    core: float  # diameter of its middle
    lobe: float  # diameter of a lobe, width of a bar, of a wing or of a pointer's nose
    grip_h: float
    chamfer: float
    hub: float
    hub_h: float  # 0: none, the grip is the same from both sides
    bore: float
    recess: float  # diameter of the dish in the free face, 0: none
    web: bool  # holes through the lobes
    blind: bool  # the bore ends in the grip

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Knob:
        grip = str(rng.choice(["star", "bar", "wing", "pointer", "turned"], p=[0.4, 0.12, 0.14, 0.2, 0.14]))
        across, hub = cad.span(rng, 42, 52), cad.span(rng, 14, 19)
        bore = cad.span(rng, 6, 9)
        flat = grip == "star" and cad.chance(rng, 0.3)
        core = {
            "star": cad.span(rng, 0.46, 0.56, 0.01) * across,
            "bar": 1.25 * hub,
            "wing": 1.1 * hub,
            "pointer": cad.span(rng, 0.52, 0.62, 0.01) * across,
            "turned": 1.5 * hub,
        }[grip]
        lobes = int(rng.integers(3, 6))
        lobe = {
            "star": across * cad.span(rng, 0.9, 1.05, 0.01) / lobes,
            "bar": cad.span(rng, 10, 14),
            "wing": cad.span(rng, 5, 7),
            "pointer": cad.span(rng, 7, 12),
            "turned": cad.span(rng, 3, 5),
        }[grip]
        return cls(
            grip=grip,
            lobes=lobes,
            across=across,
            core=core,
            lobe=lobe,
            grip_h=cad.span(rng, 16, 24) if grip == "wing" else cad.span(rng, 8, 14),
            chamfer=cad.pick(rng, 0.6, 1.2, 2.0),
            hub=hub,
            hub_h=0.0 if flat else cad.span(rng, 9, 15),
            bore=bore,
            recess=0.0 if flat or cad.chance(rng, 0.5) else bore + cad.span(rng, 5, 7),
            web=grip == "star" and cad.chance(rng, 0.4),
            blind=not flat and cad.chance(rng, 0.35),
        )

    def solid(self) -> Manifold:
        turned = self.grip == "turned"
        grip = self._turned() if turned else cad.prism(self._outline(), self.grip_h, self.chamfer)
        if self.grip == "wing":  # wings rise outward from the hub
            slope = cad.hull(
                cad.at(cad.box(2, self.across, 0.1), self.core / 2, 0, self.grip_h),
                cad.at(cad.box(2, self.across, 0.1), self.across / 2, 0, self.grip_h),
                cad.at(cad.box(2, self.across, 0.1), self.across / 2, 0, 0.55 * self.grip_h),
            )
            grip = grip - slope - cad.rotated(slope, "z", 180)
        knob = grip
        if self.hub_h > 0:
            knob += cad.cylinder(self.hub, self.grip_h + self.hub_h, chamfer=0.8)
        if self.recess > 0:
            knob -= cad.at(cad.cylinder(self.recess, 3), z=-1)
        if self.blind:
            return cad.drill(knob, self.bore, (0, 0, self.grip_h + self.hub_h), depth=self.hub_h + 2)
        return cad.drill(knob, self.bore)

    def symmetry(self) -> Symmetry:
        up = (0, 0, 1)
        if self.grip == "turned":
            return Symmetry.free(up)
        if self.grip == "pointer":
            return Symmetry.none()
        if self.grip != "star":
            return Symmetry.cyclic(2, up)
        if self.hub_h > 0:
            return Symmetry.cyclic(self.lobes, up)
        return Symmetry.dihedral(self.lobes, up, (1, 0, 0))

    def _outline(self) -> CrossSection:
        """The grip as seen from above."""
        core = cad.circle(self.core)
        reach = (self.across - self.lobe) / 2
        if self.grip == "pointer":
            nose = cad.circle(self.lobe).translate((self.across - self.core / 2 - self.lobe / 2, 0))
            return cad.hull_2d(core, nose)
        if self.grip in ("bar", "wing"):
            return core + cad.slot(self.across, self.lobe)
        arm = cad.hull_2d(cad.circle(self.lobe).translate((reach, 0)), cad.circle(0.8 * self.lobe))
        hole = cad.circle(0.4 * self.lobe).translate((reach, 0))
        lobe = arm - hole if self.web else arm
        for k in range(self.lobes):
            core += lobe.rotate(360 * k / self.lobes)
        return core

    def _turned(self) -> Manifold:
        """A mushroom: a rim of full diameter that falls away to the core."""
        rim, core, height = self.across / 2, self.core / 2, self.grip_h
        edge = self.chamfer
        return cad.revolved(
            [(0, 0), (rim - edge, 0), (rim, edge), (rim, self.lobe + edge), (core, height), (0, height)]
        )
