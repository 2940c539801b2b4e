"""Images as the restoring network has them: disparities [px] from that of the table's plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kit1000.camera import Camera
from kit1000.perception.restoration.rules import close_gaps, ground_inverse_depth
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

Inputs = dict[str, np.ndarray]
Box = tuple[slice, slice]

NEAR_TABLE = 1.5  # [px] from the table's plane, of the pixels that show how noisy the image is
LEVEL_STEP = 3  # [px] between them
STARTS = ((16, 16), (11, 7), (8, 13))  # [px] above and left of a box, where images of it begin; odd in number


def labelled_inputs(image: LabelledDepth, closed: View, sensor: SensorFacts) -> Inputs:
    """What the network reads of a calibrated image: see `RestorationNet.forward`; (H, W) arrays, `slope`, `level`.

    closed: its view, see `closed_gaps`.
    """
    kinds = np.select([image.labels == ASSEMBLY_LABEL, image.labels >= FIRST_PART_LABEL], [1, 2], 0)
    returned = (image.labels == 0) | (image.view.depth > 0)
    table = (image.labels == 0) & (image.view.depth > 0)
    return _inputs(closed, returned, kinds, sensor) | {"level": noise_level(image.view, table, sensor)}


def unlabelled_inputs(view: View, sensor: SensorFacts) -> Inputs:
    """The same of a calibrated view without masks: `labels` is 0 everywhere."""
    depth, everywhere = view.depth.copy(), np.ones(view.depth.shape, bool)
    close_gaps(depth, everywhere)
    returned = view.depth > 0
    read = _inputs(replace(view, depth=depth), returned, np.zeros(depth.shape), sensor)
    return read | {"level": noise_level(view, returned, sensor)}


def noise_level(calibrated: View, mask: np.ndarray, sensor: SensorFacts) -> np.ndarray:
    """(1,) float32 [px]: how far disparities are from those of the table's plane, noise and bending together.

    1.4826 times the median, the RMS if they are normal, of the pixels of a mask (H, W) within NEAR_TABLE px, every
    LEVEL_STEP-th along rows and columns; 0 if there is none.
    """
    some = np.s_[::LEVEL_STEP, ::LEVEL_STEP]
    depth, mask = calibrated.depth[some], mask[some] & (calibrated.depth[some] > 0)
    gain = sensor.gain(calibrated.camera)
    away = gain * np.abs(1 / depth[mask] - ground_inverse_depth(calibrated, LEVEL_STEP)[mask])
    away = away[away < NEAR_TABLE]
    level = 1.4826 * float(np.median(away)) if len(away) else 0.0
    return np.array([level], np.float32)


def _inputs(view: View, returned: np.ndarray, kinds: np.ndarray, sensor: SensorFacts) -> Inputs:
    disparity = above_table(view.depth, view, sensor)
    slope = sensor.gain(view.camera) * ground_slope(view)
    return {"disparity": disparity, "returned": returned, "labels": kinds.astype(np.uint8), "slope": slope}


def above_table(depth: np.ndarray, calibrated: View, sensor: SensorFacts) -> np.ndarray:
    """(H, W) float32 [px]: disparities of depths (H, W) [m] in the image of a calibrated view; 0 without surface."""
    seen = depth > 0
    above = 1 / np.where(seen, depth, 1.0) - ground_inverse_depth(calibrated)
    return np.where(seen, sensor.gain(calibrated.camera) * above, 0.0).astype(np.float32)


def depths(disparity: np.ndarray, view: View, box: Box, sensor: SensorFacts) -> np.ndarray:
    """[m] float32: the depths of disparities in a box of a calibrated view."""
    gain = sensor.gain(view.camera)
    inverse = ground_inverse_depth(view)[box] + disparity / gain
    return (1 / np.maximum(inverse, 1e-3)).astype(np.float32)


def ground_slope(view: View) -> np.ndarray:
    """(2,) float32 [1/(m px)]: of the inverse depth of the table's plane, along a row and along a column."""
    down = -view.world_from_camera.inverse().rotate((0.0, 0.0, 1.0))
    camera, height = view.camera, max(float(view.world_from_camera.xyz[2]), 1e-3)
    return np.array([down[0] / camera.fx, down[1] / camera.fy], np.float32) / np.float32(height)


def cropped_inputs(inputs: Inputs, box: Box) -> Inputs:
    """The inputs in a box of the image."""
    return {name: value if value.ndim == 1 else np.ascontiguousarray(value[box]) for name, value in inputs.items()}


def padded_box(rows: slice, columns: slice, side: int, camera: Camera) -> Box:
    """A box about another one within the image, its sides multiples of a number of pixels."""
    return _stretched(rows, side, camera.height), _stretched(columns, side, camera.width)


def median_of_shifts(predict: Callable[[Box], np.ndarray], box: Box, side: int, camera: Camera) -> np.ndarray:
    """(..., h, w) the median of predictions for a box, made from images that begin at several pixels.

    Networks are coarse inside: where an image begins, to `side` px, changes what they predict beside edges.

    predict: called with a box: (..., h, w).
    """
    found = []
    for start in STARTS:
        wide = shifted_box(box, start, side, camera)
        inside = (slice(at.start - w.start, at.stop - w.start) for at, w in zip(box, wide, strict=True))
        found.append(predict(wide)[(..., *inside)])
    return np.median(found, axis=0)


def shifted_box(box: Box, start: tuple[int, int], side: int, camera: Camera) -> Box:
    """A box of `side` px more in height and width that holds another one, beginning some px (at most that) before it.

    It begins nearer to it if the image begins or ends sooner, and is as large as the image if that is smaller.
    """
    sizes = (camera.height, camera.width)
    down, right = (_begun(at, before, side, size) for at, before, size in zip(box, start, sizes, strict=True))
    return down, right


def _begun(span: slice, before: int, side: int, size: int) -> slice:
    length = min(span.stop - span.start + side, size // side * side)
    start = min(max(span.start - before, 0, span.stop - length), size - length)
    return slice(start, start + length)


def _stretched(span: slice, side: int, size: int) -> slice:
    """A span that holds another one, a multiple of `side` long, within 0 to `size`."""
    length = min(-(-(span.stop - span.start) // side) * side, size // side * side)
    start = min(max((span.start + span.stop - length) // 2, 0), size - length)
    return slice(start, start + length)
