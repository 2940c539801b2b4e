"""How far camera pose and depth scale of the d415 are off: as recorded, and calibrated by more and more of the table.

    python bench/quality/calibration.py data/kit1000 --split test

Root mean squares over the images: position and height in mm along the axes of the world, angles in degrees, scale in
parts per thousand. The true pose and depths are those of the ideal image of the scene.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from bench.measured_dataset import measured_dataset
from kit1000.dataset.reader import RecordedScene
from kit1000.errors import Kit1000Error
from kit1000.perception.calibration import BLIND_BAND, BORDERS, OUTLINE, calibrated
from kit1000.perception.calibration.borders import Border
from kit1000.values import View

WAYS: dict[str, Sequence[Border] | None] = {
    "as recorded": None,
    "plane": (),
    "plane and blind band": (BLIND_BAND,),
    "plane and outline": OUTLINE,
    "plane, outline and blind band": BORDERS,
}
"""By name: the borders that are used beside the table's plane; None: no calibration."""
HEADER = f"{'':30} {'x':>6} {'y':>6} {'height':>6} mm  {'roll':>6} {'pitch':>6} {'yaw':>6} °  {'scale':>6} ‰  seconds"


@dataclass(frozen=True)
class Calibration:
    """Measure the calibration of noisy images by the table."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    split: str = "test"
    scenes: int = 200
    """Most scenes, spread evenly over the split."""


def main(options: Calibration) -> None:
    """Print a table."""
    with measured_dataset(options.data) as (dataset, _):
        split = dataset.split(options.split, truth=True)
        ids = split.scene_ids
        count = min(options.scenes, len(ids))
        rows = [_measured(split.scene(ids[i * len(ids) // count])) for i in range(count)]
    print(f"{options.split}: {count} images, root mean squares\n{HEADER}")
    for way, measured in zip(WAYS, np.swapaxes(rows, 0, 1), strict=True):
        x, y, height, roll, pitch, yaw, scale, _ = np.sqrt(np.mean(measured**2, axis=0))
        place, angles = f"{x:6.2f} {y:6.2f} {height:6.2f}", f"{roll:6.3f} {pitch:6.3f} {yaw:6.3f}"
        print(f"{way:30} {place} mm  {angles} °  {scale:6.2f} ‰  {measured[:, -1].mean():.3f}")


def _measured(scene: RecordedScene) -> np.ndarray:
    """(ways, 8) the errors of the camera by each of the WAYS, and the seconds that it takes."""
    image, true = scene.labelled_depth("d415"), scene.labelled_depth("ideal").view
    rows = []
    for borders in WAYS.values():
        start = time.process_time()
        view = image.view if borders is None else calibrated(image.view, image.labels, borders=borders)
        seconds = time.process_time() - start
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
    try:
        main(tyro.cli(Calibration))
    except Kit1000Error as error:
        raise SystemExit(f"calibration: {error}") from error
