"""Mean IoU of the instance masks that `kit1000.perception.segmentation` finds, over the scenes of a split.

    python bench/quality/segmentation.py data/kit1000 --split test

A part that is not found counts as 0. Noisy images are segmented in three ways: without networks, restored by a network,
and with a second network that separates parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Literal, NamedTuple

import numpy as np
import tyro

from bench.measured import add_components, measured_dataset, run, spread
from benchmark.measurements import Column, Measurement, Table, estimate, rate
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.metrics.segmentation import matched_masks
from kit1000.perception.segmentation.instances import segmented
from kit1000.perception.segmentation.predicted_masks import mask_networks
from kit1000.perception.sensor_facts import simulated_sensor

Networks = Literal["none", "restoration", "both"]
NETWORKS: tuple[Networks, ...] = ("none", "restoration", "both")
SENSORS = ("ideal", "d415")
COLUMNS = (
    Column("sensor", "sensor"),
    Column("networks", "networks"),
    Column("group", "scenes"),
    Column("n", "n"),
    Column("iou", "IoU, %", 1, True),
    Column("median", "median", 1, True),
    Column("parts", "IoU of parts, %", 1, True),
    Column("kits", "IoU of kits, %", 1, True),
    Column("counted", "number of parts right, %", 1, True),
)
SECONDS = (
    Column("sensor", "sensor"),
    Column("networks", "networks"),
    Column("n", "images"),
    Column("seconds", "mean, s", 2),
    Column("median", "median", 2),
)


@dataclass(frozen=True)
class Segmentation:
    """Segment the scenes of a split."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    split: str = "test"
    sensor: Literal["ideal", "d415"] | None = None
    """One sensor; both when absent."""
    scenes: int = 200
    """Most scenes, spread evenly over the split."""
    networks: tuple[Networks, ...] = NETWORKS
    """Ways to segment noisy images; the last one is the component of Table II."""
    components: Path | None = None
    """JSON file for Table II, to which the mean is added."""
    out: Path | None = None
    """JSON file of the tables, such as results/segmentation.json."""


class Masks(NamedTuple):
    """A segmented scene."""

    assembly_id: str
    crowded: bool
    iou: np.ndarray
    """(1 + parts,) of the kits and of each part."""
    counted: bool
    """Whether as many parts are found as there are."""
    seconds: float


def main(options: Segmentation) -> None:
    """Print the IoU of all scenes, of those whose parts lie apart and of crowded ones."""
    with measured_dataset(options.data) as (dataset, _):
        measurement = Measurement.begin(dataset)
        title = f"Mean IoU of the masks of a scene, scenes of {options.split}"
        masks = measurement.table("masks", title, *COLUMNS)
        seconds = measurement.table("seconds", "CPU seconds an image", *SECONDS)
        for sensor in (options.sensor,) if options.sensor else SENSORS:
            ways: tuple[Networks, ...] = ("none",) if sensor == "ideal" else options.networks
            for networks in ways:
                found = _measured(dataset, options, sensor, networks)
                _add(masks, sensor, networks, found)
                spent = estimate([each.seconds for each in found])
                row = {"n": len(found), "seconds": spent, "median": spent["median"]}
                seconds.add(sensor=sensor, networks=networks, **row)
                if options.components is not None and networks == ways[-1]:
                    method = "votes of pixels" if networks == "both" else "pieces of surfaces"
                    values = {f"{method}: mean IoU of a scene": [float(each.iou.mean()) for each in found]}
                    clusters = [each.assembly_id for each in found]
                    add_components(options.components, f"segmentation, {sensor}", values, clusters)
        measurement.report(options.out)


def _measured(dataset: Dataset, options: Segmentation, sensor: str, networks: Networks) -> list[Masks]:
    """The masks of scenes spread evenly over a split."""
    restorer, finder = (None, None) if networks == "none" else mask_networks()
    finder = finder if networks == "both" else None
    split, scale = dataset.split(options.split, truth=True), dataset.summary["config"]["scale"]

    def masks_of(scene: RecordedScene) -> Masks:
        image = scene.labelled_depth(sensor)
        start = process_time()
        found = segmented(image.view, simulated_sensor(sensor), scale, restorer, finder)
        seconds = process_time() - start
        iou = matched_masks(found, image.labels).iou
        crowded = any(truth.crowded for truth in scene.truths.values())
        return Masks(scene.scene.bodies[0].id, crowded, iou, found.max() == image.labels.max(), seconds)

    return [masks_of(split.scene(name)) for name in spread(split.scene_ids, options.scenes)]


def _add(table: Table, sensor: str, networks: Networks, found: Sequence[Masks]) -> None:
    """Add a row for all scenes, for those whose parts lie apart and for crowded ones."""
    groups = {
        "all": found,
        "apart": [each for each in found if not each.crowded],
        "crowded": [each for each in found if each.crowded],
    }
    for group, rows in groups.items():
        if not rows:
            continue
        iou = estimate([row.iou.mean() for row in rows], [row.assembly_id for row in rows])
        parts, kits = (float(np.mean([row.iou[where].mean() for row in rows])) for where in (slice(1, None), 0))
        values = {"iou": iou, "median": iou["median"], "parts": parts, "kits": kits}
        counted = rate([row.counted for row in rows])
        table.add(sensor=sensor, networks=networks, group=group, n=len(rows), counted=counted, **values)


if __name__ == "__main__":
    run(main, Segmentation, __doc__)
