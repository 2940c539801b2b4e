"""The table of an image, or the reading of its values that shows one: unit, order of bytes, ray length, disparity.

A reading is proposed only if a table is found with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kit1000.capture.depth_frames import UNITS, DepthFrame, UnlikelyDepth, mean_depth, metric_depth
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.pinhole_images import PinholeImage, pinhole_image
from kit1000.capture.table_search import NoTable, Table, find_table
from kit1000.errors import InputError

DOUBTFUL_SHARE = 0.5  # of the pixels with a return: with a smaller table all other readings are tried,
ROUND_SHARE = 0.8  # with a smaller one lengths of rays, which bend a table
SURE_SHARE = 0.75  # of them on the table of a reading that is surely right: codes of a range reach 0.6 on true depths
UNIT_SHARE = 0.5  # ratio of a unit's table to that of the best other reading, at least
FAR_BETTER = 1.25  # ratio of the shares of a surely right reading and of the next one, at least
NEAR_TABLE, FAR_TABLE = 0.12, 1.5  # [m] of the camera above a table
SMALL_KIT, LARGE_KIT = 30e-3, 0.4  # [m] longer side of a kit
FINE_UNITS = (1e-4, 2e-4, 2.5e-4)  # [m] usual units beside 1 mm
MIDDLE_DEPTH = 0.7  # [m] median depth that values without a unit are scaled to
NEAR_ENDS = (0.25, 0.5, 1.0, 2.0)  # ratios of the near end of a range to the median code above it, which are tried


class Reading(NamedTuple):
    """What the values of an image may be."""

    share: float
    """Share of the pixels with a return that lie on its table."""
    text: str
    """The end of a message."""


def image_and_table(frames: Sequence[DepthFrame], known: Intrinsics, unit: float) -> tuple[PinholeImage, Table]:
    """The image of frames, without distortion, and its table.

    Args:
        frames: of one size; their median is taken.
        known: the intrinsics.
        unit: [m] that 1 stands for.

    Raises:
        InputError: the frames have several sizes, or no table is found, or far more of the image is a table if its
            values are read in another way, which the message names.
    """
    first = frames[0]
    try:
        image = image_of_frames(frames, known, unit)
        table = find_table(image, first.source)
    except (UnlikelyDepth, NoTable) as error:
        raise InputError(f"{error}{_best_reading(first, known, unit, 0.0)}") from None
    share = table_share(table)
    if share < ROUND_SHARE and (better := _best_reading(first, known, unit, share)):
        raise InputError(f"{first.source}: the table fills {100 * share:.0f} % of the depths{better}")
    return image, table


def image_of_frames(frames: Sequence[DepthFrame], known: Intrinsics, unit: float) -> PinholeImage:
    """The median of frames, undistorted; raises InputError if they have several sizes, or no depths of a table."""
    first = frames[0]
    for frame in frames[1:]:
        if frame.values.shape != first.values.shape:
            sizes = f"{frame.values.shape[::-1]} px, the first frame has {first.values.shape[::-1]}"
            raise InputError(f"{frame.source}: {sizes}")
    return pinhole_image(mean_depth([metric_depth(frame, unit) for frame in frames]), known, first.source)


def table_share(table: Table) -> float:
    """The share of the pixels with a return that lie on a table."""
    return float(np.count_nonzero(table.solid_mask) / max(np.count_nonzero(table.image.depth), 1))


def check_assumed_unit(source: str, unit: float, distance: float, kit: tuple[float, float]) -> None:
    """Raise InputError if a unit that nothing states makes a scene so large that a finer unit fits better.

    Args:
        source: the image, for the message.
        unit: [m] that 1 was taken for.
        distance: of the camera from the table [m], with this unit.
        kit: sides of the kit [m], the shorter first, with this unit.
    """
    if distance <= FAR_TABLE and kit[1] <= LARGE_KIT:
        return
    fits = []
    for other in FINE_UNITS:
        ratio = other / unit
        if NEAR_TABLE <= ratio * distance <= FAR_TABLE and SMALL_KIT <= ratio * kit[1] <= LARGE_KIT:
            fits.append(f"--depth-scale {other:g} ({_scene_text(ratio * distance, ratio * kit[0], ratio * kit[1])})")
    if fits:
        raise InputError(
            f"{source}: taken in mm, which nothing states, {_scene_text(distance, *kit)}; give --depth-scale {unit:g} "
            f"if that is so, or {' or '.join(fits)}"
        )


def _scene_text(distance: float, short: float, long: float) -> str:
    return f"camera {100 * distance:.0f} cm above the table, kit {1e3 * short:.0f} x {1e3 * long:.0f} mm"


def _best_reading(frame: DepthFrame, known: Intrinsics, unit: float, share: float) -> str:
    """The reading that surely fits better, else the unit with which a table is found, as the end of a message.

    share: of the pixels with a return on the table that was found; 0: none was found. The text is empty if there is a
    table and no reading surely fits better.
    """
    kinds = [_as_rays] if share >= DOUBTFUL_SHARE else [_with_swapped_bytes, _as_rays, _inverted]
    found = [reading for kind in kinds if (reading := kind(frame, known, unit)) is not None]
    best = max(found, key=lambda reading: reading.share, default=Reading(0.0, ""))
    if share < DOUBTFUL_SHARE:
        codes = _as_codes(frame, known, unit)
        best = codes if codes.share >= max(SURE_SHARE, FAR_BETTER * best.share) else best
    other = None if share else _in_another_unit(frame, known, unit)
    surely = best.share >= max(SURE_SHARE, FAR_BETTER * share)
    if other is not None and other.share >= (1.0 if surely else UNIT_SHARE) * best.share > 0:
        return other.text
    if surely:
        return best.text
    return "" if share else ": no usual unit, order of bytes or kind of value shows a table: is it a depth image?"


def _in_another_unit(frame: DepthFrame, known: Intrinsics, unit: float) -> Reading | None:
    values, middle = _positive(frame)
    other = next((u for u in UNITS if u != unit and _is_table_depth(middle * u)), None)
    if _is_table_depth(middle * unit) or other is None:
        return None
    share, _ = _share_and_distance(values * other, known, frame.source)
    text = f"; in units of {UNITS[other]} it would be {middle * other:.2f} m: --depth-scale {other:g}"
    return Reading(share, text)


def _with_swapped_bytes(frame: DepthFrame, known: Intrinsics, unit: float) -> Reading | None:
    if not frame.integers or frame.values.dtype.itemsize != 2:
        return None
    values, middle = _positive(frame.with_swapped_bytes)
    size = next((size for size in (unit, *UNITS) if _is_table_depth(middle * size)), None)
    if size is None:
        return None
    share, away = _share_and_distance(values * size, known, frame.source)
    text = f"; with both bytes of each value swapped a table lies {away:.2f} m away in units of {size:g} m"
    return Reading(share, f"{text}: write the file in its own order of bytes")


def _as_rays(frame: DepthFrame, known: Intrinsics, unit: float) -> Reading | None:
    values, middle = _positive(frame)
    if not _is_table_depth(middle * unit):
        return None
    v, u = np.indices(values.shape)
    lengths = np.sqrt(((u - known.cx) / known.fx) ** 2 + ((v - known.cy) / known.fy) ** 2 + 1)  # of rays of depth 1
    share, _ = _share_and_distance(values * unit / lengths, known, frame.source)
    text = f"; read as lengths of rays it fills {100 * share:.0f} %: divide them by sqrt(x² + y² + 1), where"
    return Reading(share, f"{text} x = (u - cx) / fx and y = (v - cy) / fy")


def _inverted(frame: DepthFrame, known: Intrinsics, _: float) -> Reading | None:
    values, middle = _positive(frame)
    depth = np.where(values > 0, MIDDLE_DEPTH * middle / np.where(values > 0, values, 1), 0)
    share, _ = _share_and_distance(depth, known, frame.source)
    return Reading(
        share, "; the values fall with distance, as disparities: give depth = focal length x baseline / disparity"
    )


def _as_codes(frame: DepthFrame, known: Intrinsics, _: float) -> Reading:
    values, middle = _positive(frame)
    shares = [
        _share_and_distance(
            np.where(values > 0, (values / middle + near) * MIDDLE_DEPTH / (1 + near), 0), known, frame.source
        )[0]
        for near in NEAR_ENDS
    ]
    text = "; the values fit as codes of a range: give depth = near + code x (far - near) / largest code"
    return Reading(max(shares), text)


def _positive(frame: DepthFrame) -> tuple[np.ndarray, float]:
    """(H, W) the values of a frame, 0 without a return, and their median."""
    values = np.where(np.isfinite(frame.values) & (frame.values > 0), frame.values, 0).astype(float)
    return values, float(np.median(values[values > 0])) if values.any() else 0.0


def _is_table_depth(depth: float) -> bool:
    return NEAR_TABLE <= depth <= 2 * FAR_TABLE


def _share_and_distance(depth: np.ndarray, known: Intrinsics, source: str) -> tuple[float, float]:
    """The share of the pixels with a return that lie on the table of depths (H, W) [m], and its distance [m]."""
    try:
        table = find_table(pinhole_image(depth.astype(np.float32), known, source), source)
    except InputError:
        return 0.0, 0.0
    return table_share(table), table.distance
