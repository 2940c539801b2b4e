"""The errors of real depth images beside those of our simulated sensors, by the same code.

    python bench/quality/sensor_statistics.py data/kit1000 --images DIR --out results/sensor-statistics.json
    python bench/quality/sensor_statistics.py --images DIR

DIR holds depth images as 16-bit PNG, npy or npz, and `manifest.csv`, a table with the columns file, sensor (D415, D435
or PhoXi in its name), metres_a_unit and fx [px]: so whoever has a camera can run it on theirs. Our sensors measure the
ideal images of a dataset. Statistics are in pixels of disparity, see `depth_statistics.py`; those of the D435 are
enlarged to the focal length and baseline of our images.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from bench.quality.depth_images import BASELINES, DepthImage, read_images
from bench.quality.depth_statistics import FOCAL, image_statistics
from benchmark.measurements import Column, Measurement, Table
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, Kit1000Error
from kit1000.rng import stream
from kit1000.sim.sensors import SENSORS, sense

ROWS = {
    "flat_px": "noise on flat tiles of 48 px, RMS px",
    "half_across": "correlation one half there, px across",
    "half_down": "px down",
    "wide_half_across": "on tiles of 64 px, px across",
    "wide_half_down": "px down, tiles of 64 px",
    "far_correlation": "correlation at 13 px across",
    "low_pass_px": "below 40 px of the spectrum, RMS px",
    "ramps_1_2": "ramps at jumps of 1 to 2 px",
    "ramps_2_3": "of 2 to 3 px",
    "ramps_3_5": "of 3 to 5 px",
    "ramps_5_8": "of 5 to 8 px",
    "ramps_8_20": "of 8 to 20 px",
    "holes_left": "holes left of near surfaces, share of jumps over 3 px",
    "holes_right": "right of near surfaces",
    "holes_columns": "above and below them",
    "shadow_left": "width of holes on the left, px a px of jump over 5 px",
    "shadow_right": "on the right",
}
"""Statistics in words."""
ENLARGED = ("half_across", "half_down", "wide_half_across", "wide_half_down")  # lengths in the image
TOLERANCE = 0.02  # beyond the real range at which a statistic still counts as within


@dataclass(frozen=True)
class SensorStatistics:
    """Measure real and simulated depth images by the same code."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder, whose ideal images our sensors measure; without one only real images are measured."""
    images: Path | None = None
    """Folder of real depth images with a manifest.csv."""
    scenes: int = 12
    """Number of scenes of the split, the first ones."""
    split: str = "test"
    out: Path | None = None
    """JSON file for the table, such as results/sensor-statistics.json."""


Group = dict[str, list[float]]


def main(options: SensorStatistics) -> None:
    """Print a table of ranges."""
    if options.data is None and options.images is None:
        raise InputError("expected a dataset folder, or --images with a folder of real images")
    dataset = None if options.data is None else Dataset(options.data)
    measurement = Measurement.begin(dataset)
    measurement.setting["command"] = measurement.setting["command"].replace(str(options.images), "IMAGES")
    real = {} if options.images is None else real_groups(read_images(options.images))
    ours = {} if dataset is None else our_groups(dataset, options.split, options.scenes)
    for title, kinds, name in (("stereo", ("D415", "D435"), "d415"), ("scanner", ("PhoXi",), "photoneo")):
        groups = {key: group for key, group in {**real, **ours}.items() if key in (*kinds, name)}
        if groups:
            _add_rows(measurement, title, groups, [kind for kind in kinds if kind in real], name)
    measurement.report(options.out)


def real_groups(images: list[DepthImage]) -> dict[str, Group]:
    """The statistics of real images, by the kind of their sensor."""
    groups: dict[str, Group] = {}
    for image in images:
        scale = FOCAL / image.fx if image.kind == "D435" else 1.0
        found = image_statistics(image.depth, image.gain, image.fx).named()
        longer = BASELINES["D415"] / BASELINES["D435"] if image.kind == "D435" else 1.0
        for name, value in found.items():
            factor = scale if name in ENLARGED else scale * longer if name in ("flat_px", "low_pass_px") else 1.0
            groups.setdefault(image.kind, {}).setdefault(name, []).append(value * factor)
    return groups


def our_groups(dataset: Dataset, split: str, scenes: int) -> dict[str, Group]:
    """The statistics of the ideal images of some scenes as our sensors measure them, by sensor."""
    groups: dict[str, Group] = {}
    for scene_id in dataset.split(split).scene_ids[:scenes]:
        ideal = dataset.split(split).scene(scene_id).labelled_depth("ideal").view
        for name in ("d415", "photoneo"):
            measured = sense(name, ideal, stream(0, "statistics", scene_id)).depth
            gain = ideal.camera.fx * SENSORS[name].baseline
            for key, value in image_statistics(measured, gain, ideal.camera.fx, ideal.depth).named().items():
                groups.setdefault(name, {}).setdefault(key, []).append(value)
    return groups


def _add_rows(measurement: Measurement, title: str, groups: dict[str, Group], real: list[str], sensor: str) -> None:
    """Add a table of the ranges of each statistic, and whether those of our sensor's images lie in the real one."""
    columns = [Column("statistic", "statistic"), *(Column(name, name) for name in groups)]
    columns += [Column("within", "images within the real range")] if real and sensor in groups else []
    counts = ", ".join(f"{name} {len(group['flat_px'])}" for name, group in groups.items())
    table: Table = measurement.table(title, f"Lowest, median and highest of the images: {counts}", *columns)
    for key, words in ROWS.items():
        values = {name: _spread(group[key]) for name, group in groups.items()}
        if real and sensor in groups:
            values["within"] = _share_within(
                groups[sensor][key], [value for name in real for value in groups[name][key]]
            )
        table.add(statistic=words, **values)


def _spread(values: list[float]) -> str:
    """Lowest, median and highest, as text."""
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return "–"
    low, middle, high = (float(np.quantile(known, share)) for share in (0, 0.5, 1))
    digits = 3 if high < 0.5 else 2
    return f"{low:.{digits}f}, {middle:.{digits}f}, {high:.{digits}f}"


def _share_within(values: list[float], real: list[float]) -> str:
    """How many values lie between the lowest and the highest real one, of those that are known."""
    known, ends = ([value for value in each if math.isfinite(value)] for each in (values, real))
    if not known or not ends:
        return "–"
    inside = [min(ends) - TOLERANCE <= value <= max(ends) + TOLERANCE for value in known]
    return f"{sum(inside)} of {len(known)}"


if __name__ == "__main__":
    try:
        main(tyro.cli(SensorStatistics))
    except Kit1000Error as error:
        raise SystemExit(f"sensor_statistics: {error}") from error
