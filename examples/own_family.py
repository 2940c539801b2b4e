"""python examples/own_family.py

Defines a part family of your own, checks it, and makes the kit of one drawing. A family is a frozen dataclass of
dimensions in millimetres that draws itself, builds its solid and states its symmetry. Takes 3 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from kit1000 import Symmetry, make_kit, make_part
from kit1000.parts import cad
from kit1000.testing import check_family


@dataclass(frozen=True)
class Spacer:
    """A six-sided pillar on a round foot, with a bore through both."""

    across: float
    height: float
    foot: float
    bore: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Spacer:
        """Random dimensions [mm]."""
        across = cad.span(rng, 14, 20)
        return cls(across, cad.span(rng, 20, 40), cad.span(rng, 26, 34), cad.span(rng, 3, 0.5 * across))

    def solid(self) -> Manifold:
        """The part [mm], at any place."""
        pillar = cad.prism(cad.ngon(6, self.across), self.height) + cad.cylinder(self.foot, 5)
        return cad.drill(pillar, self.bore, [(0, 0, self.height)])

    def symmetry(self) -> Symmetry:
        """Six rotations about the upright axis."""
        return cad.cyclic(6)


def main() -> None:
    """Check the family and make a kit."""
    check_family(Spacer, seeds=range(2))  # raises AssertionError with one line when a promise is broken
    part = make_part("spacer-0", "spacer", Spacer.draw(np.random.default_rng(7)), longest=0.045)
    kit = make_kit(part, clearance=2.5e-3)
    print(f"part of {np.round(part.mesh.extents * 1e3, 1)} mm, kit with a cavity {kit.slot.depth * 1e3:.1f} mm deep")
    print(f"goals: {len(kit.slot.goals)}, free axis: {'no' if kit.slot.free_axis is None else 'yes'}")


if __name__ == "__main__":
    main()
