"""CPU milliseconds to make a training example of SnapNet, from files and from memory.

    python bench/speed/snap_examples.py data/kit1000
    python bench/speed/snap_examples.py data/kit1000 --preset paper --examples 8

Without a folder a tiny dataset is generated first. CPU time of one core, so other programs count little. `first` makes
examples with empty caches (the operating system may have cached the files), `again` the same ones once more. A second
table compares exact volumes with another scheme: one volume in the body's own frame, resampled for every example.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro

from baselines.snapnet.config import POSITION, ROTATION, Source
from baselines.snapnet.examples import PositionExamples, QuerySampler, RotationExamples, Sensor
from baselines.snapnet.query_volumes import grid_about
from bench.measured_dataset import measured_dataset
from bench.speed.timing import timed
from benchmark.measurements import Column, Measurement, Table, estimate
from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.voxels import Grid, resample, signed_distance
from kit1000.voxels.grid import DEFAULT_TRUNCATION

SOURCES: tuple[tuple[Source, Sensor], ...] = (("truth", "ideal"), ("depth", "ideal"), ("depth", "d415"))


EXAMPLE_COLUMNS = (
    Column("network", "network"),
    Column("source", "volumes"),
    Column("sensor", "sensor"),
    Column("n", "examples"),
    Column("first", "first, mean, ms", 1),
    Column("first_median", "median", 1),
    Column("again", "again, mean, ms", 1),
    Column("again_median", "median", 1),
    Column("ratio", "times the first line", 1),
)
RESAMPLED_COLUMNS = (
    Column("volume", "volume"),
    Column("n", "volumes"),
    Column("exact", "exact, ms", 1),
    Column("resampled", "resampled, ms", 1),
    Column("ratio", "exact / resampled", 1),
    Column("error", "error, mean, voxels", 3),
    Column("late", "error, 99 %, voxels", 3),
    Column("signs", "wrong signs, %", 1, True),
    Column("size", "cache, MB", 2),
)


@dataclass(frozen=True)
class Examples:
    """Time training examples."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    preset: str = "small"
    """small or paper."""
    examples: int = 30
    """Number of examples of each kind."""
    resampled: int = 16
    """Number of parts and assemblies whose volumes are resampled."""
    out: Path | None = None
    """JSON file of the tables, such as results/speed-snap-examples.json."""


class Compared(NamedTuple):
    """A resampled volume beside the exact one."""

    exact: float
    """[ms]"""
    resampled: float
    """[ms]"""
    error: float
    """[voxels] within the truncation, mean."""
    late: float
    """[voxels] the same, 99 %."""
    signs: float
    """Voxels with the wrong sign, as a share of those inside."""
    size: float
    """[MB] of the cache as float16."""


def main(options: Examples) -> None:
    """Print the tables."""
    with measured_dataset(options.data) as (dataset, _):
        measurement = Measurement.begin(dataset)
        title = f"CPU milliseconds to make a training example of SnapNet, preset `{options.preset}`"
        table = measurement.table("examples", title, *EXAMPLE_COLUMNS)
        for source, sensor in SOURCES:
            position, rotation = (QuerySampler(dataset, "train", source, "ball", sensor) for _ in range(2))
            draws = {
                "position": PositionExamples(position, POSITION[options.preset]).draw,
                "rotation": RotationExamples(rotation, ROTATION[options.preset]).draw,
            }
            for network, draw in draws.items():
                _add_draws(table, {"network": network, "source": source, "sensor": sensor}, draw, options.examples)
        table = measurement.table("resampled", "True volumes, exact and resampled", *RESAMPLED_COLUMNS)
        for volume, rows in _resampled(dataset, options).items():
            columns = dict(zip(Compared._fields, np.array(rows).T, strict=True))
            estimates = {name: estimate(values) for name, values in columns.items()}
            ratio = estimates["exact"]["mean"] / estimates["resampled"]["mean"]
            means = {name: estimates[name]["mean"] for name in ("late", "signs", "size")}
            table.add(volume=volume, n=len(rows), ratio=ratio, **estimates | means)
        measurement.report(options.out)
        print(f"peak memory of this process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB")


def _add_draws(table: Table, kind: dict[str, str], draw: Callable[[np.random.Generator], object], count: int) -> None:
    """Add a line with the time of examples, made twice."""
    draw(stream(0, "warm"))  # compiles and imports
    first, again = (
        estimate([1e3 * timed(lambda i=i: draw(stream(0, i)), time.process_time)[0] for i in range(count)])
        for _ in range(2)
    )
    reference = table.rows[0]["first"] if table.rows else first
    medians = {"first_median": first["median"], "again_median": again["median"]}
    table.add(**kind, n=count, first=first, again=again, ratio=first["mean"] / reference["mean"], **medians)


def _resampled(dataset: Dataset, options: Examples) -> dict[str, list[Compared]]:
    """Resampled volumes beside exact ones, of parts and of kits."""
    config, sampler = POSITION[options.preset], QuerySampler(dataset, "train", "truth")
    rows: dict[str, list[Compared]] = {"part": [], "kits": []}
    for i in range(options.resampled):
        sample = sampler.draw(stream(1, i))
        true = sample.volumes.geometry
        assert true is not None
        part_grid = grid_about(sample.guess.inverse() @ sample.world_from_work, config.part_cells, config.voxel)
        rows["part"].append(compared(part_grid, true.part, true.world_from_part))
        grid = grid_about(sample.world_from_work, config.kit_cells, config.voxel)
        rows["kits"].append(compared(grid, true.assembly, true.world_from_assembly))
    return rows


def compared(grid: Grid, mesh: Mesh, world_from_body: Pose) -> Compared:
    """The volume of a body on a grid, exact and resampled from one in its own frame."""
    low, high = mesh.bounds
    shape = np.ceil((high - low) / grid.voxel_size + 2 * DEFAULT_TRUNCATION + 3).astype(int)
    middle = Grid.centred(Pose.from_translation((low + high) / 2), (shape[0], shape[1], shape[2]), grid.voxel_size)
    own = signed_distance(middle, [(mesh, Pose.identity())], threads=1).moved(world_from_body)
    seconds, exact = timed(
        lambda: signed_distance(grid, [(mesh, world_from_body)], threads=1).filled(1.0), time.process_time
    )
    other, read = timed(lambda: resample(own, grid, threads=1).filled(1.0), time.process_time)
    near = np.abs(exact) < 1
    error = np.abs(exact - read)[near] * DEFAULT_TRUNCATION
    signs = ((exact < 0) != (read < 0)).sum() / max((exact < 0).sum(), 1)
    size = 2 * float(shape.prod()) / 1e6
    return Compared(1e3 * seconds, 1e3 * other, error.mean(), np.quantile(error, 0.99), float(signs), size)


if __name__ == "__main__":
    try:
        main(tyro.cli(Examples))
    except Kit1000Error as error:
        raise SystemExit(f"snap_examples: {error}") from error
