"""Errors of depths of the d415: calibrated by the table, restored by rules, and by the network.

    python bench/quality/restoration.py data/kit1000 --split test

The mean absolute error of depth [mm] is given for pixels of kits and of parts, beside edges and elsewhere. A pixel
without a return counts if every way gives it a depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
import torch
import tyro

from baselines.training.tasks.restoration import FACTS, SENSOR, beside_jumps, example_of
from bench.measured import measured_dataset, run, spread, timed
from benchmark.measurements import Column, Measurement, Table, estimate
from kit1000.dataset.reader import RecordedScene
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.restoration.rules import calibrated_image, closed_gaps, restored_edges
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL
from kit1000.weights import WEIGHTS

WAYS = ("calibrated", "rules", "network")
PLACES = ("kits, beside edges", "kits, elsewhere", "parts, beside edges", "parts, elsewhere")
SECONDS = (Column("n", "images"), Column("seconds", "mean, s", 2))
FAR = 5.0  # [mm] a larger error means that the pixel shows another surface


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
    out: Path | None = None
    """JSON file of the tables, such as results/restoration.json."""


class Errors(NamedTuple):
    """Errors of depth in one of the PLACES of a scene."""

    assembly_id: str
    means: list[float]
    """Mean absolute error of each of the WAYS [mm]."""
    far: list[float]
    """Share of pixels with errors above FAR, of each of the WAYS."""


def main(options: Restoration) -> None:
    """Print the tables."""
    torch.set_num_threads(1)
    restorer = Restorer(options.weights)
    with measured_dataset(options.data) as (dataset, _):
        split = dataset.split(options.split, truth=True)
        measured = [_measured(split.scene(name), restorer) for name in spread(split.scene_ids, options.scenes)]
        measurement = Measurement.begin(dataset)
        columns = [
            Column("place", "pixels"),
            Column("way", "depth"),
            Column("n", "scenes"),
            Column("error", "error, mm", 2),
        ]
        columns += [Column("median", "median", 2), Column("far", f"beyond {FAR:g} mm, %", 1, True)]
        title = f"Mean absolute error of the d415's depth, scenes of {options.split}"
        table = measurement.table("errors", title, *columns)
        for place in PLACES:
            _add(table, place, [errors[place] for errors, _ in measured if place in errors])
        speed = measurement.table("seconds", "CPU seconds of the network an image", *SECONDS)
        speed.add(seconds=estimate([seconds for _, seconds in measured]), n=len(measured))
        measurement.report(options.out)


def _add(table: Table, place: str, rows: list[Errors]) -> None:
    """Add the errors of a place, a row for each of WAYS."""
    means, far = (np.array([row[k] for row in rows]) for k in (1, 2))
    clusters = [row.assembly_id for row in rows]
    for k, way in enumerate(WAYS):
        error = estimate(means[:, k], clusters)
        table.add(place=place, way=way, n=len(rows), error=error, median=error["median"], far=far[:, k].mean())


def _measured(scene: RecordedScene, restorer: Restorer) -> tuple[dict[str, Errors], float]:
    """The errors in those of the PLACES that a scene has, and the seconds of the network."""
    image = calibrated_image(scene.labelled_depth(SENSOR), FACTS)
    truth = scene.labelled_depth("ideal").view.depth
    labels = np.unique(image.labels[image.labels > 0]).tolist()
    seconds, network = timed(lambda: restorer(image, FACTS, labels), process_time)
    ways = [found.view.depth for found in (closed_gaps(image), restored_edges(image, FACTS), network)]
    known = np.all([depth > 0 for depth in ways], axis=0)
    beside = beside_jumps(torch.from_numpy(example_of(image, truth)["truth"])[None])[0].numpy()
    bodies = (image.labels == ASSEMBLY_LABEL, image.labels >= FIRST_PART_LABEL)
    masks = [known & body & where for body in bodies for where in (beside, ~beside)]
    wrong, assembly_id = [1e3 * np.abs(depth - truth) for depth in ways], scene.scene.bodies[0].id
    errors = {
        place: Errors(assembly_id, [float(each[mask].mean()) for each in wrong], [_far(each[mask]) for each in wrong])
        for place, mask in zip(PLACES, masks, strict=True)
        if mask.any()
    }
    return errors, seconds


def _far(wrong: np.ndarray) -> float:
    return float((wrong > FAR).mean())


if __name__ == "__main__":
    run(main, Restoration, __doc__)
