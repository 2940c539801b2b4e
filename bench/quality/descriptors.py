"""Scale-invariant shape descriptors of closed meshes.

D2 is the distribution of distances between pairs of surface points (Osada et al., "Shape distributions", 2002).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.mesh import Mesh, body_count, surface_points
from kit1000.parts.near_duplicates import MIN_DIFFERENCE, shape_measures

BINS = 32
"""Of a D2 histogram, over 0 .. D2_RANGE mean distances."""
D2_RANGE = 2.6
"""Longest distance in a histogram, in mean distances; only rods reach it."""
PAIRS = 8000
"""Pairs of points a D2 histogram is counted from."""

D2_SAMPLING = 0.12
"""Two samples of PAIRS pairs from one shape differ by less (L1)."""


@dataclass(frozen=True)
class Shape:
    """Descriptors of one part; none depends on its size or position."""

    triangles: int
    genus: int
    """through holes and handles"""
    fill: float
    """volume / volume of the box"""
    convexity: float
    """volume / volume of the convex hull"""
    middle: float
    """middle side of the box / longest"""
    short: float
    """shortest side of the box / longest"""
    roughness: float
    """area / volume^(2/3): 4.8 for a ball, 6 for a cube"""
    d2: np.ndarray
    """(BINS,) histogram, sums to 1"""

    @property
    def aspect(self) -> float:
        """Longest side of the box / shortest."""
        return 1 / self.short

    def measures(self) -> np.ndarray:
        """(5,) the continuous measures, without the sampled histogram."""
        return np.array([self.fill, self.convexity, self.middle, self.short, self.roughness])

    def vector(self) -> np.ndarray:
        """(6 + BINS,) input of a classifier; without the number of triangles, which depends on the exporter."""
        return np.concatenate([self.measures(), [float(self.genus > 0)], self.d2])


def describe(mesh: Mesh, rng: np.random.Generator) -> Shape:
    """Measure a closed mesh of one body."""
    fill, convexity, middle, short, roughness = (float(value) for value in shape_measures(mesh))
    euler = len(mesh.vertices) - len(mesh.faces) / 2
    genus = round(body_count(mesh) - euler / 2)
    return Shape(len(mesh.faces), genus, fill, convexity, middle, short, roughness, d2_histogram(mesh, rng))


def d2_histogram(mesh: Mesh, rng: np.random.Generator) -> np.ndarray:
    """(BINS,) shares of point pairs by their distance, in units of the mean distance."""
    one, other = np.split(surface_points(mesh, 2 * PAIRS, rng), 2)
    gaps = np.linalg.norm(one - other, axis=1)
    counts, _ = np.histogram(np.minimum(gaps / gaps.mean(), D2_RANGE - 1e-9), BINS, (0, D2_RANGE))
    return counts / PAIRS


def d2_distance(ours: Sequence[Shape], theirs: Sequence[Shape]) -> float:
    """L1 distance between the mean histograms of two sets, 0 .. 2."""
    means = [np.mean([shape.d2 for shape in shapes], axis=0) for shapes in (ours, theirs)]
    return float(np.abs(means[0] - means[1]).sum())


def d2_noise(shapes: Sequence[Shape], rng: np.random.Generator, splits: int = 200) -> float:
    """Mean D2 distance between two random halves of one set: the level of chance."""
    half = len(shapes) // 2
    gaps = []
    for _ in range(splits):
        order = rng.permutation(len(shapes))
        gaps.append(d2_distance([shapes[i] for i in order[:half]], [shapes[i] for i in order[half:]]))
    return float(np.mean(gaps))


def near_duplicates(shapes: Sequence[Shape]) -> list[tuple[int, int]]:
    """Pairs of near-duplicates: all measures within MIN_DIFFERENCE, the same genus, and D2 equal up to sampling."""
    measures = np.array([shape.measures() for shape in shapes])
    genus, d2 = np.array([shape.genus for shape in shapes]), np.array([shape.d2 for shape in shapes])
    found = []
    for i, one in enumerate(measures):
        later = slice(i + 1, None)
        alike = (np.abs(measures[later] / one - 1) < MIN_DIFFERENCE).all(axis=1) & (genus[later] == genus[i])
        alike &= np.abs(d2[later] - d2[i]).sum(axis=1) < D2_SAMPLING
        found += [(i, int(i + 1 + j)) for j in np.flatnonzero(alike)]
    return found
