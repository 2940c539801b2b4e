"""Masks from depth alone: the kits, and each part by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import find_objects

from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.segmentation.bodies import Bodies, find_bodies
from kit1000.perception.segmentation.merging import Pieces, merged
from kit1000.perception.segmentation.pieces import find_pieces
from kit1000.perception.sensor_facts import SensorFacts, simulated_sensor
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, View

if TYPE_CHECKING:
    from kit1000.perception.restoration.restorer import Restorer
    from kit1000.perception.segmentation.part_finder import PartFinder

MOST_PARTS = 253  # labels of 8 bits hold no more
IDEAL = simulated_sensor("ideal")


def segmented(
    view: View,
    sensor: SensorFacts = IDEAL,
    scale: float = 1.0,
    restorer: Restorer | None = None,
    finder: PartFinder | None = None,
) -> np.ndarray:
    """(H, W) uint8: ASSEMBLY_LABEL on the kits, FIRST_PART_LABEL and up on the parts, in the order of first pixels.

    Args:
        view: as recorded.
        sensor: the facts about its sensor.
        scale: of the scene, as the dataset's configuration states it.
        restorer: a network that restores noisy images without masks; None looks at them as they are.
        finder: a network that tells parts apart in restored images; None merges pieces, as in ideal ones.
    """
    bodies = find_bodies(view, sensor, restorer)
    labels = np.where(bodies.kits, ASSEMBLY_LABEL, 0).astype(np.uint8)
    parts = finder(bodies) if finder is not None and bodies.kind.segmentation.network else _merged_pieces(bodies, scale)
    boxes, number = find_objects(parts), 0
    for part in dict.fromkeys(parts[parts > 0].tolist()):
        box = boxes[part - 1]
        mask = parts[box] == part
        if mask.sum() >= bodies.kind.segmentation.least_pixels and number < MOST_PARTS:
            labels[box][mask] = FIRST_PART_LABEL + number
            number += 1
    return labels


def _merged_pieces(bodies: Bodies, scale: float) -> np.ndarray:
    """(H, W) int: from 1 on the pixels of each part, 0 elsewhere."""
    parts = np.zeros(bodies.parts.shape, int)
    pieces, joined, points, box = pieces_of(bodies)
    if pieces.max() > 0:
        weights = np.array(bodies.kind.segmentation.weights)[:, None]
        described = Pieces.of(pieces, joined, points, bodies.kind.segmentation.foot, scale)
        home = merged(described, lambda rows: matmul(rows, weights)[:, 0])
        parts[box] = np.array([0, *(home[label] for label in range(1, int(pieces.max()) + 1))])[pieces]
    return parts


def pieces_of(bodies: Bodies) -> tuple[np.ndarray, list[np.ndarray], np.ndarray, tuple[slice, slice]]:
    """The pieces of the parts: labels and joined neighbours as of `find_pieces`, points (h, w, 3) [m], and the box of
    rows and columns to which all are cropped."""
    rows, columns = np.nonzero(bodies.parts.any(1))[0], np.nonzero(bodies.parts.any(0))[0]
    if len(rows) == 0:
        return np.zeros((1, 1), int), [], np.zeros((1, 1, 3)), np.s_[0:1, 0:1]
    box = np.s_[max(rows[0] - 1, 0) : rows[-1] + 2, max(columns[0] - 1, 0) : columns[-1] + 2]
    depth = bodies.view.depth[box].astype(float)
    labels, joined = find_pieces(depth, bodies.parts[box], bodies.kind.segmentation)
    return labels, joined, bodies.points[box], box
