"""Tees: pipe tees with collars, flat bar tees with screw holes, and lengths of T-section."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts import cad
from kit1000.parts.cad import Manifold, Symmetry


@dataclass(frozen=True)
class Tee:
    """The head (run of the pipe, bar, flange of the section) lies along x, the stem rises to +z from its middle."""

    kind: str  # pipe, bar or section
    run: float  # length of the head
    stem: float  # reach of the stem from the head's axis
    shift: float  # how far the stem stands from the middle of the head, 0 for an even tee
    thickness: float  # outer diameter of a pipe, width of a bar, wall of a section
    depth: float  # of a bar or section, along y
    branch: float  # the stem's thickness as a part of the head's
    bore: float  # inner diameter of a pipe as a part of the outer; diameter of the screw holes, 0 for none
    collar: float  # how much wider the pipe's ends are, 0 for none
    collars: int  # how many ends wear one
    blend: float  # radius of the inner corners

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Tee:
        kind = cad.pick(rng, "pipe", "bar", "section")
        run, shifted = cad.span(rng, 32, 46), cad.chance(rng, 0.4)
        thickness = {"pipe": cad.span(rng, 11, 17), "bar": cad.span(rng, 9, 14)}.get(kind, cad.span(rng, 2.1, 4.5))
        screw = 0.0 if cad.chance(rng, 0.35) else cad.span(rng, 3, 5)
        return cls(
            kind=kind,
            run=run,
            stem=cad.span(rng, 18, 34),
            shift=cad.span(rng, 6.5, 9) if shifted else 0.0,
            thickness=thickness,
            depth=cad.span(rng, 9, 15) if kind == "bar" else cad.span(rng, 18, 36),
            branch=cad.span(rng, 0.75, 1.0, 0.05) if kind != "section" else cad.span(rng, 0.8, 1.2, 0.05),
            bore=cad.span(rng, 0.55, 0.75, 0.01) if kind == "pipe" else screw,
            collar=cad.span(rng, 3, 6) if kind == "pipe" and cad.chance(rng, 0.7) else 0.0,
            collars=cad.pick(rng, 1, 2, 3) if shifted else cad.pick(rng, 1, 3),
            blend=cad.span(rng, 1.5, 4),
        )

    def solid(self) -> Manifold:
        return {"pipe": self._pipe, "bar": self._bar, "section": self._section}[self.kind]()

    def symmetry(self) -> Symmetry:
        return cad.cyclic(2) if self.shift == 0 else cad.none()

    def _pipe(self) -> Manifold:
        """Collars come first on the branch, then on the run's ends."""
        d, small = self.thickness, self.branch * self.thickness
        half, long = self.run / 2, min(8.0, self.run / 5)
        run = cad.at(cad.along(cad.cylinder(d, self.run, 0.5), "x"), x=-half)
        parts = [run, cad.at(cad.cylinder(small, self.stem, 0.5), x=self.shift)]
        if self.collar > 0:
            parts.append(cad.at(cad.cylinder(small + self.collar, long, 0.5), x=self.shift, z=self.stem - long))
            end = cad.along(cad.cylinder(d + self.collar, long, 0.5), "x")
            ends = [cad.at(end, x=half - long), cad.at(end, x=-half)]
            parts += ends[: self.collars - 1]
        body = cad.drill(cad.join(*parts), self.bore * d, axis="x")
        return cad.drill(body, self.bore * small, (self.shift, 0, 0), "z", depth=0)

    def _bar(self) -> Manifold:
        w, stem = self.thickness, self.branch * self.thickness
        outline = cad.rectangle(self.run, w).translate((0, 0))
        outline += cad.rectangle(stem, self.stem).translate((self.shift, self.stem / 2))
        outline = cad.rounded(outline, min(self.blend, 0.4 * stem))
        reach = self.run / 2 - w / 2
        screws = [(-reach, 0.0), (reach, 0.0), (self.shift, self.stem - stem / 2)]
        if self.bore > 0:
            outline -= cad.holes(min(self.bore, 0.5 * stem), screws)
        plate = cad.prism(outline, self.depth, chamfer=0.5)
        return cad.at(cad.along(plate, "-y"), y=self.depth / 2)

    def _section(self) -> Manifold:
        wall, web = self.thickness, max(1.9, self.branch * self.thickness)
        outline = cad.rectangle(self.run, wall).translate((0, wall / 2))
        outline += cad.rectangle(web, self.stem).translate((self.shift, self.stem / 2))
        body = cad.at(cad.along(cad.prism(outline, self.depth), "-y"), y=self.depth / 2)
        if self.bore == 0:
            return body
        left, right = self.run / 2 + self.shift - web / 2, self.run / 2 - self.shift - web / 2
        rows = 2 if self.depth > 4 * self.bore else 1
        inset = self.bore / 2 + 2.5
        pitch = self.depth - 2 * inset
        for x, room in ((left / 2 - self.run / 2, left), (self.run / 2 - right / 2, right)):
            if room > self.bore + 4:
                body = cad.drill(body, self.bore, np.add(cad.grid(1, rows, 0, pitch), (x, 0)))
        return cad.drill(body, min(2 * self.bore, 0.5 * self.depth, 0.5 * self.stem), (0, 0, 0.62 * self.stem), "x")
