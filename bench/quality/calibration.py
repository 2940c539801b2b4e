"""Errors of camera pose and depth scale of the d415: as recorded, and calibrated by plane and outline of the table.

    python bench/quality/calibration.py data/kit1000 --split test

The true pose and depths are those of the ideal image of the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
import tyro

from bench.measured import measured_dataset, run, spread, timed
from benchmark.measurements import Column, Measurement, estimate
from kit1000.dataset.reader import RecordedScene
from kit1000.perception.calibration import OUTLINE, calibrated
from kit1000.perception.calibration.camera_pose import OutlineEdge
from kit1000.values import View

WAYS: dict[str, Sequence[OutlineEdge] | None] = {
    "as recorded": None,
    "plane": (),
    "plane, outline": OUTLINE,
}
"""Borders that are used besides the plane of the table, by name; None: no calibration."""
WAY = Column("way", "calibrated by")
ERROR_COLUMNS = (
    WAY,
    Column("n", "images"),
    Column("position", "position, mm", 2),
    Column("position_median", "median", 2),
    Column("angle", "rotation, °", 3),
    Column("angle_median", "median", 3),
    Column("scale", "scale, ‰", 2),
    Column("scale_median", "median", 2),
)
SECONDS = (WAY, Column("n", "images"), Column("seconds", "mean, s", 3), Column("median", "median", 3))


@dataclass(frozen=True)
class Calibration:
    """Measure the calibration of noisy images by the table."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    split: str = "test"
    scenes: int = 200
    """Most scenes, spread evenly over the split."""
    out: Path | None = None
    """JSON file of the tables, such as results/calibration.json."""


def main(options: Calibration) -> None:
    """Print the errors of position, rotation and scale."""
    with measured_dataset(options.data) as (dataset, _):
        split = dataset.split(options.split, truth=True)
        scenes = [split.scene(name) for name in spread(split.scene_ids, options.scenes)]
        count = len(scenes)
        rows, clusters = [_measured(scene) for scene in scenes], [scene.scene.bodies[0].id for scene in scenes]
        measurement = Measurement.begin(dataset)
        title = f"Mean absolute error of camera pose and depth scale of the d415, images of {options.split}"
        errors = measurement.table("errors", title, *ERROR_COLUMNS)
        times = measurement.table("seconds", "CPU seconds an image", *SECONDS)
        for way, measured in zip(WAYS, np.swapaxes(rows, 0, 1), strict=True):
            sizes = {
                "position": np.linalg.norm(measured[:, :3], axis=1),
                "angle": np.linalg.norm(measured[:, 3:6], axis=1),
                "scale": np.abs(measured[:, 6]),
            }
            estimates = {key: estimate(values, clusters) for key, values in sizes.items()}
            medians = {f"{key}_median": each["median"] for key, each in estimates.items()}
            errors.add(way=way, n=count, **estimates, **medians)
            if WAYS[way] is not None:
                seconds = estimate(measured[:, -1])
                times.add(way=way, n=count, seconds=seconds, median=seconds["median"])
        measurement.report(options.out)


def _measured(scene: RecordedScene) -> np.ndarray:
    """(ways, 8) the errors of the camera by each of the WAYS, and the seconds that it takes."""
    image, true = scene.labelled_depth("d415"), scene.labelled_depth("ideal").view
    rows = []
    for borders in WAYS.values():
        seconds, view = timed(
            lambda borders=borders: (
                image.view if borders is None else calibrated(image.view, image.labels, borders=borders)
            ),
            process_time,
        )
        rows.append([*camera_errors(view, true), seconds])
    return np.array(rows)


def camera_errors(view: View, true: View) -> np.ndarray:
    """(7,) position [mm] and rotation vector [degrees] of the camera along the axes of the world, and scale [‰]."""
    error = true.world_from_camera.inverse() @ view.world_from_camera
    position, rotvec = true.world_from_camera.rotate(np.stack([error.xyz, error.rotvec()]))
    both = (view.depth > 0) & (true.depth > 0)
    scale = float(np.median(view.depth[both] / true.depth[both]))
    return np.array([*1e3 * position, *np.degrees(rotvec), 1e3 * (scale - 1)])


if __name__ == "__main__":
    run(main, Calibration, __doc__)
