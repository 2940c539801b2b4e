"""Grilles: perforated panels with a stiffening rim, round, hexagonal or slotted openings and a mounting lug."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import CrossSection, Manifold, Symmetry


@dataclass(frozen=True)
class Grille:
    """A panel on z = 0 inside a rim of the given height."""

    outline: str  # cut (a rectangle without a corner), triangle, dee or lug
    x: float
    y: float
    panel: float  # thickness of the panel
    rim: float  # height of the rim
    wall: float
    openings: str  # round, hex, slots or none
    opening: float
    bridge: float  # material between openings
    stud: float  # diameter of studs in the corners, 0 for none
    pilot: float  # hole in each stud, as a part of its diameter

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Grille:
        x = cad.span(rng, 34, 45)
        return cls(
            outline=cad.pick(rng, "cut", "triangle", "dee", "lug"),
            x=x,
            y=round(cad.span(rng, 0.6, 0.9, 0.01) * x, 1),
            panel=cad.span(rng, 1.9, 3),
            rim=cad.span(rng, 8, 13),
            wall=cad.span(rng, 1.9, 3),
            openings=cad.pick(rng, "round", "hex", "hex", "slots", "slots", "none"),
            opening=cad.span(rng, 3, 7),
            bridge=cad.span(rng, 1.9, 2.6),
            stud=cad.span(rng, 4.5, 6.5) if cad.chance(rng, 0.5) else 0.0,
            pilot=cad.span(rng, 0.4, 0.55, 0.05),
        )

    def solid(self) -> Manifold:
        outer = self._outline()
        inner = outer.offset(-self.wall)
        panel = outer - self._perforation(inner.offset(-self.bridge))
        return cad.join(cad.prism(panel, self.panel), cad.prism(outer - inner, self.rim), *self._studs())

    def symmetry(self) -> Symmetry:
        return cad.none()

    def _outline(self) -> CrossSection:
        x, y = self.x, self.y
        if self.outline == "triangle":
            return cad.rounded(cad.polygon([(-x / 2, -y / 2), (x / 2, -y / 2), (-0.3 * x, y / 2)]), 2.5)
        if self.outline == "dee":
            round_end = cad.circle(0.8 * y).translate((x / 2 - 0.4 * y, 0.1 * y))
            return cad.hull_2d(cad.rectangle(x / 3, y, 2).translate((-x / 3, 0)), round_end)
        if self.outline == "cut":
            corner = cad.polygon([(x / 2, 0.02 * y), (x / 2, y / 2), (0.1 * x, y / 2)])
            return cad.rounded(cad.rectangle(x, y) - corner, 2)
        lug = cad.rectangle(0.3 * x, y, 2).translate((-0.25 * x, 0.25 * y))
        return cad.rounded(cad.rectangle(x, y) + lug, 1.5)

    def _perforation(self, inside: CrossSection) -> CrossSection:
        """Whole openings within the area that is left for them."""
        if self.openings == "none":
            return CrossSection()
        pitch = self.opening + self.bridge
        if self.openings == "slots":
            count = int(self.y / pitch) + 2
            bars = [
                cad.rectangle(2 * self.x, self.opening).translate((0, (k - count / 2) * pitch)) for k in range(count)
            ]
            return CrossSection.compose(bars) ^ inside
        one = cad.circle(self.opening) if self.openings == "round" else cad.ngon(6, self.opening)
        rows, columns = int(self.y / (0.866 * pitch)) + 2, int(self.x / pitch) + 2
        places = [
            ((c - columns / 2 + 0.5 * (r % 2)) * pitch, (r - rows / 2) * 0.866 * pitch)
            for r in range(rows)
            for c in range(columns)
        ]
        whole = [hole for hole in map(one.rotate(30).translate, places) if (hole - inside).is_empty()]
        return CrossSection.compose(whole) if whole else CrossSection()

    def _studs(self) -> list[Manifold]:
        """Screw studs in the two corners at -x."""
        if self.stud == 0:
            return []
        stud = cad.ring(self.stud, self.pilot * self.stud)
        inset = self.stud / 2 + 0.3 * self.wall
        x = -self.x / 2 + inset
        corners = [(x, -self.y / 2 + inset)]
        if self.outline != "triangle":
            corners.append((x, self.y / 2 - inset))
        return [cad.prism(stud.translate(corner), 0.85 * self.rim) for corner in corners]
