"""CPU milliseconds to make a training example of SnapNet, from files and from memory.

    .venv/bin/python bench/speed/snap_examples.py data
    .venv/bin/python bench/speed/snap_examples.py data --preset paper --examples 8

CPU time of one core, so other programs count little. `first` makes examples with empty caches (the operating system may
have cached the files), `again` the same ones once more. At the end exact volumes are compared with another scheme: one
volume in the body's own frame, resampled for every example.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import tyro

from baselines.snapnet.config import POSITION, ROTATION, Source
from baselines.snapnet.examples import PositionExamples, QuerySampler, RotationExamples, Sensor
from baselines.snapnet.volumes import grid_about
from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.voxels import Grid, resample, signed_distance
from kit1000.voxels.grid import DEFAULT_TRUNCATION

Result = TypeVar("Result")

SOURCES: tuple[tuple[Source, Sensor], ...] = (("truth", "ideal"), ("depth", "ideal"), ("depth", "d415"))


def main(dataset: tyro.conf.Positional[Path], preset: str = "small", examples: int = 60, resampled: int = 16) -> None:
    """Time examples of the train split.

    Args:
        dataset: folder.
        preset: small or paper.
        examples: number of examples.
        resampled: number of parts and assemblies whose volumes are resampled.
    """
    data = Dataset(dataset)
    print(f"{'one example, ' + preset:34}{'first ms':>10}{'again ms':>10}")
    for source, sensor in SOURCES:
        position = PositionExamples(QuerySampler(data, "train", source, "ball", sensor), POSITION[preset])
        print_draws(f"position, {source}, {sensor}", position.draw, examples)
        rotation = RotationExamples(QuerySampler(data, "train", source, "ball", sensor), ROTATION[preset])
        print_draws(f"rotation, {source}, {sensor}", rotation.draw, examples)
    print(f"peak of this process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB")
    if resampled:
        print_resampled(data, preset, resampled)


def print_draws(name: str, draw: Callable[[np.random.Generator], object], count: int) -> None:
    """Print a line with the mean time of examples, made twice."""
    draw(stream(0, "warm"))  # compiles and imports
    first, again = (timed(lambda: [draw(stream(0, i)) for i in range(count)])[0] for _ in range(2))
    print(f"{name:34}{first / count * 1e3:10.1f}{again / count * 1e3:10.1f}")


def print_resampled(data: Dataset, preset: str, count: int) -> None:
    """Print the time and the error of resampling."""
    config, sampler = POSITION[preset], QuerySampler(data, "train", "truth")
    rows: dict[str, list[tuple[float, ...]]] = {"part": [], "kits": []}
    for i in range(count):
        sample = sampler.draw(stream(1, i))
        true = sample.volumes.geometry
        assert true is not None
        part_grid = grid_about(sample.guess.inverse() @ sample.world_from_work, config.part_cells, config.voxel)
        rows["part"].append(compared(part_grid, true.part, true.world_from_part))
        grid = grid_about(sample.world_from_work, config.kit_cells, config.voxel)
        rows["kits"].append(compared(grid, true.assembly, true.world_from_assembly))
    print(
        f"\n{'true volume':12}{'exact ms':>10}{'resampled ms':>14}{'error (99 %)':>18} voxels, {'signs':>6}, cached MB"
    )
    for name, row in rows.items():
        exact, other, mean, most, signs, size = np.mean(row, axis=0)
        print(f"{name:12}{exact:10.1f}{other:14.1f}{mean:9.3f} ({most:.3f}) voxels,{signs:7.1%},{size:8.2f}")


def compared(grid: Grid, mesh: Mesh, world_from_body: Pose) -> tuple[float, float, float, float, float, float]:
    """Times [ms] of exact and resampled values; the error of the latter within the truncation, mean and 99 % [voxels];
    voxels with the wrong sign, as a share of those inside; and the cache as float16 [MB]."""
    low, high = mesh.bounds
    shape = np.ceil((high - low) / grid.voxel_size + 2 * DEFAULT_TRUNCATION + 3).astype(int)
    middle = Grid.centred(Pose.from_translation((low + high) / 2), (shape[0], shape[1], shape[2]), grid.voxel_size)
    own = signed_distance(middle, [(mesh, Pose.identity())], threads=1).moved(world_from_body)
    seconds, exact = timed(lambda: signed_distance(grid, [(mesh, world_from_body)], threads=1).filled(1.0))
    other, read = timed(lambda: resample(own, grid, threads=1).filled(1.0))
    near = np.abs(exact) < 1
    error = np.abs(exact - read)[near] * DEFAULT_TRUNCATION
    signs = ((exact < 0) != (read < 0)).sum() / max((exact < 0).sum(), 1)
    size = 2 * float(shape.prod()) / 1e6
    return seconds * 1e3, other * 1e3, float(error.mean()), float(np.quantile(error, 0.99)), float(signs), size


def timed(make: Callable[[], Result]) -> tuple[float, Result]:
    """CPU seconds, and the result."""
    start = time.process_time()
    result = make()
    return time.process_time() - start, result


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except Kit1000Error as error:
        raise SystemExit(str(error)) from None
