"""Clip: a pipe or cable clip of bent strip (P-clip, saddle) or a moulded snap clip on a foot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold

from kit1000.numerics.trigonometry import cosine, sine
from kit1000.parts import cad
from kit1000.symmetry import Symmetry


@dataclass(frozen=True)
class Clip:
    """The pipe runs along z through the origin, the clip is screwed down along -y; all lengths in mm."""

    kind: str  # "p", "saddle" or "snap"
    pipe: float  # diameter held
    pipes: int  # side by side under a saddle
    strip: float  # thickness of the strip
    depth: float  # along the pipe
    foot_a: float  # length of the foot at +x
    foot_b: float  # length of the foot at -x
    foot_t: float
    opening_deg: float  # mouth of a snap clip
    hole: float
    holes: int  # side by side in each foot
    round_feet: bool
    rib: bool  # a stiffening rib over the strip

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Clip:
        kind = str(rng.choice(["p", "saddle", "snap"], p=[0.3, 0.4, 0.3]))
        pipes = cad.pick(rng, 1, 1, 2) if kind == "saddle" else 1
        pipe = cad.span(rng, 11, 14) if pipes == 2 else cad.span(rng, 16, 24)
        strip = cad.span(rng, 3, 4.5)
        depth = cad.span(rng, 18, 28) + 6 * (pipes - 1)
        foot = cad.span(rng, 11, 16)
        equal = kind != "p" and cad.chance(rng, 0.4)
        holes = 2 if depth > 22 and cad.chance(rng, 0.4) else 1
        return cls(
            kind=kind,
            pipe=pipe,
            pipes=pipes,
            strip=strip,
            depth=depth,
            foot_a=foot,
            foot_b=foot if equal else (0.0 if kind == "p" else cad.span(rng, 0, 2)),
            foot_t=strip if kind == "saddle" else cad.span(rng, 4, 7),
            opening_deg=cad.span(rng, 80, 130),
            hole=cad.span(rng, 4, 6.5),
            holes=holes,
            round_feet=holes == 1 and cad.chance(rng, 0.5),
            rib=kind != "snap" and pipes == 1 and cad.chance(rng, 0.5),
        )

    def solid(self) -> Manifold:
        clip = cad.prism(self._profile(), self.depth)
        if self.rib:
            ridge = cad.ring(self.pipe + 4 * self.strip, self.pipe + self.strip)
            above = cad.rectangle(4 * self.pipe, 4 * self.pipe)
            ridge ^= above.translate((0, 2 * self.pipe - 0.5 * self.strip))
            clip += cad.at(cad.prism(ridge, 0.25 * self.depth), z=0.375 * self.depth)
        for foot, side in ((self.foot_a, 1), (self.foot_b, -1)):
            if foot > 2 * self.strip:
                clip = self._drilled(clip, side * (self._reach() + foot / 2), foot, side)
        return clip

    def symmetry(self) -> Symmetry:
        return Symmetry.cyclic(2, (0, 1, 0)) if self.foot_a == self.foot_b else Symmetry.none()

    def _reach(self) -> float:
        """Half the width of what the feet stand out from."""
        return self.pipe / 2 + self.strip + (self.pipes - 1) * (self.pipe + self.strip) / 2

    def _profile(self) -> CrossSection:
        """The clip as seen along the pipe."""
        reach, below = self._reach(), -self.pipe / 2 - self.strip
        band = cad.ring(2 * reach, self.pipe)
        if self.kind == "saddle":
            arches = self._arches(self.pipe + 2 * self.strip, -below)
            feet = self._feet(below, below + self.foot_t)
            return arches + feet - self._arches(self.pipe, 2 * self.pipe)
        if self.kind == "p":
            tail = cad.rectangle(reach + self.foot_a, self.foot_t)
            tail = tail.translate(((reach + self.foot_a) / 2, below + self.foot_t / 2))
            return band + tail - cad.circle(self.pipe)
        half = self.opening_deg / 2
        jaw = band - cad.sector(6 * reach, 90 - half, 90 + half)
        for side in (-1, 1):
            angle = np.radians(90 + side * half)
            middle = self.pipe / 2 + self.strip / 2
            lip = cad.circle(1.5 * self.strip)
            jaw += lip.translate(((middle + 0.3) * cosine(angle), (middle + 0.3) * sine(angle)))
        return jaw + self._feet(below + 1 - self.foot_t, below + 1) + self._pillar(below)

    def _arches(self, width: float, depth: float) -> CrossSection:
        """An arch of this width over each pipe, down to `depth` below the pipes' axes."""
        arch = cad.circle(width) + cad.rectangle(width, depth).translate((0, -depth / 2))
        places = cad.grid(self.pipes, 1, self.pipe + self.strip, 0)
        return CrossSection.compose([arch.translate(place) for place in places])

    def _feet(self, low: float, high: float) -> CrossSection:
        """Both feet as one bar."""
        left, right = -self._reach() - self.foot_b, self._reach() + self.foot_a
        return cad.rectangle(right - left, high - low).translate(((left + right) / 2, (low + high) / 2))

    def _pillar(self, below: float) -> CrossSection:
        """The neck between a snap clip's foot and its jaw."""
        neck = cad.rectangle(0.6 * self.pipe, 2 * self.strip).translate((0, below + self.strip))
        return neck - cad.circle(self.pipe)

    def _drilled(self, clip: Manifold, x: float, foot: float, side: int) -> Manifold:
        """Screw holes through one foot, whose end is rounded if the clip has round feet."""
        for k in range(self.holes):
            z = self.depth * (k + 1) / (self.holes + 1)
            clip = cad.drill(clip, self.hole, at=(x, 0, z), axis="y")
        if not self.round_feet:
            return clip
        radius = min(foot, self.depth / 2)
        start, end = side * (self._reach() + foot - radius), side * (self._reach() + foot + 1)
        corner = cad.rectangle(radius + 1, self.depth + 2).translate(((start + end) / 2, 0))
        corner -= cad.circle(2 * radius).translate((start, 0))
        waste = cad.at(cad.prism(corner, 6 * self.pipe), z=-3 * self.pipe)
        return clip - cad.at(cad.rotated(waste, "x", 90), z=self.depth / 2)
