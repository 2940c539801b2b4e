"""Motor mount: a face plate with pilot bore and bolt pattern, held by a back wall, side walls or gussets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad


@dataclass(frozen=True)
class MotorMount:
    """The face plate lies on z = 0, centred; walls rise from its edges: back (-y), left (-x), right (+x)."""

    side: float  # of the plate, along x
    length: float  # of the plate, along y
    plate: float  # thickness
    pilot: float  # bore for the motor's collar
    pitch: float  # of the square motor bolt pattern
    bolt: float
    slotted: bool  # motor bolts in slots along y, to tension a belt
    wall: float  # thickness of the walls
    back: float  # height of each wall over z = 0; 0: none
    left: float
    right: float
    sloped: bool  # side walls are gussets that run out towards +y
    corner: float  # corner cut of the plate at +y
    top: str  # the walls' upper corners: "square", "round" or "clipped" (one of them, far)
    window: bool  # wide slots in the walls, or plain bolt holes

    @classmethod
    def draw(cls, rng: np.random.Generator) -> MotorMount:
        form = cad.pick(rng, "angle", "angle", "one gusset", "two gussets", "cradle", "step", "box")
        side, plate, wall = cad.span(rng, 40, 48), cad.span(rng, 2.6, 7), cad.span(rng, 2.2, 5.5)
        length = round(side * cad.pick(rng, 1.0, 1.0, 1.15, 1.3), 1)
        back = 0.0 if form in ("cradle", "step") else cad.span(rng, 20, 30)
        cheek = back if back > 0 else cad.span(rng, 18, 28)
        left = 0.0 if form in ("angle", "one gusset") else cheek
        right = {"angle": 0.0, "step": round(0.5 * cheek, 1)}.get(form, cheek)
        slotted = cad.chance(rng, 0.35)
        pitch = round((side - 2 * wall - 8) * cad.span(rng, 0.86, 1.0, 0.01), 1)
        pilot = round(pitch * cad.span(rng, 0.72, 0.92, 0.01), 1)
        even_top = cad.pick(rng, "square", "round")
        return cls(
            side=side, length=length, plate=plate, pilot=pilot, pitch=pitch, bolt=cad.span(rng, 3.2, 4.2),
            slotted=slotted, wall=wall, back=back, left=left, right=right, sloped="gusset" in form,
            corner=cad.pick(rng, 0.0, 5.0, 8.0) if back > 0 and form != "box" else 0.0,
            top={"two gussets": "square", "box": "square", "cradle": even_top}.get(form, "clipped"),
            window=cad.chance(rng, 0.45),
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        mount = cad.prism(self._face(), self.plate)
        if self.back > 0:
            wall = self._drilled_wall(self.side, self.back)
            mount += cad.at(cad.along(wall, "-y"), y=self.wall - self.length / 2)
        for height, hand in ((self.left, -1), (self.right, 1)):
            if height > 0:
                mount += self._cheek(height, hand)
        return mount

    def symmetry(self) -> cad.Symmetry:
        twin = self.back == 0 and self.left == self.right and self.left > 0
        return cad.cyclic(2, (0, 0, 1)) if twin else cad.none()

    def _face(self) -> cad.CrossSection:
        """The plate with the holes of the motor."""
        face = cad.rectangle(self.side, self.length)
        if self.corner > 0:
            for x in (-1, 1):
                nick = cad.rectangle(self.corner, self.corner).rotate(45)
                face -= nick.translate((x * self.side / 2, self.length / 2))
        shift = 0.0 if self.back == 0 else self.wall / 2
        bolt = cad.slot(2.2 * self.bolt, self.bolt).rotate(90) if self.slotted else cad.circle(self.bolt)
        pilot = cad.circle(self.pilot)
        if self.slotted:
            pilot = cad.slot(self.pilot + 1.2 * self.bolt, self.pilot).rotate(90)
        for x, y in cad.grid(2, 2, self.pitch, self.pitch):
            face -= bolt.translate((x, y + shift))
        return face - pilot.translate((0, shift))

    def _drilled_wall(self, long: float, height: float) -> cad.Manifold:
        """A wall lying down: `long` along x, its foot at y = 0, with slots or bolt holes above the plate."""
        wall = cad.rectangle(long, height).translate((0, height / 2))
        free, shift = (height + self.plate) / 2, 0.0
        if self.top == "round":
            top = cad.rectangle(long, height, 0.3 * height).translate((0, height / 2))
            wall = cad.hull_2d(top, cad.rectangle(long, 2 * self.plate).translate((0, self.plate)))
        if self.top == "clipped":
            corner, low = (-long / 2, height), height - 0.65 * (height - self.plate)
            wall -= cad.polygon([corner, (-long / 2, low), (-0.2 * long, height)])
            shift = 0.06 * long
        if height - self.plate < 8:  # too low for holes
            return cad.prism(wall, self.wall)
        if self.window:
            width = 0.4 * (height - self.plate)
            wall -= cad.slot(0.55 * long, width).translate((shift, free))
        else:
            for x, _ in cad.grid(2, 1, 0.5 * long, 0):
                wall -= cad.circle(self.bolt).translate((x + shift, free))
        return cad.prism(wall, self.wall)

    def _cheek(self, height: float, hand: int) -> cad.Manifold:
        """The wall at -x (hand -1) or +x: a gusset behind the back wall, or a drilled wall."""
        edge = hand * self.side / 2
        if not self.sloped:
            wall = self._drilled_wall(self.length, height)
            return cad.at(cad.along(wall, "x"), x=edge - (self.wall if hand > 0 else 0))
        rib = cad.rotated(cad.gusset(0.85 * self.length, height, self.wall), "z", 90)
        return cad.at(rib, x=edge - hand * self.wall / 2, y=-self.length / 2)
