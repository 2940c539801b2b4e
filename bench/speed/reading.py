"""Speed of reading a dataset: scenes, depth images and volumes per second.

    python bench/speed/reading.py data/kit1000

Without a folder a tiny dataset is generated first. Scenes are read in random order, each one from the start, as in
training.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from torch.utils.data import Subset

from bench.measured import measured_dataset, run
from benchmark.measurements import Column, Measurement
from kit1000.dataset.reader import Split
from kit1000.dataset.torch import Item, QueryDataset, depth_item
from kit1000.pose import Pose
from kit1000.values import Query, Truth, View
from kit1000.voxels import Grid, tsdf

RATES = (
    Column("read", "read"),
    Column("n", "reads"),
    Column("rate", "per second", 0),
    Column("ms", "CPU, ms", 2),
    Column("ratio", "times queries alone", 1),
    Column("goal", "goal, per second", 0),
)
SCENES, IMAGES = 200, 100  # [1/s] goals for the queries of scenes, and for depth images


def id_only(query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
    """An item that needs no image."""
    return {"id": query.id}


def volumes(query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
    """Signed distances of part and kits from the depth image, on grids of 64 x 64 x 64 voxels of 1.5 mm."""
    grid = Grid.centred(Pose.from_translation(query.pivot), (64, 64, 64), 1.5e-3)
    masks = {"part": query.part_mask, "kit": query.kit_region}
    return {name: tsdf(grid, query.view, mask, threads=1).filled(1.0) for name, mask in masks.items()}


MAKERS = {"the query alone": id_only, "images and masks": depth_item, "volumes of 64^3 from depth": volumes}


@dataclass(frozen=True)
class Reading:
    """Measure how fast a dataset is read."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; a tiny dataset is generated when absent."""
    seconds: float = 2.0
    """Minimum duration of each measurement."""
    items: int = 300
    """Most scenes and most items that are read, drawn at random."""
    seed: int = 0
    """Seed of the random order."""
    out: Path | None = None
    """JSON file of the tables, such as results/speed-reading.json."""


def main(options: Reading) -> None:
    """Print the tables."""
    torch.set_num_threads(1)
    with measured_dataset(options.data) as (dataset, _):
        split = dataset.split("train", truth=True)
        track = next(query.track for query in split.queries() if query.guess is not None)
        items = {name: _drawn(QueryDataset(split, track, make), options) for name, make in MAKERS.items()}
        measurement = Measurement.begin(dataset)
        measurement.table("rates", f"Reading in random order, items of `{track}`", *RATES)
        _add_scenes(measurement, split, options)
        for name, subset in items.items():
            _add_rate(measurement, f"item: {name}", subset.__getitem__, range(len(subset)), options)
        measurement.report(options.out)


def _drawn(items: QueryDataset, options: Reading) -> Subset:
    """Some of the items, in random order; the same ones each time."""
    order = np.random.default_rng(options.seed).permutation(len(items))
    return Subset(items, order[: options.items].tolist())


def _add_scenes(measurement: Measurement, split: Split, options: Reading) -> None:
    """Add the rates of scenes and of their images."""
    order = np.random.default_rng(options.seed).permutation(len(split))
    scenes = [split.scene_ids[i] for i in order[: options.items]]
    _add_rate(measurement, "queries of a scene, no image", lambda i: split.scene(i).queries, scenes, options, SCENES)
    first, shard = next(iter(split.shards.items()))
    for sensor in split.dataset.observation_file(shard).view_keys(first):
        view = partial(_read_view, split, sensor)
        _add_rate(measurement, f"depth image, {sensor}", view, scenes, options, IMAGES)


def _read_view(split: Split, key: str, scene_id: str) -> View:
    return split.dataset.observation_file(split.shards[scene_id]).view(scene_id, key)


def _add_rate(
    measurement: Measurement,
    name: str,
    read: Callable[[Any], Any],
    keys: Sequence[Any],
    options: Reading,
    goal: int | None = None,
) -> None:
    """Add how many are read per second. Their random order makes caches of the last few useless."""
    table = measurement.tables["rates"]
    read(keys[-1])
    count, started, computed = 0, time.perf_counter(), time.process_time()
    for key in cycle(keys):
        read(key)
        count += 1
        if time.perf_counter() - started > options.seconds:
            break
    rate, ms = count / (time.perf_counter() - started), 1e3 * (time.process_time() - computed) / count
    reference = table.rows[0]["ms"] if table.rows else ms
    table.add(read=name, n=count, rate=rate, ms=ms, ratio=ms / reference, goal=goal)


if __name__ == "__main__":
    run(main, Reading, __doc__)
