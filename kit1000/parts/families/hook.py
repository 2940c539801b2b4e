"""Hook: a jaw of flat bar on a shank, hung by an eye, by a wall plate, or by a second jaw (S-hook)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.numerics.trigonometry import cosine, sine
from kit1000.parts import cad
from kit1000.symmetry import Symmetry


@dataclass(frozen=True)
class Hook:
    """The jaw lies in xy about the origin, its shank runs up +y; all lengths in mm."""

    mount: str  # "eye", "plate", "jaw" or "fork"
    throat: float  # inside diameter of the jaw
    bar: float  # width of the bar in the plane of the jaw
    thick: float  # thickness of the bar along z
    shank: float  # from the jaw's centre to the mount
    wrap_deg: float  # angle of the jaw, from the shank to the tip
    tip: float  # diameter of the rounded tip; 0: cut square
    hole: float  # of the eye or of the screws
    head: float  # eye diameter, width of the wall plate along z, or the second jaw's throat
    chamfer: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Hook:
        mount = str(rng.choice(["eye", "plate", "jaw", "fork"], p=[0.35, 0.3, 0.2, 0.15]))
        throat, bar = cad.span(rng, 14, 22), cad.span(rng, 7, 10)
        hole = cad.span(rng, 3.5, 5) if mount == "plate" else cad.span(rng, 5, 9)
        same = cad.chance(rng, 0.5)  # an S-hook of two equal jaws
        head = {
            "eye": hole + 2 * cad.span(rng, 4.5, 7),
            "plate": cad.span(rng, 26, 34),
            "jaw": throat if same else throat * cad.span(rng, 0.45, 0.6, 0.01),
            "fork": cad.span(rng, 17, 22),
        }[mount]
        return cls(
            mount=mount,
            throat=throat,
            bar=bar,
            thick=cad.span(rng, 8, 12) if mount == "plate" else cad.span(rng, 11, 18),
            shank=cad.span(rng, 2, 10) if mount == "jaw" else cad.span(rng, 12, 22),
            wrap_deg=cad.span(rng, 170, 235),
            tip=bar * cad.pick(rng, 0.0, 1.0, 1.35),
            hole=hole,
            head=head,
            chamfer=cad.pick(rng, 0, 0.8, 1.2),
        )

    def solid(self) -> Manifold:
        axis = (self.throat + self.bar) / 2  # x of the middle of the shank
        profile = self._jaw(self.throat)
        if self.mount == "jaw":
            return cad.prism(profile + self._second_jaw(axis), self.thick, chamfer=self.chamfer)
        if self.mount == "plate":
            hook = cad.prism(profile, self.thick, chamfer=self.chamfer)
            return self._wall_plate(hook, axis + self.bar / 2)
        y = self.shank + self.head / 3
        if self.mount == "eye":
            profile += cad.circle(self.head).translate((axis, y))
            profile -= cad.circle(self.hole).translate((axis, y))
            return cad.prism(profile, self.thick, chamfer=self.chamfer)
        profile += cad.rectangle(self.head, self.head, self.bar / 4).translate((axis, y))
        fork = cad.prism(profile, self.thick, chamfer=self.chamfer)
        fork -= cad.at(cad.box(self.head + 2, self.head, self.thick / 3), axis, y + 1, self.thick / 3)
        return cad.drill(fork, self.hole, at=(axis, y))

    def symmetry(self) -> Symmetry:
        two_fold = self.mount == "jaw" and self.head == self.throat
        return Symmetry.cyclic(2, (0, 0, 1)) if two_fold else Symmetry.none()

    def _jaw(self, throat: float) -> CrossSection:
        """The bar's outline: outer arc, tip, inner arc, shank."""
        inner, outer = throat / 2, throat / 2 + self.bar
        bend = cad.polygon(
            [
                *cad.arc_points((0, 0), outer, -self.wrap_deg, 0),
                (outer, self.shank),
                (inner, self.shank),
                *cad.arc_points((0, 0), inner, 0, -self.wrap_deg),
            ]
        )
        if self.tip == 0:
            return bend
        end = np.radians(-self.wrap_deg)
        middle = (inner + outer) / 2
        return bend + cad.circle(self.tip).translate((middle * cosine(end), middle * sine(end)))

    def _second_jaw(self, axis: float) -> CrossSection:
        """The other end of an S-hook: a jaw rotated by 180 degrees about the middle of the shank."""
        own_axis = (self.head + self.bar) / 2
        return self._jaw(self.head).rotate(180).translate((axis + own_axis, self.shank))

    def _wall_plate(self, hook: Manifold, back: float) -> Manifold:
        """A screwed plate behind the shank; it ends above the shank and hangs half way down the jaw."""
        plate_t, low, high = 0.55 * self.bar, -0.4 * self.throat, self.shank + 0.35 * self.head
        plate = cad.prism(cad.rectangle(high - low, self.head, radius=3), plate_t + 1)
        upright = cad.along(plate, "x")
        middle = self.thick / 2
        fixed = hook + cad.at(upright, back - 1, (low + high) / 2, middle)
        for side in (-1, 1):
            place = (0, high - 6, middle + side * (self.head / 2 - 6))
            fixed = cad.drill(fixed, self.hole, at=place, axis="x")
        return fixed
