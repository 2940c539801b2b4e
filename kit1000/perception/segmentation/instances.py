"""Masks from depth alone: what stands on the table, apart for the kits' half and the parts' half, and each part."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.ndimage import find_objects, label, uniform_filter

from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.calibration import calibrated_by
from kit1000.perception.image_kinds import ImageKind
from kit1000.perception.restoration.rules import farther_sides
from kit1000.perception.segmentation.pieces import Pieces, find_pieces, merged
from kit1000.perception.sensor_facts import SensorFacts, simulated_sensor
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, View

if TYPE_CHECKING:
    from kit1000.perception.restoration.restorer import Restorer
    from kit1000.perception.segmentation.part_finder import PartFinder

SURE_HEIGHT = 6e-3  # [m] above the table: a body of a noisy image has a pixel as high as this
LEAST_SURE = 5  # pixels with a return above SURE_HEIGHT, of a body in an image that a network restored
RETURNED = 0.7  # least share of such a body's pixels with a return: elsewhere the network only guesses
OF_LARGEST = 0.1  # share of the largest region on the kits' half: the kits are one body, smaller regions are none
RECORDED_HEIGHT = 8e-3  # [m] above the table: before calibration, higher pixels are no part of it
SHADOW = 40  # [px] the widest gap along a row that is the shadow of a near edge
WINDOW, SHARE = 11, 0.6  # [px] around a pixel, and the share of body in it: fattened edges are bumpy, parts are not
MOST_PARTS = 253  # labels of 8 bits hold no more
IDEAL = simulated_sensor("ideal")


class Bodies(NamedTuple):
    """The bodies of an image."""

    view: View
    """The image they were found in: calibrated and with shadows closed if the sensor is noisy."""
    points: np.ndarray
    """(H, W, 3) [m] world: of every pixel; of one without a return, the camera's position."""
    kits: np.ndarray
    """(H, W) bool"""
    parts: np.ndarray
    """(H, W) bool"""
    kind: ImageKind
    """Kind of the view."""
    measured: View
    """The image before edges were restored or shadows closed, calibrated if the sensor is noisy."""


def find_bodies(view: View, sensor: SensorFacts, restorer: Restorer | None = None) -> Bodies:
    """The bodies on the kits' half (y > 0) and the parts' half of the table.

    restorer: a network that restores noisy images without masks; None: they are read as they are.
    """
    kind = sensor.kind
    if kind.exact:
        points, height = points_and_heights(view)
        return _halves(view, points, height > kind.segmentation.least_height, kind, view)
    above = (view.depth > 0) & (world_points(view)[..., 2] > RECORDED_HEIGHT)
    measured = calibrated_by(view, above.astype(np.uint8), sensor)
    if restorer is not None and kind.denoised is not None:
        return _restored_bodies(restorer.without_masks(measured, sensor), kind.denoised, measured)
    closed = without_shadows(measured)
    points, height = points_and_heights(closed)
    body = _high_regions(height, kind.segmentation.least_height)
    if kind.restores:
        body = np.asarray(uniform_filter(body.astype(float), WINDOW)) > SHARE
    return _halves(closed, points, body, kind, measured)


def _restored_bodies(view: View, kind: ImageKind, measured: View) -> Bodies:
    """The bodies in a view that a network restored."""
    points, height = points_and_heights(view)
    body, far_half = _restored_regions(height, measured.depth > 0, kind.segmentation.least_height), on_far_half(points)
    return Bodies(view, points, _largest_regions(body & far_half), body & ~far_half, kind, measured)


def _halves(view: View, points: np.ndarray, body: np.ndarray, kind: ImageKind, measured: View) -> Bodies:
    """The bodies of a mask (H, W), split into the two halves of the table."""
    far_half = on_far_half(points)
    return Bodies(view, points, body & far_half, body & ~far_half, kind, measured)


def points_and_heights(view: View) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) [m] see `world_points`; (H, W) [m] heights above the table, 0 without a return."""
    points = world_points(view)
    return points, np.where(view.depth > 0, points[..., 2], 0.0)


def _regions(mask: np.ndarray) -> np.ndarray:
    """(H, W) int: from 1 on the pixels of each connected region of a mask (H, W), 0 elsewhere."""
    return np.asarray(label(mask)[0], np.intp)  # type: ignore[index]


def _high_regions(height: np.ndarray, least: float) -> np.ndarray:
    """(H, W) bool: regions above the least height that hold a pixel above SURE_HEIGHT. height: (H, W) [m]."""
    regions = _regions(height > least)
    return np.isin(regions, np.unique(regions[height > SURE_HEIGHT]))


def _restored_regions(height: np.ndarray, returned: np.ndarray, least: float) -> np.ndarray:
    """(H, W) bool: regions above the least height [m] that the sensor saw too.

    returned: (H, W) bool, pixels with a return.
    """
    regions = _regions(height > least)
    count = int(regions.max()) + 1
    masks = regions > 0, returned, returned & (height > SURE_HEIGHT)
    pixels, with_return, sure = (np.bincount(regions[mask], minlength=count) for mask in masks)
    return ((sure >= LEAST_SURE) & (with_return >= RETURNED * pixels) & (pixels > 0))[regions]


def _largest_regions(body: np.ndarray) -> np.ndarray:
    """(H, W) bool: the largest region, and those of at least OF_LARGEST of its pixels."""
    regions = _regions(body)
    pixels = np.bincount(regions[body], minlength=1)
    return body & (pixels >= OF_LARGEST * pixels.max())[regions]


def on_far_half(points: np.ndarray) -> np.ndarray:
    """(...) bool: which points (..., 3) [m] of the world are on the kits' half of the table."""
    return points[..., 1] > 0


def world_points(view: View) -> np.ndarray:
    """(H, W, 3) [m] world: the points of all pixels; the camera's position for pixels without a return."""
    camera, pose = view.camera, view.world_from_camera
    rotation, depth = pose.rotation_matrix(), view.depth.astype(float)
    right = (np.arange(camera.width) - camera.cx) / camera.fx
    down = (np.arange(camera.height) - camera.cy)[:, None] / camera.fy
    rows = zip(pose.xyz, rotation, strict=True)
    return np.stack([x + depth * (a * right + b * down + c) for x, (a, b, c) in rows], axis=-1)


def without_shadows(view: View) -> View:
    """The view with gaps of up to SHADOW on either side closed along rows by the farther of the two depths."""
    known = view.depth > 0
    depth = np.where(known, view.depth, farther_sides(view.depth, known, SHADOW))
    return View(view.camera, view.world_from_camera, depth)


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
        finder: a network that separates parts in restored images; None merges pieces, as in ideal images.
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
    """The pieces of the parts: labels and joined neighbours, see `find_pieces`, points (h, w, 3) [m], and the box of
    rows and columns to which all are cropped."""
    rows, columns = np.nonzero(bodies.parts.any(1))[0], np.nonzero(bodies.parts.any(0))[0]
    if len(rows) == 0:
        return np.zeros((1, 1), int), [], np.zeros((1, 1, 3)), np.s_[0:1, 0:1]
    box = np.s_[max(rows[0] - 1, 0) : rows[-1] + 2, max(columns[0] - 1, 0) : columns[-1] + 2]
    depth = bodies.view.depth[box].astype(float)
    labels, joined = find_pieces(depth, bodies.parts[box], bodies.kind.segmentation)
    return labels, joined, bodies.points[box], box
