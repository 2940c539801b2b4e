"""Channel: a length of U, J or C section with cut-outs in its web, end tabs, a notch or a mitred end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad


@dataclass(frozen=True)
class Channel:
    """The section runs along x, centred; the web lies on z = 0, the flanges stand at -y and +y."""

    length: float
    width: float
    left: float  # height of the flange at -y
    right: float  # height of the flange at +y
    gauge: float  # thickness of the sheet
    bend: float  # outer radius of the bends
    lip: float  # how far the flanges turn inwards at the top (C section); 0: none
    tab: float  # how far the web runs on beyond the flanges at +x
    tail: float  # the same at -x
    mitre_deg: float  # slant of the end at -x, seen from above; 0: square
    notch: float  # length of the gap in the flange at +y and the web beside it; 0: none
    notch_x: float
    window: str  # in the web: "slot", "holes", "round" or "plain"; beside a notch only holes fit
    hole: float
    pierced: bool  # a cross hole through both flanges

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Channel:
        keyed = cad.pick(rng, "even", "even", "tab", "mitre", "mitre", "notch", "notch and tab")
        uneven = keyed != "even" and cad.chance(rng, 0.35)
        length, width = cad.span(rng, 38, 52), cad.span(rng, 28, 38)
        left = cad.span(rng, 16, 26)
        tab = cad.span(rng, 11, 15)
        lip = cad.span(rng, 4, 6) if not uneven and cad.chance(rng, 0.35) else 0.0
        twin_tabs = keyed == "even" and cad.chance(rng, 0.5)
        return cls(
            length=length, width=width, left=left, right=round(0.45 * left, 1) if uneven else left,
            gauge=cad.span(rng, 3.4, 5.6), bend=cad.pick(rng, 0.0, 2.5, 4.5), lip=lip,
            tab=tab if "tab" in keyed or twin_tabs else 0.0, tail=tab if twin_tabs else 0.0,
            mitre_deg=cad.span(rng, 21, 28) if keyed == "mitre" else 0.0,
            notch=round(0.42 * length, 1) if "notch" in keyed else 0.0,
            notch_x=round(length * (0.16 if "tab" in keyed else cad.pick(rng, 0.16, 0.36)), 1),
            window=cad.pick(rng, "plain", "slot", "round" if keyed == "mitre" else "holes"),
            hole=cad.span(rng, 3.4, 5.5),
            pierced=cad.chance(rng, 0.6),
        )  # fmt: skip

    def solid(self) -> cad.Manifold:
        channel = cad.at(cad.along(cad.prism(self._section(), self.length), "x"), x=-self.length / 2)
        channel = self._trimmed(channel)
        for tab, end in ((self.tab, 1), (self.tail, -1)):
            if tab > 0:
                channel += self._tab(tab, end)
        if self.window != "plain":
            channel = cad.pocket(channel, self._window(), 2 * self.gauge, (0, 0, self.gauge))
        return self._pierced(channel) if self.pierced else channel

    def symmetry(self) -> cad.Symmetry:
        even = self.left == self.right and self.tab == self.tail and self.mitre_deg == self.notch == 0
        return cad.cyclic(2, (0, 0, 1)) if even else cad.none()

    def _section(self) -> cad.CrossSection:
        """The bent sheet as seen from +x."""
        w, t, high = self.width, self.gauge, max(self.left, self.right)
        outer = cad.rectangle(w, 2 * high, self.bend).translate((0, high))
        inner = cad.rectangle(w - 2 * t, 2 * high, max(self.bend - t, 0)).translate((0, high + t))
        sheet = (outer - inner) ^ cad.rectangle(2 * w, high).translate((0, high / 2))
        if self.lip > 0:
            mouth = cad.rectangle(w - 2 * t - 2 * self.lip, 3 * t).translate((0, high))
            sheet += cad.rectangle(w, t).translate((0, high - t / 2)) - mouth
        low = min(self.left, self.right)
        return sheet - cad.rectangle(w, high).translate((w / 2, low + high / 2))

    def _trimmed(self, channel: cad.Manifold) -> cad.Manifold:
        """The end at -x mitred, or the side at +y notched."""
        corner = (-self.length / 2, self.width / 2, 0)
        if self.mitre_deg > 0:
            waste = cad.rectangle(self.length, 4 * self.width).translate((-self.length / 2, 0))
            channel = cad.pocket(channel, waste.rotate(-self.mitre_deg), at=(corner[0], -corner[1], 0))
        if self.notch > 0:
            gap = cad.rectangle(self.notch, 0.9 * self.width, 3)
            channel = cad.pocket(channel, gap, at=(self.notch_x, corner[1], 0))
        return channel

    def _pierced(self, channel: cad.Manifold) -> cad.Manifold:
        """Two holes in each flange that is whole and high enough."""
        sides: list[tuple[float, int, cad.Axis]] = [(self.left, -1, "-y"), (self.right, 1, "y")]
        for height, side, axis in sides:
            whole = self.notch == 0 or side < 0
            if whole and height > 2 * self.gauge + 2 * self.hole:
                level = (height + self.gauge) / 2
                mouths = [(x * self.length, side * self.width / 2, level) for x in self._stations()]
                channel = cad.drill(channel, self.hole, mouths, axis, depth=2 * self.gauge)
        return channel

    def _stations(self) -> tuple[float, ...]:
        """Where along x the small holes are, as shares of the length; none where a mitre would cut them."""
        return (0.16, 0.38) if self.mitre_deg > 0 else (-0.34, 0.34)

    def _tab(self, reach: float, end: int) -> cad.Manifold:
        """The web running on beyond the flanges at one end, with a hole in it."""
        inset = self.length / 4
        tongue = cad.rectangle(reach + inset, 0.62 * self.width, 4).translate(((reach - inset) / 2, 0))
        tongue -= cad.circle(1.2 * self.hole).translate((0.5 * reach, 0))
        tongue = tongue.rotate(0 if end > 0 else 180)
        return cad.at(cad.prism(tongue, self.gauge), x=end * self.length / 2)

    def _window(self) -> cad.CrossSection:
        """What is cut out of the web."""
        free = self.width - 4 * self.gauge
        shift = 0.14 * self.length if self.mitre_deg > 0 else 0.0
        if self.notch > 0:
            return cad.holes(self.hole, [(x * self.length, -0.2 * free) for x in self._stations()])
        if self.window == "slot":
            return cad.slot(0.5 * self.length, 0.55 * free).translate((shift, 0))
        if self.window == "round":
            return cad.circle(min(0.8 * free, 0.4 * self.length)).translate((shift, 0))
        if self.window == "holes":
            return cad.holes(self.hole, cad.grid(3, 2, 0.3 * self.length, 0.6 * free))
        return cad.CrossSection()
