"""How far depths of the d415 are from the truth: calibrated by the table, restored by rules, and by the network.

    python bench/bench_restoration.py data/kit1000 --split test

Mean absolute error of the depth of the pixels of kits and of parts, in mm, beside edges and elsewhere. Pixels without a
return count where every way gives them a depth.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import tyro
from measured_dataset import measured_dataset

from baselines.catalog import WEIGHTS
from baselines.restoration.edges import calibrated_image, closed_gaps, restored_edges
from baselines.restoration.learned import Restorer
from baselines.restoration.task import beside_jumps
from baselines.restoration.views import SENSOR, example_of
from benchmark.intervals import ENDS, bootstrap_means
from kit1000.dataset.reader import RecordedScene
from kit1000.errors import Kit1000Error
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL

WAYS = ("calibrated", "rules", "network")
PLACES = ("kits, beside edges", "kits, elsewhere", "parts, beside edges", "parts, elsewhere")
FAR = 5.0  # [mm] from the truth, from which on a pixel shows another surface


@dataclass(frozen=True)
class Restoration:
    """Measure the restoration of noisy depth."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    split: str = "test"
    weights: Path = WEIGHTS / "restoration"
    """Stem of the network's weights."""
    scenes: int = 200
    """Most scenes, spread evenly over the split."""


class Measured(NamedTuple):
    """A scene, restored."""

    assembly_id: str
    errors: np.ndarray
    """(PLACES, WAYS) [mm] means."""
    far: np.ndarray
    """(PLACES, WAYS) shares of pixels that are FAR off."""
    seconds: float
    """Of the network."""


def main(options: Restoration) -> None:
    """Print a table."""
    torch.set_num_threads(1)
    restorer = Restorer(options.weights)
    with measured_dataset(options.data) as (dataset, _):
        split = dataset.split(options.split, truth=True)
        ids = split.scene_ids
        count = min(options.scenes, len(ids))
        rows = [_measured(split.scene(ids[i * len(ids) // count]), restorer) for i in range(count)]
        clusters = [row.assembly_id for row in rows]
        print(f"{dataset.root.name}, {options.split}: {count} scenes")
        for k, place in enumerate(PLACES):
            errors = np.array([row.errors[k] for row in rows])
            low, high = np.quantile(bootstrap_means(errors, [clusters]), ENDS, axis=0)
            for j, way in enumerate(WAYS):
                mean, far = errors[:, j].mean(), 100 * np.mean([row.far[k, j] for row in rows])
                interval = f"[{low[j]:.2f}, {high[j]:.2f}]"
                print(f"  {place:20} {way:10} {mean:5.2f} {interval} mm; {far:4.1f} % beyond {FAR:g} mm")
        print(f"  seconds of the network: median {np.median([row.seconds for row in rows]):.2f}")


def _measured(scene: RecordedScene, restorer: Restorer) -> Measured:
    image = calibrated_image(scene.labelled_depth(SENSOR), SENSOR)
    truth = scene.labelled_depth("ideal").view.depth
    labels = np.unique(image.labels[image.labels > 0]).tolist()
    start = time.process_time()
    network = restorer(image, SENSOR, labels)
    seconds = time.process_time() - start
    ways = [found.view.depth for found in (closed_gaps(image), restored_edges(image, SENSOR), network)]
    known = np.all([depth > 0 for depth in ways], axis=0)
    beside = beside_jumps(torch.from_numpy(example_of(image, truth)["truth"])[None])[0].numpy()
    bodies = (image.labels == ASSEMBLY_LABEL, image.labels >= FIRST_PART_LABEL)
    places = [known & body & where for body in bodies for where in (beside, ~beside)]
    wrong = [1e3 * np.abs(depth - truth) for depth in ways]
    errors = np.array([[each[place].mean() for each in wrong] for place in places])
    far = np.array([[(each[place] > FAR).mean() for each in wrong] for place in places])
    return Measured(scene.scene.bodies[0].id, errors, far, seconds)


if __name__ == "__main__":
    try:
        main(tyro.cli(Restoration))
    except Kit1000Error as error:
        raise SystemExit(f"bench_restoration: {error}") from error
