"""Restoration by rules: an image calibrated by its table, with the edges that the sensor moved at their true pixels.

Nothing is learned and no truth is read: the table is part of the specification of every scene, and what the sensor does
to edges is part of its own (docs/reference/sensors.md). An ideal image stays as it is.

1. Camera pose and depth scale are corrected by the table, whose pixels are put on its plane (`perception.calibration`).
2. Pixels of a body without a return are shadows of the second imager: they take the farther depth of their row. On
   kits in a scanner's image they stay; on parts there, where steep walls return nothing either, that of their column is
   another guess.
3. A near surface that was fattened over a far one is cut back by about the mean extension. The far surface is continued
   parallel to the table.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import distance_transform_edt, find_objects

from kit1000.perception.calibration import calibrated_by, flattened, unbent
from kit1000.perception.sensor_facts import SensorFacts, simulated_sensor
from kit1000.sim.stereo import EDGE_STEP
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, Query, View

GAP = 20  # [px] the widest that is closed
EXTENSION = 0.55  # of the largest extension of an edge: there the rims of cavities have the least bias, on train
JUMP = 0.8 * EDGE_STEP  # [px] of disparity between neighbours, less than fattened edges have, as there is noise


def restored_query(query: Query) -> Query:
    """The query with its image restored when it is read; the same query if the sensor is ideal."""
    sensor = simulated_sensor(query.sensor)
    if sensor.kind.exact:
        return query
    return replace(query, read_image=lambda: restored(query.image, sensor))


def restored(image: LabelledDepth, sensor: SensorFacts) -> LabelledDepth:
    """The image as the sensor should have measured it, as far as its table and its masks show; the labels stay."""
    return restored_edges(calibrated_image(image, sensor), sensor)


def calibrated_image(image: LabelledDepth, sensor: SensorFacts) -> LabelledDepth:
    """The image of a noisy sensor, calibrated and unbent by the table; the same image if the sensor is ideal."""
    if sensor.kind.exact:
        return image
    return unbent_image(LabelledDepth(calibrated_by(image.view, image.labels, sensor), image.labels), sensor)


def unbent_image(image: LabelledDepth, sensor: SensorFacts) -> LabelledDepth:
    """A calibrated image without the smooth errors that a stereo camera's table shows; the same of other sensors."""
    if not sensor.kind.restores:
        return image
    return LabelledDepth(unbent(image.view, image.labels, sensor.baseline), image.labels)


def restored_edges(image: LabelledDepth, sensor: SensorFacts, columns: bool = False) -> LabelledDepth:
    """A calibrated image with its table on its plane and the edges where they should be; the same one if ideal.

    columns: see `close_gaps`.
    """
    if sensor.kind.exact:
        return image
    closed = closed_gaps(image, sensor.simulated_table, kits=sensor.kind.restores, columns=columns)
    depth, ground = closed.view.depth.copy(), ground_inverse_depth(closed.view)
    for box, mask in _bodies(image.labels):
        _cut_back(depth[box], mask, ground[box], closed.view.camera.fx, sensor)
    return LabelledDepth(replace(closed.view, depth=depth), image.labels)


def closed_gaps(
    image: LabelledDepth, simulated: bool = True, kits: bool = True, columns: bool = False
) -> LabelledDepth:
    """A calibrated image with its table on its plane, and narrow shadows on bodies filled from beside.

    Args:
        image: calibrated.
        simulated: whether the table is that of generated scenes.
        kits: whether those on kits are filled too: on a tilted floor a depth from beside is off by millimetres, and
            where edges are sharp, what is unknown does less harm.
        columns: see `close_gaps`.
    """
    view = flattened(image.view, image.labels, simulated)
    depth = view.depth.copy()
    for box, mask in _bodies(image.labels if kits else np.where(image.labels == ASSEMBLY_LABEL, 0, image.labels)):
        close_gaps(depth[box], mask, columns)
    return LabelledDepth(replace(view, depth=depth), image.labels)


def _bodies(labels: np.ndarray) -> Iterator[tuple[tuple[slice, slice], np.ndarray]]:
    """The box (rows, columns) of each body in masks (H, W) uint8, and its mask (bool) in it."""
    for label, box in enumerate(find_objects(labels), start=1):
        if box is not None:
            yield box, labels[box] == label


def ground_inverse_depth(view: View, step: int = 1) -> np.ndarray:
    """(H, W) [1/m]: the inverse depth of the plane z = 0 at each pixel; hardly above 0 if it is not seen.

    step: [px] between the pixels, along rows and columns.
    """
    down = -view.world_from_camera.inverse().rotate((0.0, 0.0, 1.0))
    height, camera = max(float(view.world_from_camera.xyz[2]), 1e-3), view.camera
    u, v = np.arange(0, camera.width, step), np.arange(0, camera.height, step)
    across = (u - camera.cx) / camera.fx * down[0]
    along = (v - camera.cy) / camera.fy * down[1]
    return np.maximum(across + along[:, None] + down[2], 1e-6) / height


def close_gaps(depth: np.ndarray, mask: np.ndarray, columns: bool = False) -> None:
    """Give masked pixels without return, in gaps of at most GAP along a row, the farther depth of the two sides.

    Such gaps are shadows of the sensor's projector or its second camera: they belong to the farther surface.

    columns: whether the farthest depth of all four sides counts, with those along a column.
    """
    known = mask & (depth > 0)
    farther = farther_sides(depth, known, GAP)
    if columns:
        farther = np.maximum(farther, farther_sides(depth.T, known.T, GAP).T)
    depth[mask & ~known] = farther[mask & ~known]


def farther_sides(depth: np.ndarray, known: np.ndarray, gap: int) -> np.ndarray:
    """(H, W) [m]: the farther of the nearest known depths of a row on either side, at most `gap` px away; 0 without."""
    columns = np.arange(depth.shape[1])
    left = np.maximum.accumulate(np.where(known, columns, -gap - 1), axis=1)
    right = np.minimum.accumulate(np.where(known, columns, len(columns) + gap)[:, ::-1], axis=1)[:, ::-1]
    sides = [np.where(np.abs(side - columns) <= gap, side, -1) for side in (left, right)]
    rows = np.arange(len(depth))[:, None]
    return np.maximum(*(np.where(side >= 0, depth[rows, side], 0) for side in sides))


def _cut_back(depth: np.ndarray, mask: np.ndarray, ground: np.ndarray, fx: float, sensor: SensorFacts) -> None:
    """Give the pixels of near surfaces beside a jump of the masked depths (H, W) the far surface there.

    ground: (H, W) [1/m] inverse depth of the table's plane, to which the far surface is continued in parallel.
    """
    mask = mask & (depth > 0)
    disparity = fx * sensor.baseline / np.where(mask, depth, 1.0)
    far = _beside_jumps(disparity, mask)
    if not far.any():
        return
    distance, nearest = distance_transform_edt(~far, return_indices=True)  # type: ignore[misc]
    at = (nearest[0].astype(int), nearest[1].astype(int))
    continued = depth[at] * ground[at] / ground
    in_front = disparity - fx * sensor.baseline / continued > JUMP / 2
    cut = mask & (distance <= EXTENSION * sensor.fattening_px) & in_front
    depth[cut] = continued[cut]


def _beside_jumps(disparity: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W) bool: masked pixels with a neighbour in their row or column that is nearer by a jump."""
    far = np.zeros(mask.shape, bool)
    for before, after in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        both, rise = mask[before] & mask[after], disparity[after] - disparity[before]
        far[before] |= both & (rise > JUMP)
        far[after] |= both & (rise < -JUMP)
    return far
