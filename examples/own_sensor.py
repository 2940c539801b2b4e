"""python examples/own_sensor.py tiny

Defines a depth sensor of your own and applies it to a recorded scene. A sensor is a function of the ideal
view and a random generator. Takes 2 s.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro

from kit1000 import Dataset, View

STEP = 2.0**-13  # [m] the grid of the depths that recordings store


def time_of_flight(view: View, rng: np.random.Generator) -> View:
    """Normal noise of 2 mm along the optical axis; no return beyond 1.2 m. The camera pose is exact."""
    noise = rng.normal(0, 2e-3, view.depth.shape)  # always as many draws, whatever is visible
    returned = (view.depth > 0) & (view.depth < 1.2)
    depth = np.where(returned, np.rint((view.depth + noise) / STEP) * STEP, 0)
    return View(view.camera, view.world_from_camera, depth.astype(np.float32))


def main(data: tyro.conf.Positional[Path] = Path("tiny")) -> None:
    """Measure a scene with the sensor.

    Args:
        data: the dataset folder.
    """
    scene = next(iter(Dataset(data).split("val")))
    for name in scene.sensors:
        print(f"recorded with {name}: {np.mean(scene.view(name).depth > 0):.1%} of the pixels have a return")
    ideal = scene.view("ideal")
    measured = time_of_flight(ideal, np.random.default_rng(0))
    both = (ideal.depth > 0) & (measured.depth > 0)
    error = np.abs(measured.depth - ideal.depth)[both]
    print(f"time of flight: {both.mean():.1%}, median error {np.median(error) * 1e3:.1f} mm")


if __name__ == "__main__":
    tyro.cli(main)
