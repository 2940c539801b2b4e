"""Reading a dataset: scenes, depth images and volumes a second, and whether two workers keep a training step fed.

    python bench/bench_reading.py data/kit1000

Without a folder a tiny dataset is made first. Random order; each scene is asked for anew, as in training. Fed means
that a loop of steps of 0.2 s waits for its batches less than a twentieth of the time.
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
from measured_dataset import measured_dataset
from torch.utils.data import DataLoader

from kit1000.dataset.cache import VolumeCache
from kit1000.dataset.items import Item, depth_item
from kit1000.dataset.reader import Split
from kit1000.dataset.torch import QueryDataset, VolumeItem
from kit1000.errors import Kit1000Error
from kit1000.values import Query, Truth, View

STEP = 0.2  # [s] of computation for a batch
SCENES, IMAGES = 200, 100  # [1/s] to reach, of scenes' queries and of depth images


@dataclass(frozen=True)
class Reading:
    """Measure how fast a dataset is read."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; a tiny one is made when absent."""
    seconds: float = 3.0
    """Of each measurement, at least."""
    batch: int = 8
    workers: int = 2
    seed: int = 0
    """Of the order."""


def main(asked: Reading) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    with measured_dataset(asked.data) as (dataset, spare):
        split = dataset.split("train", truth=True)
        track = next(query.track for query in split.queries() if query.guess is not None)
        queries = len(list(split.queries(track)))
        print(f"{dataset.root.name}: {len(split)} scenes of train, {queries} queries of {track}")
        order = np.random.default_rng(asked.seed)
        _rate("queries of a scene, no image", lambda i: split.scene(i).queries, split.scene_ids, order, asked, SCENES)
        first, shard = next(iter(split.shards.items()))
        for sensor in dataset.observation_file(shard).view_keys(first):
            view = partial(_view, split, sensor)
            _rate(f"depth image, {sensor}", view, split.scene_ids, order, asked, IMAGES)
        cache = VolumeCache(spare / "volumes")
        makers = {
            "the query alone": _nothing,
            "images and masks": depth_item,
            "volumes of 2 x 64^3 from depth": VolumeItem(dataset),
            "the same, true": VolumeItem(dataset, source="truth"),
            "the same, true, from the cache": VolumeItem(dataset, source="truth", cache=cache),
            "the same, as codes": VolumeItem(dataset, source="truth", cache=cache, codes=True),
        }
        for name, make in makers.items():
            items = QueryDataset(split, track, make)
            _warm(items)
            _rate(f"item: {name}", items.__getitem__, list(range(len(items))), order, asked)
        print(f"cache: {cache.size()}")
        for name, make in makers.items():
            _feed(name, QueryDataset(split, track, make), asked)


def _view(split: Split, key: str, scene_id: str) -> View:
    return split.dataset.observation_file(split.shards[scene_id]).view(scene_id, key)


def _nothing(query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
    return {"id": query.id}


def _warm(items: QueryDataset) -> None:
    """Compile, and fill the cache where there is one."""
    for index in range(len(items)) if getattr(items.make, "cache", None) else [0]:
        items[index]


def _rate(
    name: str, read: Callable[[Any], Any], of: list, order: np.random.Generator, asked: Reading, goal: float = 0
) -> None:
    """Print how many a second are read, beside the goal: in one random order again and again, so that nothing that
    is remembered of the last few helps."""
    shuffled = [of[i] for i in order.permutation(len(of))]
    read(shuffled[-1])
    count, started, computed = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - started < asked.seconds:
        for one in shuffled:
            read(one)
        count += len(shuffled)
    rate, cost = count / (time.perf_counter() - started), (time.process_time() - computed) / count
    print(
        f"{name:36}{rate:7.0f}/s{cost * 1e3:8.1f} ms of CPU"
        + (f"   goal {goal:.0f}: {'reached' if rate >= goal else 'MISSED'}" if goal else "")
    )


def _feed(name: str, items: QueryDataset, asked: Reading) -> None:
    """Print which share of its time a loop of steps spends waiting, its first batch apart."""
    steps = max(int(asked.seconds * 3 / STEP), 10)
    sampler = torch.utils.data.RandomSampler(items, replacement=True, num_samples=(steps + 1) * asked.batch)
    loader = DataLoader(items, asked.batch, sampler=sampler, num_workers=asked.workers)
    batches = iter(loader)
    next(batches)
    waited, started = 0.0, time.perf_counter()
    for _ in range(steps):
        begun = time.perf_counter()
        next(batches)
        waited += time.perf_counter() - begun
        _compute(STEP)
    share = waited / (time.perf_counter() - started)
    told = "fed" if share < 0.05 else "STARVED"
    print(f"{asked.workers} workers, {asked.batch} a batch, step {STEP} s: {name:32}{share:7.1%} waiting   {told}")


def _compute(seconds: float) -> None:
    """Keep one core busy, as a step on the CPU does."""
    matrix, started = torch.eye(64), time.perf_counter()
    while time.perf_counter() - started < seconds:
        matrix = matrix @ matrix


if __name__ == "__main__":
    try:
        main(tyro.cli(Reading, description=__doc__))
    except Kit1000Error as error:
        raise SystemExit(f"bench_reading: {error}") from error
