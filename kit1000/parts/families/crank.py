"""Crank: two bosses on a tapered web, on the same side or on opposite ones; keyed, clamped or pinned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad


@dataclass(frozen=True)
class Crank:
    """The web lies on z = 0; the hub stands on the origin along +z, the second boss is at +x."""

    throw: float  # between the two axes
    hub: float  # diameter
    hub_h: float  # over z = 0
    eye: float  # diameter of the second boss
    eye_h: float  # its height, from the far face of the web
    opposed: bool  # the second boss stands out downwards
    web: float  # thickness
    bore: float
    shape: str  # of the hub's bore: "round", "keyed", "flat" or "hex"
    eye_bore: float  # 0: the second boss is a solid crank pin
    slit: float  # clamping slit through the hub's far wall, with a screw across; 0: none
    weight: float  # how far a counterweight reaches beyond the hub's wall; 0: none
    window: bool  # a slot through the web
    waist: bool  # the web is hollowed at its sides

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Crank:
        twin = cad.chance(rng, 0.3)
        throw, hub = cad.span(rng, 26, 33), cad.span(rng, 21, 27)
        pin = not twin and cad.chance(rng, 0.3)
        eye = hub if twin else cad.span(rng, 9, 12) if pin else cad.span(rng, 10.5, hub - 8)
        hub_h = cad.span(rng, 15, 22)
        bore = round(hub * cad.span(rng, 0.42, 0.58, 0.01), 1)
        slit = 0.0 if twin else cad.pick(rng, 0.0, 0.0, 2.0)
        return cls(
            throw=throw + (4 if twin else 0), hub=hub, hub_h=hub_h, eye=eye, bore=bore,
            eye_h=hub_h if twin else cad.span(rng, 18, 26) if pin else cad.span(rng, 9, 14),
            opposed=twin or cad.chance(rng, 0.35), web=cad.span(rng, 5, 7.5),
            shape=cad.pick(rng, "round", "keyed", "flat", "hex") if slit == 0 else "round",
            eye_bore=bore if twin else 0.0 if pin else round(0.5 * eye, 1),
            slit=slit, weight=0.0 if twin else cad.pick(rng, 0.0, 0.0, 9.0, 12.0),
            window=cad.chance(rng, 0.35), waist=cad.chance(rng, 0.4),
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        lower = 0.8 if self.opposed else 0.0
        eye = cad.prism(cad.circle(self.eye), self.eye_h, chamfer_top=0.8 - lower, chamfer_bottom=lower)
        crank = cad.join(
            cad.prism(self._web(), self.web),
            cad.prism(cad.circle(self.hub), self.hub_h, chamfer_top=0.8),
            cad.at(eye, self.throw, z=self.web - self.eye_h if self.opposed else 0),
        )
        crank = cad.pocket(crank, self._opening().rotate(180))
        if self.slit > 0:
            slit = cad.rectangle(self.hub, self.slit).translate((-self.hub / 2, 0))
            crank = cad.pocket(crank, slit, self.hub_h - self.web - 0.8, (0, 0, self.hub_h))
            wall = (self.hub + self.bore) / 4
            crank = cad.drill(crank, 2.4, (-wall, 0, (self.hub_h + self.web + 0.8) / 2), "y")
        if self._twin():
            return cad.pocket(crank, self._opening(), at=(self.throw, 0, 0))
        return cad.drill(crank, self.eye_bore, (self.throw, 0)) if self.eye_bore > 0 else crank

    def symmetry(self) -> cad.Symmetry:
        return cad.cyclic(2, (0, 1, 0)) if self._twin() else cad.none()

    def _twin(self) -> bool:
        """Both bosses alike, one up and one down."""
        return self.opposed and (self.hub, self.hub_h, self.bore) == (self.eye, self.eye_h, self.eye_bore)

    def _web(self) -> cad.CrossSection:
        """The web as seen from above, reaching around both bosses."""
        hub, eye = cad.circle(self.hub), cad.circle(self.eye).translate((self.throw, 0))
        web = cad.hull_2d(hub, eye)
        if self.waist:
            tool = cad.circle(3 * self.throw)
            rise = (self.hub + self.eye) / 4 - 0.16 * self.eye + 1.5 * self.throw
            web -= tool.translate((self.throw / 2, rise)) + tool.translate((self.throw / 2, -rise))
            web = web + hub + eye
        if self.weight > 0:
            web += cad.sector(self.hub + 2 * self.weight, 125, 235)
        if not self.window:
            return web
        start, end = self.hub / 2 + 2, self.throw - self.eye / 2 - 2
        length = max(end - start, 3.4)
        return web - cad.slot(length, 3.2).translate(((start + end) / 2, 0))

    def _opening(self) -> cad.CrossSection:
        """The bore, its key or flat on +x."""
        if self.shape == "hex":
            return cad.ngon(6, self.bore)
        if self.shape == "keyed":
            return cad.bore(self.bore, key_width=0.3 * self.bore, key_depth=1.4)
        return cad.bore(self.bore, flat=0.15 * self.bore if self.shape == "flat" else 0.0)
