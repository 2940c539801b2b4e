"""Cover: a lid with a standing rim, screw bosses, ears, a window and a cable notch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import JoinType

from kit1000.parts import cad


@dataclass(frozen=True)
class Cover:
    """The lid lies on z = 0, centred on its full rectangle; the rim stands up from it."""

    length: float
    width: float
    lid: float  # thickness
    rim: float  # height of the rim over z = 0
    wall: float  # thickness of the rim
    ledge: float  # how far the rim stands inside the lid's edge
    outline: str  # "plain", "nosed" (narrow at +x), "clipped" or "stepped" (one corner off)
    corner: float  # radius of the lid's corners
    ears: int  # screw ears: 0, 1 at +x, or 2, one at each end
    ear: float  # how far an ear stands out
    bosses: bool  # screw posts in the corners of the rim
    post: float  # diameter of the posts
    screw: float
    window: str  # "none", "round", "slots" or "field"
    notch: float  # width of the cable notch in the rim at -x, and at +x of an even cover; 0: none

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Cover:
        outline = cad.pick(rng, "plain", "plain", "nosed", "clipped", "stepped")
        ears = cad.pick(rng, 0, 0, 2) if outline == "plain" else cad.pick(rng, 0, 0, 1)
        length = cad.span(rng, 38, 50)
        return cls(
            length=length, width=round(length * cad.span(rng, 0.58, 0.78, 0.01), 1),
            lid=cad.span(rng, 3.5, 5.5),
            rim=cad.span(rng, 14, 24), wall=cad.span(rng, 1.9, 3.4), ledge=cad.pick(rng, 0.0, 0.0, 1.6, 2.5),
            outline=outline, corner=cad.pick(rng, 0.0, 3.0, 6.0), ears=ears, ear=cad.span(rng, 10, 13),
            bosses=cad.chance(rng, 0.6), post=cad.span(rng, 7, 9), screw=cad.span(rng, 2.8, 3.6),
            window=cad.pick(rng, "none", "round", "slots", "field"), notch=cad.pick(rng, 0.0, 5.0, 7.0, 10.0),
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        shell = self._inset(self.ledge)
        inside = self._inset(self.ledge + self.wall)
        posts = [(x, y) for x, y in self._corners() if self.bosses]
        discs = cad.CrossSection.compose([cad.circle(self.post).translate(p) for p in posts])
        rim = shell - inside + (discs ^ shell)
        cover = cad.prism(self._outline() + self._ears(), self.lid, chamfer_bottom=0.6)
        cover += cad.prism(rim, self.rim)
        if self.window != "none":
            cover = cad.pocket(cover, self._window() ^ (inside - discs.offset(1.5, JoinType.Miter)))
        if self.notch > 0:
            ends: tuple[cad.Axis, ...] = ("-x", "x") if self.outline == "plain" else ("-x",)
            for end in ends:
                mouth = cad.rectangle(self.notch, 2 * (self.rim - self.lid - 1), 2)
                place = ((1 if end == "x" else -1) * self.length / 2, 0, self.rim)
                cover = cad.pocket(cover, mouth, 0.3 * self.length, place, end)
        return cad.drill(cover, self.screw, posts + self._eyes()) if posts or self.ears else cover

    def symmetry(self) -> cad.Symmetry:
        return cad.cyclic(2, (0, 0, 1)) if self.outline == "plain" else cad.none()

    def _outline(self) -> cad.CrossSection:
        """The lid without its ears."""
        x, y = self.length, self.width
        plate = cad.rectangle(x, y, self.corner)
        if self.outline == "nosed":
            body = cad.rectangle(0.5 * x, y, self.corner).translate((-0.25 * x, 0))
            return cad.hull_2d(body, cad.circle(0.4 * y).translate((x / 2 - 0.2 * y, 0)))
        if self.outline == "clipped":
            return plate - cad.rectangle(0.8 * y, 0.8 * y).rotate(45).translate((x / 2, y / 2))
        if self.outline == "stepped":
            return plate - cad.rectangle(0.7 * x, 0.8 * y).translate((x / 2, y / 2))
        return plate

    def _inset(self, distance: float) -> cad.CrossSection:
        """The lid's outline drawn in."""
        return self._outline().offset(-distance, JoinType.Miter, 4.0) if distance > 0 else self._outline()

    def _corners(self) -> list[tuple[float, float]]:
        """Centres of the posts: all four corners, or the two at -x where the other end is cut or round."""
        inset = 2 * (self.ledge + 0.45 * self.post)
        points = cad.grid(2, 2, self.length - inset, self.width - inset)
        return points if self.outline == "plain" else [(x, y) for x, y in points if x < 0]

    def _eyes(self) -> list[tuple[float, float]]:
        """Centres of the ears' screw holes."""
        reach = self.length / 2 + self.ear - 5
        return [(reach, self._ear_y()), (-reach, -self._ear_y())][: self.ears]

    def _ear_y(self) -> float:
        """The ears sit in the middle, or where an end has lost its corner, on what is left of it."""
        return -self.width / 4 if self.outline in ("clipped", "stepped") else 0.0

    def _ears(self) -> cad.CrossSection:
        """Tabs around the eyes, running into the lid."""
        tabs = [cad.slot(30, 10).translate((x - 10 * np.sign(x), y)) for x, y in self._eyes()]
        return cad.CrossSection.batch_boolean(tabs, cad.OpType.Add) if tabs else cad.CrossSection()

    def _window(self) -> cad.CrossSection:
        """What is cut out of the lid."""
        x, y = self.length, self.width
        if self.window == "round":
            return cad.circle(0.4 * y)
        if self.window == "slots":
            bars = [cad.slot(0.4 * x, 3.2).translate((0, row * 0.16 * y)) for row in (-1, 0, 1)]
            return cad.CrossSection.compose(bars)
        return cad.rectangle(0.45 * x, 0.4 * y, 2) if self.window == "field" else cad.CrossSection()
