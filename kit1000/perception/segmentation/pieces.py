"""Pieces: smooth surfaces between steps in depth and concave creases. Parts that touch meet in one or the other."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from kit1000.perception.image_kinds import Segmentation

SMALLEST = 12  # [px] of a piece between creases; smaller ones go to their neighbours
MOST_PIECES = 200  # of an image; real scenes have up to 60
MOST_ROUNDS = 60  # [px] by which pieces grow back over creases
AXES = (0, 1)


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
    rows, columns = (
        np.concatenate([pair[k][edge & _both(mask, axis)] for axis, edge in zip(AXES, joined, strict=True)
                        for pair in [neighbours(number, axis)]])
        for k in range(2)
    )  # fmt: skip
    count = int(mask.sum())
    graph = coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(count, count))
    labels = np.zeros(mask.shape, int)
    labels[mask] = connected_components(graph, directed=False)[1] + 1
    return labels


def neighbours(image: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Views of all pixels that have a next one along an axis, and of those next ones."""
    return (image[:-1], image[1:]) if axis == 0 else (image[:, :-1], image[:, 1:])


def _both(mask: np.ndarray, axis: int) -> np.ndarray:
    first, second = neighbours(mask, axis)
    return first & second


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
