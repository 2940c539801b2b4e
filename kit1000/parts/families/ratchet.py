"""Ratchet: an index wheel, a toothed sector on its hub, or the pawl that falls into either."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kit1000.numerics.trigonometry import cosine, sine
from kit1000.parts import cad


@dataclass(frozen=True)
class Ratchet:
    """The pivot runs along z through the origin, the plate lies on z = 0."""

    kind: str  # "wheel", "sector" or "pawl"
    plate: float  # thickness
    hub: float  # diameter around the pivot
    hub_h: float  # over z = 0
    bore: float
    radius: float  # to the tips of the teeth, or to the nose of the pawl
    teeth: int  # a full wheel's, or those on the sector
    tooth: float  # depth of a tooth
    pitch_deg: float  # from tooth to tooth
    arm: float  # lever opposite to the sector's teeth, from the pivot to its eye; 0: none
    tail: float  # the pawl's spring tail, from the pivot; 0: none
    drop: float  # how far the pawl's nose hangs below its pivot line
    eye: float  # hole in arm or tail
    window: bool  # a slot in the sector's plate

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Ratchet:
        kind = cad.pick(rng, "wheel", "sector", "sector", "pawl", "pawl")
        teeth = cad.pick(rng, 6, 7, 8) if kind == "wheel" else cad.pick(rng, 4, 5, 6)
        hub = cad.span(rng, 14, 19)
        plate = cad.span(rng, 9, 12.5) if kind == "pawl" else cad.span(rng, 7.5, 11)
        return cls(
            kind=kind, plate=plate, hub=hub, hub_h=plate + cad.span(rng, 8, 12),
            bore=cad.span(rng, 6, hub - 6), teeth=teeth,
            radius=cad.span(rng, 24, 27) if kind == "wheel" else cad.span(rng, 30, 36),
            tooth=cad.span(rng, 8.5, 10) if kind == "wheel" else cad.span(rng, 4, 5.5),
            pitch_deg=360 / teeth if kind == "wheel" else cad.span(rng, 14, 20),
            arm=cad.span(rng, 15, 21) if cad.chance(rng, 0.55) else 0.0,
            tail=cad.span(rng, 15, 20) if cad.chance(rng, 0.6) else 0.0, drop=cad.span(rng, 9, 14),
            eye=cad.span(rng, 3.2, 4.6), window=cad.chance(rng, 0.6),
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        outline = {"wheel": self._wheel, "sector": self._sector, "pawl": self._pawl}[self.kind]()
        ratchet = cad.prism(outline, self.plate, chamfer=0.5) + cad.cylinder(self.hub, self.hub_h, 0.7)
        return cad.drill(ratchet, self.bore)

    def symmetry(self) -> cad.Symmetry:
        return cad.cyclic(self.teeth, (0, 0, 1)) if self.kind == "wheel" else cad.none()

    def _saw(self, first_deg: float) -> NDArray[np.float64]:
        """Points (2 * teeth, 2) of the saw teeth, counter-clockwise, each rising slowly to its tip."""
        steps = np.deg2rad(first_deg + self.pitch_deg * np.arange(self.teeth))
        tips, roots = steps + np.deg2rad(0.94 * self.pitch_deg), steps
        angles = np.column_stack([roots, tips]).ravel()
        radii = np.tile([self.radius - self.tooth, self.radius], self.teeth)
        return np.column_stack([radii * cosine(angles), radii * sine(angles)])

    def _wheel(self) -> cad.CrossSection:
        return cad.polygon(self._saw(0))

    def _sector(self) -> cad.CrossSection:
        """Teeth on an arc about +x, its flanks running to the hub, and the lever opposite."""
        span_deg = self.teeth * self.pitch_deg
        body = cad.polygon(np.vstack([[(-2.0, 0.0)], self._saw(-span_deg / 2)])) + cad.circle(self.hub)
        if self.window:
            inner, outer = self.hub / 2 + 3, self.radius - self.tooth - 3.5
            band = cad.ring(2 * outer, 2 * inner) ^ cad.sector(4 * outer, 9 - span_deg / 2, span_deg / 2 - 9)
            body -= cad.rounded(band, 1.2)
        if self.arm == 0:
            return body
        end = (-0.8 * self.arm, -0.6 * self.arm)
        lever = cad.hull_2d(cad.circle(0.75 * self.hub), cad.circle(2.4 * self.eye).translate(end))
        return body + lever - cad.circle(self.eye).translate(end)

    def _pawl(self) -> cad.CrossSection:
        """A finger from the eye out along +x, hooked down to its nose; the spring tail behind."""
        reach, thick = self.radius, 0.62 * self.hub
        back = [(0, self.hub / 2), (0.55 * reach, thick / 2 + 1), (reach, -0.35 * self.drop)]
        belly = [(reach, -self.drop), (reach - 7, -0.45 * self.drop), (0.45 * reach, -thick / 2)]
        pawl = cad.rounded(cad.polygon([*back, *belly, (0, -self.hub / 2)]), 0.8) + cad.circle(self.hub)
        if self.tail == 0:
            return pawl
        end = (-0.75 * self.tail, 0.66 * self.tail)
        tail = cad.hull_2d(cad.circle(0.6 * self.hub), cad.circle(2.3 * self.eye).translate(end))
        return pawl + tail - cad.circle(self.eye).translate(end)
