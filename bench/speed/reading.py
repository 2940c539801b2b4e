"""Speed of reading a dataset: scenes, depth images and volumes per second, and whether two workers feed a training.

    python bench/speed/reading.py data/kit1000

Without a folder a tiny dataset is generated first. Scenes are read in random order, each one from the start, as in
training. Two workers suffice when a loop of steps of 0.2 s waits for its batches less than 5 % of the time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from torch.utils.data import DataLoader

from bench.measured_dataset import measured_dataset
from kit1000.dataset.cache import VolumeCache
from kit1000.dataset.items import Item, depth_item
from kit1000.dataset.reader import Split
from kit1000.dataset.torch import QueryDataset, VolumeItem
from kit1000.errors import Kit1000Error
from kit1000.values import Query, Truth, View

STEP = 0.2  # [s] of computation for a batch
SCENES, IMAGES = 200, 100  # [1/s] goals for the queries of scenes, and for depth images


@dataclass(frozen=True)
class Reading:
    """Measure how fast a dataset is read."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; a tiny dataset is generated when absent."""
    seconds: float = 3.0
    """Minimum duration of each measurement."""
    batch: int = 8
    workers: int = 2
    seed: int = 0
    """Seed of the random order."""


def main(options: Reading) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    with measured_dataset(options.data) as (dataset, temporary_folder):
        split = dataset.split("train", truth=True)
        track = next(query.track for query in split.queries() if query.guess is not None)
        queries = len(list(split.queries(track)))
        print(f"{dataset.root.name}: {len(split)} scenes of train, {queries} queries of {track}")
        order = np.random.default_rng(options.seed)
        _print_rate(
            "queries of a scene, no image", lambda i: split.scene(i).queries, split.scene_ids, order, options, SCENES
        )
        first, shard = next(iter(split.shards.items()))
        for sensor in dataset.observation_file(shard).view_keys(first):
            view = partial(_read_view, split, sensor)
            _print_rate(f"depth image, {sensor}", view, split.scene_ids, order, options, IMAGES)
        cache = VolumeCache(temporary_folder / "volumes")
        makers = {
            "the query alone": _id_only,
            "images and masks": depth_item,
            "volumes of 2 x 64^3 from depth": VolumeItem(dataset),
            "the same, true": VolumeItem(dataset, source="truth"),
            "the same, true, from the cache": VolumeItem(dataset, source="truth", cache=cache),
            "the same, as codes": VolumeItem(dataset, source="truth", cache=cache, codes=True),
        }
        for name, make in makers.items():
            items = QueryDataset(split, track, make)
            _warm_up(items)
            _print_rate(f"item: {name}", items.__getitem__, list(range(len(items))), order, options)
        print(f"cache: {cache.size()}")
        for name, make in makers.items():
            _print_waiting(name, QueryDataset(split, track, make), options)


def _read_view(split: Split, key: str, scene_id: str) -> View:
    return split.dataset.observation_file(split.shards[scene_id]).view(scene_id, key)


def _id_only(query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
    return {"id": query.id}


def _warm_up(items: QueryDataset) -> None:
    """Compile, and fill the cache if there is one."""
    for index in range(len(items)) if getattr(items.make, "cache", None) else [0]:
        items[index]


def _print_rate(
    name: str, read: Callable[[Any], Any], items: list, order: np.random.Generator, options: Reading, goal: float = 0
) -> None:
    """Print how many items are read per second, and the goal. The random order makes caches of the last few useless."""
    shuffled = [items[i] for i in order.permutation(len(items))]
    read(shuffled[-1])
    count, started, computed = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - started < options.seconds:
        for one in shuffled:
            read(one)
        count += len(shuffled)
    rate, cost = count / (time.perf_counter() - started), (time.process_time() - computed) / count
    print(
        f"{name:36}{rate:7.0f}/s{cost * 1e3:8.1f} ms of CPU"
        + (f"   goal {goal:.0f}: {'reached' if rate >= goal else 'MISSED'}" if goal else "")
    )


def _print_waiting(name: str, items: QueryDataset, options: Reading) -> None:
    """Print the share of time that a loop of training steps waits for batches, without the first batch."""
    steps = max(int(options.seconds * 3 / STEP), 10)
    sampler = torch.utils.data.RandomSampler(items, replacement=True, num_samples=(steps + 1) * options.batch)
    loader = DataLoader(items, options.batch, sampler=sampler, num_workers=options.workers)
    batches = iter(loader)
    next(batches)
    waited, started = 0.0, time.perf_counter()
    for _ in range(steps):
        step_started = time.perf_counter()
        next(batches)
        waited += time.perf_counter() - step_started
        _compute(STEP)
    share = waited / (time.perf_counter() - started)
    verdict = "sufficient" if share < 0.05 else "TOO SLOW"
    print(
        f"{options.workers} workers, {options.batch} a batch, step {STEP} s: {name:32}{share:7.1%} waiting   {verdict}"
    )


def _compute(seconds: float) -> None:
    """Keep one core busy, like a training step on the CPU."""
    matrix, started = torch.eye(64), time.perf_counter()
    while time.perf_counter() - started < seconds:
        matrix = matrix @ matrix


if __name__ == "__main__":
    try:
        main(tyro.cli(Reading, description=__doc__))
    except Kit1000Error as error:
        raise SystemExit(f"reading: {error}") from error
