"""Do environments of gymnasium score as the board does, and read as fast as `Dataset`? In CPU time, one process.

python bench/outside/environments.py data/kit1000 --out results/gymnasium.json
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from bench.measured import measured_dataset, run, spread, timed
from benchmark.measurements import Column, Measurement, estimate
from kit1000.dataset.reader import Dataset
from kit1000.files import read_json
from kit1000.gym import AssemblyEnv, motion_vector

BOARD = Path("submissions/guess/scores.json")


@dataclass(frozen=True)
class Options:
    """What is measured."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder. Default: a new tiny one."""
    reads: int = 100
    """Number of queries that are read both ways."""
    out: Path | None = None
    """JSON file to write."""


def read(dataset: Dataset, scene_id: str, name: str) -> int:
    """Read a query from its files and copy its depth, as an observation has it and a tensor needs it."""
    query = next(query for query in dataset.split("test").scene(scene_id).queries if query.id == name)
    return query.view.depth.copy().size + query.part_mask.size + query.kit_region.size


def milliseconds(env: AssemblyEnv, dataset: Dataset, names: list[str]) -> tuple[list[float], list[float]]:
    """CPU milliseconds of each read by the environment and by the dataset, in turn; each has images of its own."""
    clock = time.process_time
    ours = [1e3 * timed(partial(env.reset, options={"query": name}), clock)[0] for name in names]
    return ours, [1e3 * timed(partial(read, dataset, env.scenes[name], name), clock)[0] for name in names]


def main(options: Options) -> None:
    """Measure, print and write."""
    with measured_dataset(options.data) as (dataset, _):
        measurement = Measurement.begin(dataset)
        table = measurement.table(
            "scores",
            "Queries of test as episodes of `kit1000/Snap-v0`, and the guess on the board",
            Column("sensor", "sensor"),
            Column("n", "n"),
            Column("truth", "reward of the true motion", 2),
            Column("guess", "of the guess", 2),
            Column("position", "guess, mm", 2),
            Column("board", "on the board, mm", 2),
            Column("reset", "reset, CPU ms", 1),
            Column("read", "read by `Dataset`, ms", 1),
        )
        for sensor in ("ideal", "d415"):
            env = AssemblyEnv(dataset.root, "snap", "test", sensor)
            true, guess, position = [], [], []
            for name in env.scenes:
                observation, _ = env.reset(options={"query": name})
                true.append(env.step(motion_vector(dataset.truth_of(env.query).goal_drawn))[1])
                _, reward, _, _, info = env.step(observation["guess"])
                guess.append(reward)
                position.append(1e3 * info["position"])
            track = "snap" if sensor == "ideal" else f"snap-{sensor}"
            ours, theirs = milliseconds(env, dataset, spread(list(env.scenes), options.reads))
            board = read_json(BOARD)["tracks"][track]["position_mm"]["mean"] if options.data else None
            measured = {"truth": np.mean(true), "guess": np.mean(guess), "position": np.mean(position), "board": board}
            table.add(sensor=sensor, n=len(true), **measured, reset=estimate(ours), read=estimate(theirs))
        measurement.report(options.out)


if __name__ == "__main__":
    run(main, Options, __doc__)
