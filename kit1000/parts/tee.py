"""Tees: pipe tees with collars, flat bar tees with screw holes, and lengths of T-section."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.parts.cad import (
    Manifold,
    Symmetry,
    along,
    at,
    chance,
    cyclic,
    cylinder,
    drill,
    grid,
    holes,
    join,
    none,
    pick,
    prism,
    rectangle,
    rounded,
    span,
)  # fmt: skip


@dataclass(frozen=True)
class Tee:
    """The head (run of the pipe, bar, flange of the section) lies along x, the stem rises to +z from its middle."""

    kind: str
    """pipe, bar or section"""
    run: float
    """length of the head"""
    stem: float
    """reach of the stem from the head's axis"""
    shift: float
    """how far the stem stands from the middle of the head, 0 for an even tee"""
    thickness: float
    """outer diameter of a pipe, width of a bar, wall of a section"""
    depth: float
    """of a bar or section, along y"""
    branch: float
    """the stem's thickness as a part of the head's"""
    bore: float
    """inner diameter of a pipe as a part of the outer; diameter of the screw holes, 0 for none"""
    collar: float
    """how much wider the pipe's ends are, 0 for none"""
    collars: int
    """how many ends wear one"""
    blend: float
    """radius of the inner corners"""

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Tee:
        kind = pick(rng, "pipe", "bar", "section")
        run, shifted = span(rng, 32, 46), chance(rng, 0.4)
        thickness = {"pipe": span(rng, 11, 17), "bar": span(rng, 9, 14)}.get(kind, span(rng, 3, 6))
        screw = 0.0 if chance(rng, 0.35) else span(rng, 3, 5)
        return cls(
            kind=kind,
            run=run,
            stem=span(rng, 18, 34),
            shift=span(rng, 6.5, 9) if shifted else 0.0,
            thickness=thickness,
            depth=span(rng, 9, 15) if kind == "bar" else span(rng, 18, 36),
            branch=span(rng, 0.75, 1.0, 0.05) if kind != "section" else span(rng, 0.8, 1.2, 0.05),
            bore=span(rng, 0.55, 0.75, 0.01) if kind == "pipe" else screw,
            collar=span(rng, 3, 6) if kind == "pipe" and chance(rng, 0.7) else 0.0,
            collars=pick(rng, 1, 2, 3) if shifted else pick(rng, 1, 3),
            blend=span(rng, 1.5, 4),
        )

    def solid(self) -> Manifold:
        return {"pipe": self._pipe, "bar": self._bar, "section": self._section}[self.kind]()

    def symmetry(self) -> Symmetry:
        return cyclic(2) if self.shift == 0 else none()

    def _pipe(self) -> Manifold:
        """Collars come first on the branch, then on the run's ends."""
        d, small = self.thickness, self.branch * self.thickness
        half, long = self.run / 2, min(8.0, self.run / 5)
        run = at(along(cylinder(d, self.run, 0.5), "x"), x=-half)
        parts = [run, at(cylinder(small, self.stem, 0.5), x=self.shift)]
        if self.collar > 0:
            parts.append(at(cylinder(small + self.collar, long, 0.5), x=self.shift, z=self.stem - long))
            end = along(cylinder(d + self.collar, long, 0.5), "x")
            ends = [at(end, x=half - long), at(end, x=-half)]
            parts += ends[: self.collars - 1]
        body = drill(join(*parts), self.bore * d, axis="x")
        return drill(body, self.bore * small, (self.shift, 0, 0), "z", depth=0)

    def _bar(self) -> Manifold:
        w, stem = self.thickness, self.branch * self.thickness
        outline = rectangle(self.run, w).translate((0, 0))
        outline += rectangle(stem, self.stem).translate((self.shift, self.stem / 2))
        outline = rounded(outline, min(self.blend, 0.4 * stem))
        reach = self.run / 2 - w / 2
        screws = [(-reach, 0.0), (reach, 0.0), (self.shift, self.stem - stem / 2)]
        if self.bore > 0:
            outline -= holes(min(self.bore, 0.5 * stem), screws)
        plate = prism(outline, self.depth, chamfer=0.5)
        return at(along(plate, "-y"), y=self.depth / 2)

    def _section(self) -> Manifold:
        wall, web = self.thickness, max(2.0, self.branch * self.thickness)
        outline = rectangle(self.run, wall).translate((0, wall / 2))
        outline += rectangle(web, self.stem).translate((self.shift, self.stem / 2))
        body = at(along(prism(outline, self.depth), "-y"), y=self.depth / 2)
        if self.bore == 0:
            return body
        left, right = self.run / 2 + self.shift - web / 2, self.run / 2 - self.shift - web / 2
        rows = 2 if self.depth > 4 * self.bore else 1
        inset = self.bore / 2 + 2.5
        pitch = self.depth - 2 * inset
        for x, room in ((left / 2 - self.run / 2, left), (self.run / 2 - right / 2, right)):
            if room > self.bore + 4:
                body = drill(body, self.bore, np.add(grid(1, rows, 0, pitch), (x, 0)))
        return drill(body, min(2 * self.bore, 0.5 * self.depth, 0.5 * self.stem), (0, 0, 0.62 * self.stem), "x")
