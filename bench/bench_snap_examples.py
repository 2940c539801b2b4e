"""What an example costs before a network sees it: milliseconds of one core, from files and from memory.

    .venv/bin/python bench/bench_snap_examples.py data
    .venv/bin/python bench/bench_snap_examples.py data --preset paper --examples 8

Time is that of the processor, so other programs count little. `first` makes examples with nothing in memory (the files
themselves may be: the operating system keeps them), `again` the same ones once more. At the end exact volumes stand
beside the other way to true ones: a volume made once in the body's own frame, resampled for every example.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import tyro

from baselines.snapnet.config import POSITION, ROTATION, Kind
from baselines.snapnet.examples import PositionExamples, RotationExamples, Sensor, Situations
from baselines.snapnet.volumes import grid_about
from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.voxels import Grid, resample, signed_distance
from kit1000.voxels.grid import DEFAULT_TRUNCATION

Made = TypeVar("Made")

MADE: tuple[tuple[Kind, Sensor], ...] = (("truth", "ideal"), ("partial", "ideal"), ("partial", "d415"))


def main(dataset: tyro.conf.Positional[Path], preset: str = "small", examples: int = 60, resampled: int = 16) -> None:
    """Time examples of the train split.

    Args:
        dataset: folder.
        preset: small or paper.
        examples: how many the mean is of.
        resampled: of how many parts and assemblies true volumes are resampled.
    """
    data = Dataset(dataset)
    print(f"{'one example, ' + preset:34}{'first ms':>10}{'again ms':>10}")
    for kind, sensor in MADE:
        position = PositionExamples(Situations(data, "train", kind, "ball", sensor), POSITION[preset])
        print_draws(f"position, {kind}, {sensor}", position.draw, examples)
        rotation = RotationExamples(Situations(data, "train", kind, "ball", sensor), ROTATION[preset])
        print_draws(f"rotation, {kind}, {sensor}", rotation.draw, examples)
    print(f"peak of this process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB")
    if resampled:
        print_resampled(data, preset, resampled)


def print_draws(name: str, draw: Callable[[np.random.Generator], object], count: int) -> None:
    """Print a line with the mean time of examples, made twice."""
    draw(stream(0, "warm"))  # compiles and imports
    first, again = (timed(lambda: [draw(stream(0, i)) for i in range(count)])[0] for _ in range(2))
    print(f"{name:34}{first / count * 1e3:10.1f}{again / count * 1e3:10.1f}")


def print_resampled(data: Dataset, preset: str, count: int) -> None:
    """Print what resampling would save, and what it would get wrong."""
    config, told = POSITION[preset], Situations(data, "train", "truth")
    rows: dict[str, list[tuple[float, ...]]] = {"part": [], "kits": []}
    for i in range(count):
        each = told.draw(stream(1, i))
        truth = each.looks.truth
        assert truth is not None
        assembly = data.geometry.assembly(truth.assembly_id)
        kit = next(mount.assembly_from_kit for mount in assembly.mounts if mount.kit.id == truth.part_id)
        here = each.guess.inverse() @ each.world_from_work
        part = data.geometry.part(truth.part_id).mesh
        rows["part"].append(compared(grid_about(here, config.part_cells, config.voxel), part, truth.world_from_part))
        stands = truth.world_from_kit @ kit.inverse()
        grid = grid_about(each.world_from_work, config.kit_cells, config.voxel)
        rows["kits"].append(compared(grid, assembly.mesh, stands))
    print(
        f"\n{'true volume':12}{'exact ms':>10}{'resampled ms':>14}{'off by (99 %)':>18} voxels, {'signs':>6}, kept MB"
    )
    for name, row in rows.items():
        exact, other, mean, most, signs, size = np.mean(row, axis=0)
        print(f"{name:12}{exact:10.1f}{other:14.1f}{mean:9.3f} ({most:.3f}) voxels,{signs:7.1%},{size:8.2f}")


def compared(grid: Grid, mesh: Mesh, world_from_body: Pose) -> tuple[float, float, float, float, float, float]:
    """Times [ms] of exact and resampled values; how far these are off within the truncation, mean and 99 % [voxels];
    voxels with the other sign, as a share of those inside; and what would be kept as float16 [MB]."""
    low, high = mesh.bounds
    shape = np.ceil((high - low) / grid.voxel_size + 2 * DEFAULT_TRUNCATION + 3).astype(int)
    middle = Grid.centred(Pose.from_translation((low + high) / 2), (shape[0], shape[1], shape[2]), grid.voxel_size)
    own = signed_distance(middle, [(mesh, Pose.identity())], threads=1).moved(world_from_body)
    seconds, exact = timed(lambda: signed_distance(grid, [(mesh, world_from_body)], threads=1).filled(1.0))
    other, read = timed(lambda: resample(own, grid, threads=1).filled(1.0))
    near = np.abs(exact) < 1
    off = np.abs(exact - read)[near] * DEFAULT_TRUNCATION
    signs = ((exact < 0) != (read < 0)).sum() / max((exact < 0).sum(), 1)
    size = 2 * float(shape.prod()) / 1e6
    return seconds * 1e3, other * 1e3, float(off.mean()), float(np.quantile(off, 0.99)), float(signs), size


def timed(make: Callable[[], Made]) -> tuple[float, Made]:
    """Seconds of the processor, and what was made."""
    start = time.process_time()
    made = make()
    return time.process_time() - start, made


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except Kit1000Error as error:
        raise SystemExit(str(error)) from None
