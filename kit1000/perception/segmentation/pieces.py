"""Pieces: smooth surfaces between steps in depth and concave creases, and which of them belong to one part.

Parts that touch meet in a step or a crease. Pairs of pieces are scored by how they lie and touch, and the best ones
merge, round by round. The convex outlines of parts from above never overlap, since no part lies on another: pieces with
overlapping outlines are of one part. For other pieces it counts that they touch without a step and that their common
outline is small and full.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from kit1000.numerics.compiled import compiled
from kit1000.perception.image_kinds import Segmentation

SMALLEST = 12  # [px] of a piece between creases; smaller ones go to their neighbours
MOST_PIECES = 200  # of an image; real scenes have up to 60
MOST_ROUNDS = 60  # [px] by which pieces grow back over creases
AXES = (0, 1)
PIECE_REACH = 12e-3  # [m] between the outlines of pieces that may be of one part
SPECK = 4e-4  # [m] half the width that a piece has at least
FEATURES = (
    "one", "gap", "beyond 4 mm", "overlap", "defect", "width", "beyond 55 mm", "area",
    "smooth", "stepped", "apart", "height", "standing",
)  # fmt: skip
"""Features of a pair: 1; [mm] gap between the outlines, its part beyond 4 mm, their overlap; area of the common outline
that neither covers, over the smaller one; [5 cm] width of the common outline and [cm] its part beyond 55 mm; [10 cm^2]
its area; share of the smaller piece's border along which they meet without and with a step; whether they meet nowhere;
[cm] lowest point of the larger one; share of the border with which both stand on the table."""
Score = Callable[[np.ndarray], np.ndarray]


def find_pieces(depth: np.ndarray, mask: np.ndarray, scale: Segmentation) -> tuple[np.ndarray, list[np.ndarray]]:
    """The pieces of a mask.

    Args:
        depth: (h, w) [m].
        mask: (h, w) bool.
        scale: of steps and creases.

    Returns:
        (h, w) int labels from 1, 0 outside the mask; and for both axes which neighbours, (h - 1, w) and (h, w - 1)
        bool, are joined without a step.
    """
    joined = [_without_step(depth, mask, axis, scale.step) for axis in AXES]
    flat = mask & ~_creases(depth, mask, scale)
    labels = connected(flat, joined)
    sizes = np.bincount(labels.ravel())
    labels[(sizes < SMALLEST)[labels]] = 0
    labels = _grown(labels, joined)
    rest = connected(mask & (labels == 0), joined)
    labels = np.where(rest > 0, rest + labels.max(), labels)
    return _largest(labels), joined


def _largest(labels: np.ndarray) -> np.ndarray:
    """The MOST_PIECES largest pieces, numbered from 1 on in their order; the others become 0."""
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    kept = np.sort(np.argsort(-sizes, kind="stable")[:MOST_PIECES])
    kept = kept[sizes[kept] > 0]
    number = np.zeros(len(sizes), int)
    number[kept] = np.arange(len(kept)) + 1
    return number[labels]


def connected(mask: np.ndarray, joined: list[np.ndarray]) -> np.ndarray:
    """(h, w) int: labels from 1 of the connected components of a mask, in the order of their first pixels."""
    number = np.zeros(mask.shape, int)
    number[mask] = np.arange(mask.sum())
    pairs = []
    for axis, edge in zip(AXES, joined, strict=True):
        (first, second), (inside, next_inside) = neighbours(number, axis), neighbours(mask, axis)
        there = edge & inside & next_inside
        pairs.append((first[there], second[there]))
    rows, columns = map(np.concatenate, zip(*pairs, strict=True))
    count = int(mask.sum())
    graph = coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(count, count))
    labels = np.zeros(mask.shape, int)
    labels[mask] = connected_components(graph, directed=False)[1] + 1
    return labels


def neighbours(image: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Views of all pixels that have a next one along an axis, and of those next ones."""
    return (image[:-1], image[1:]) if axis == 0 else (image[:, :-1], image[:, 1:])


def _without_step(depth: np.ndarray, mask: np.ndarray, axis: int, most: float) -> np.ndarray:
    """Which neighbours along an axis differ by no more than `most` [m] from what the slope of either side says."""
    z, inside = np.moveaxis(depth, axis, 0), np.moveaxis(mask, axis, 0)
    step, both = np.diff(z, axis=0), inside[1:] & inside[:-1]
    slope = np.where(both, step, 0)
    before, after = np.zeros_like(slope), np.zeros_like(slope)
    before[1:], after[:-1] = slope[:-1], slope[1:]
    excess = np.minimum(np.minimum(np.abs(step - before), np.abs(step - after)), np.abs(step))
    return np.moveaxis(both & (excess < most), 0, axis)


def _creases(depth: np.ndarray, mask: np.ndarray, scale: Segmentation) -> np.ndarray:
    """(h, w) bool: where the surface is a valley. Inverse depth is linear in the image on any plane."""
    k, valleys = scale.lever, np.zeros(mask.shape, bool)
    for axis in AXES:
        z, inside = np.moveaxis(depth, axis, 0), np.moveaxis(mask, axis, 0)
        if len(z) <= 2 * k:
            continue
        inverse = np.where(inside, 1 / np.maximum(z, 1e-6), 0)
        deeper = (inverse[2 * k :] + inverse[: -2 * k] - 2 * inverse[k:-k]) * z[k:-k] ** 2
        known = inside[2 * k :] & inside[: -2 * k] & inside[k:-k]
        np.moveaxis(valleys, axis, 0)[k:-k] |= known & (deeper > scale.valley)
    return valleys


def _grown(labels: np.ndarray, joined: list[np.ndarray]) -> np.ndarray:
    """Labels grown pixel by pixel over unlabelled pixels that are joined to them."""
    for _ in range(MOST_ROUNDS):
        grown = labels.copy()
        for axis, edge in zip(AXES, joined, strict=True):
            first, second = neighbours(labels, axis)
            new_first, new_second = neighbours(grown, axis)
            for source, target in ((first, new_second), (second, new_first)):
                take = edge & (target == 0) & (source > 0)
                target[take] = source[take]
        if np.array_equal(grown, labels):
            break
        labels = grown
    return labels


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece, or several merged ones."""

    outline: np.ndarray
    """(n, 2) [m] convex, counter-clockwise, from above."""
    area: float
    """[m^2] of the outline."""
    size: int
    """[px]"""
    low: float
    """[m] lowest point above the table."""
    border: float
    """[px] pairs of neighbours across its border."""
    standing: float
    """[px] the same at its foot on the table."""


@dataclass(eq=False)
class Pieces:
    """The pieces of an image by label, and how they touch."""

    by_label: dict[int, Piece]
    contacts: np.ndarray
    """(n, n, 2) pairs of neighbours without a step, and with one."""

    @classmethod
    def of(cls, labels: np.ndarray, joined: list[np.ndarray], points: np.ndarray, low: float, scale: float) -> Pieces:
        """Pieces of labels (h, w) with points (h, w, 3) [m]; lengths are divided by the scale of the scene."""
        count = int(labels.max()) + 1
        contacts, standing = np.zeros((count, count, 2)), np.zeros(count)
        foot = (labels > 0) & (points[..., 2] < low)
        for axis, edge in zip(AXES, joined, strict=True):
            (a, b), (foot_a, foot_b) = neighbours(labels, axis), neighbours(foot, axis)
            for kind, where in enumerate(((a != b) & edge, (a != b) & ~edge)):
                np.add.at(contacts[..., kind], (a[where], b[where]), 1)
                np.add.at(contacts[..., kind], (b[where], a[where]), 1)
            standing += np.bincount(a[foot_a & (b == 0)], minlength=count)
            standing += np.bincount(b[foot_b & (a == 0)], minlength=count)
        borders = np.maximum(contacts.sum((1, 2)), 1)
        order = np.argsort(labels, axis=None, kind="stable")
        starts = np.searchsorted(labels.ravel()[order], np.arange(1, count + 1))
        flat, pieces = points.reshape(-1, 3) / scale, {}
        for label in range(1, count):
            own = flat[order[starts[label - 1] : starts[label]]]
            outline = outline_of(own[:, :2])
            lowest, border = float(own[:, 2].min()), float(borders[label])
            pieces[label] = Piece(outline, area_of(outline), len(own), lowest, border, float(standing[label]))
        return cls(pieces, contacts)

    def merge(self, i: int, j: int) -> None:
        """Make piece j part of piece i."""
        a, b = self.by_label[i], self.by_label.pop(j)
        outline = outline_of(np.concatenate([a.outline, b.outline]))
        border = max(a.border + b.border - 2 * float(self.contacts[i, j].sum()), 1.0)
        low, standing = min(a.low, b.low), a.standing + b.standing
        self.by_label[i] = Piece(outline, area_of(outline), a.size + b.size, low, border, standing)
        self.contacts[i] += self.contacts[j]
        self.contacts[:, i] += self.contacts[:, j]
        self.contacts[i, i] = self.contacts[j] = self.contacts[:, j] = 0

    def near(self, i: int, j: int) -> bool:
        """Whether two pieces are within PIECE_REACH."""
        return gap_between(self.by_label[i].outline, self.by_label[j].outline) < PIECE_REACH

    def features(self, i: int, j: int) -> np.ndarray:
        """(f,) FEATURES of a pair."""
        a, b = self.by_label[i], self.by_label[j]
        gap = 1e3 * gap_between(a.outline, b.outline)
        both = outline_of(np.concatenate([a.outline, b.outline]))
        area, smaller = area_of(both), max(min(a.area, b.area), 20e-6)
        width = 1e3 * float(np.sqrt(((both[:, None] - both) ** 2).sum(-1).max()))
        smooth, stepped = (self.contacts[i, j] / min(a.border, b.border)).tolist()
        larger = a if a.size >= b.size else b
        standing = min(a.standing / a.border, b.standing / b.border)
        defect = float(np.clip((area - a.area - b.area) / smaller, -1, 4))
        lengths = (float(np.clip(gap, -8, 8)), max(gap - 4, 0), min(max(-gap, 0), 8))
        extent = (width / 50, max(width - 55, 0) / 10, area * 1e3)
        apart = float(self.contacts[i, j].sum() == 0)
        return np.array(
            [1, *lengths, defect, *extent, smooth, stepped, apart, np.clip(100 * larger.low, 0, 2), standing]
        )


def merged(pieces: Pieces, score: Score) -> dict[int, int]:
    """Which piece each piece is part of in the end, by label. Pairs that are each other's best above 0 merge.

    score: of features (n, f), (n,).
    """
    home = {label: label for label in pieces.by_label}
    pairs = {pair: pieces.features(*pair) for pair in combinations(pieces.by_label, 2) if pieces.near(*pair)}
    while pairs:
        chosen = best_pairs(list(pairs), score(np.array(list(pairs.values()))))
        if not chosen:
            break
        pairs = {pair: row for pair, row in pairs.items() if not {*pair} & {label for both in chosen for label in both}}
        for i, j in chosen:
            pieces.merge(i, j)
            home = {label: i if to == j else to for label, to in home.items()}
        for i, _ in chosen:
            for k in pieces.by_label:
                pair = (min(i, k), max(i, k))
                if k != i and pair not in pairs and pieces.near(i, k):
                    pairs[pair] = pieces.features(*pair)
    return home


def best_pairs(pairs: list[tuple[int, int]], scores: np.ndarray) -> list[tuple[int, int]]:
    """The pairs with a score above 0 that are the best of both of their pieces; of equal ones the first."""
    best: dict[int, int] = {}
    for n in np.argsort(-scores, kind="stable").tolist():
        for label in pairs[n]:
            best.setdefault(label, n)
    return [pair for n, pair in enumerate(pairs) if scores[n] > 0 and best[pair[0]] == best[pair[1]] == n]


def outline_of(flat: np.ndarray) -> np.ndarray:
    """(k, 2) [m] the convex outline of points (n, 2), counter-clockwise; a little square around points on a line."""
    try:
        return flat[ConvexHull(flat).vertices]
    except (QhullError, ValueError):
        square = SPECK * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
        widened = (flat[:, None] + square).reshape(-1, 2)
        return widened[ConvexHull(widened).vertices]


def area_of(outline: np.ndarray) -> float:
    """[m^2] of an outline (n, 2), counter-clockwise."""
    (x, y), (next_x, next_y) = outline.T, np.roll(outline, -1, axis=0).T
    return float((x * next_y - next_x * y).sum() / 2)


def gap_between(a: np.ndarray, b: np.ndarray) -> float:
    """[m] the widest gap between two convex outlines along the normal of an edge; below 0 by how far they overlap."""
    return max(_gap_beyond(a, b), _gap_beyond(b, a))


@compiled
def _gap_beyond(a, b):
    """[m] the largest distance of outline b from the line of an edge of outline a, which has it on its right."""
    widest = -np.inf
    for i in range(len(a)):
        x, y = a[i]
        next_x, next_y = a[(i + 1) % len(a)]
        length = max(np.sqrt((next_x - x) ** 2 + (next_y - y) ** 2), 1e-12)
        right_x, right_y = (next_y - y) / length, (x - next_x) / length
        nearest = np.inf
        for j in range(len(b)):
            nearest = min(nearest, b[j, 0] * right_x + b[j, 1] * right_y)
        widest = max(widest, nearest - (x * right_x + y * right_y))
    return widest
