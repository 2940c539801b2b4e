"""How well kits are completed from one image, about the slot of a part: columns along the normal of its plate.

    python bench/quality/kit_completion.py data/kit1000 --split test

IoU of the occupied voxels of 2 mm and surface Chamfer distance, of all space, of hidden and of seen space, within the
plate and ABOVE it. Beside it a kit without cavity, the true one with its cavity filled, which shows what a number is
worth. The image of the d415 is calibrated and its edges are restored.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from bench.measured_dataset import measured_dataset
from bench.quality.completion_scores import (
    Scores,
    completion_scores,
    component_measures,
    score_columns,
    score_estimates,
)
from bench.quality.components import add_components
from benchmark.measurements import Column, Measurement
from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error
from kit1000.perception.observed.kits import ObservedKits
from kit1000.perception.observed.pixels import noise_of
from kit1000.perception.restoration import restored
from kit1000.values import Query, Truth
from kit1000.voxels import Volume, signed_distance
from kit1000.voxels.grid import DEFAULT_TRUNCATION

VOXEL = 2e-3  # [m]
ABOVE = 10e-3  # [m] the plate: there is free space to be found too
METHODS = ("columns", "without cavity")


@dataclass(frozen=True)
class KitCompletion:
    """Measure the completion of kits by columns."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    split: str = "test"
    sensor: Literal["ideal", "d415"] | None = None
    """One sensor; both when absent."""
    parts: int = 200
    """Most kits, spread evenly over the split; one of each scene."""
    components: Path | None = None
    """JSON file for Table II, to which the means are added."""
    out: Path | None = None
    """JSON file of the tables, such as results/kit-completion.json."""


def main(options: KitCompletion) -> None:
    """Print the scores over the kits of drawn queries."""
    with measured_dataset(options.data) as (dataset, _):
        measurement = Measurement.begin(dataset)
        title = f"Completed kits, voxels of {1e3 * VOXEL:g} mm, scenes of {options.split}"
        keys = Column("sensor", "sensor"), Column("method", "method"), Column("n", "n")
        table = measurement.table("scores", title, *keys, *score_columns())
        for sensor in (options.sensor,) if options.sensor else ("ideal", "d415"):
            found = list(_drawn(dataset, options, sensor))
            if not found:
                continue
            rows = [_measure(dataset, query, truth) for query, truth in found]
            clusters = [truth.assembly_id for _, truth in found]
            methods = {method: [row[i] for row in rows] for i, method in enumerate(METHODS)}
            for method, scores in methods.items():
                table.add(sensor=sensor, method=method, n=len(rows), **score_estimates(scores, clusters))
            if options.components is not None:
                component = f"kit completion, {sensor}"
                add_components(options.components, component, component_measures(methods), clusters)
        measurement.report(options.out)


def _drawn(dataset: Dataset, options: KitCompletion, sensor: str) -> Iterator[tuple[Query, Truth]]:
    """The first drawn query of each scene, with its truth."""
    scenes = dataset.split(options.split, truth=True)
    ids = scenes.scene_ids
    count = min(options.parts, len(ids))
    for i in range(count):
        scene = scenes.scene(ids[i * len(ids) // count])
        query = next((query for query in scene.queries if query.drawn and query.sensor == sensor), None)
        if query is not None:
            yield query, scene.truth_of(query.id)


def _measure(dataset: Dataset, query: Query, truth: Truth) -> tuple[Scores, Scores]:
    """Of the columns, and of the true kit without its cavity."""
    extent = dataset.geometry.kit(truth.part_id).extent
    half_width = float(extent[:2].max() / 2)
    kits = ObservedKits(restored(query.image, query.sensor), noise_of(query.sensor), query.scene_id, half_width)
    columns = kits.columns(truth.world_from_kit.apply(np.array([0, 0, -extent[2] / 2])), VOXEL)
    filled, hidden = columns.filled(largest_only=False), np.isnan(columns.distance[::2, ::2])
    true = dataset.geometry.true_geometry(truth)
    exact = signed_distance(filled.grid, [(true.assembly, true.world_from_assembly)], threads=1)
    kit = truth.world_from_kit.inverse().apply(filled.grid.centres())
    sides = np.abs(kit[..., :2]) - extent[:2] / 2
    plate = np.max([*np.moveaxis(sides, -1, 0), kit[..., 2], -extent[2] - kit[..., 2]], axis=0)
    solid = np.minimum(exact.values, (plate / (DEFAULT_TRUNCATION * VOXEL)).clip(-1, 1))
    within = (sides < 0).all(-1) & (kit[..., 2] > -extent[2]) & (kit[..., 2] < ABOVE)
    filled, exact, solid = (
        Volume.adopt(exact.grid, np.where(within, values, np.nan).astype(np.float32))
        for values in (filled.values, exact.values, solid)
    )
    return completion_scores(filled, exact, hidden), completion_scores(solid, exact, hidden)


if __name__ == "__main__":
    try:
        main(tyro.cli(KitCompletion))
    except Kit1000Error as error:
        raise SystemExit(f"kit_completion: {error}") from error
