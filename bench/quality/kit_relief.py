"""How well the hidden cells of plates are completed from one image: by columns, and by the network.

    python bench/quality/kit_relief.py data/kit1000 --split test

Mean absolute error of the depth of the hidden cells of every plate that is found, in mm, 0 to 22 below the plate's
face. The image of the d415 is calibrated by the table and restored by a network first.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import tyro

from baselines.training.tasks.kit_completion.views import on_plate
from bench.measured_dataset import measured_dataset
from benchmark.measurements import Column, Measurement, estimate, rate
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import Kit1000Error
from kit1000.numerics.linear_algebra import length
from kit1000.perception.completion.kits.completed import ReliefCompleter, filled_by_columns
from kit1000.perception.observed.kits import ObservedKits
from kit1000.perception.observed.pixels import noise_of
from kit1000.perception.observed.relief import true_depths
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.restoration.restorer import Restorer
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL
from kit1000.weights import WEIGHTS

FOUND_ANGLE, FOUND_DISTANCE = np.radians(5), 3e-3  # [rad], [m] between the true face of a plate and the one found
HIDDEN_CELLS = 10  # least of a plate that counts
METHODS = ("edge of the shadow", "columns", "network")
SENSOR = Column("sensor", "sensor")
ERROR_COLUMNS = (
    SENSOR,
    Column("method", "depth of hidden cells"),
    Column("n", "plates"),
    Column("error", "error, mm", 2),
    Column("median", "median", 2),
)
PLATE_COLUMNS = (
    SENSOR,
    Column("n", "plates"),
    Column("found", "found, %", 1, True),
    Column("hidden", "hidden cells, %", 1, True),
    Column("seen", "error of seen cells, median, mm", 2),
)
SECONDS = (SENSOR, Column("n", "plates"), Column("seconds", "mean, s", 3), Column("median", "median", 3))


@dataclass(frozen=True)
class KitRelief:
    """Measure the completion of kits."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    split: str = "test"
    weights: Path = WEIGHTS / "kit-completion"
    """Stem of the network's weights."""
    restoration: Path = WEIGHTS / "restoration"
    """Stem of those of the network that restores images of the d415."""
    scenes: int = 200
    """Most scenes, spread evenly over the split."""
    sensors: tuple[str, ...] = ("ideal", "d415")
    out: Path | None = None
    """JSON file of the tables, such as results/kit-relief.json."""


class Measured(NamedTuple):
    """A plate, completed."""

    assembly_id: str
    errors: tuple[float, ...]
    """[mm] mean of the hidden cells, by METHODS."""
    seen: float
    """[mm] median error of the seen cells."""
    hidden: float
    """Share of the plate's cells."""
    seconds: float


def main(options: KitRelief) -> None:
    """Print the errors of hidden cells, and how many plates and cells count."""
    torch.set_num_threads(1)
    completer, restorer = ReliefCompleter(options.weights), Restorer(options.restoration)
    with measured_dataset(options.data) as (dataset, _):
        measurement = Measurement.begin(dataset)
        title = f"Mean absolute error of the depth of hidden cells, plates of {options.split}"
        measurement.table("errors", title, *ERROR_COLUMNS)
        title = f"Plates that are found and have {HIDDEN_CELLS} hidden cells"
        measurement.table("plates", title, *PLATE_COLUMNS)
        measurement.table("seconds", "CPU seconds of the network a plate", *SECONDS)
        for sensor in options.sensors:
            split = dataset.split(options.split, truth=True)
            ids = split.scene_ids
            count = min(options.scenes, len(ids))
            scenes = [split.scene(ids[i * len(ids) // count]) for i in range(count)]
            measured = [row for scene in scenes for row in _measured(dataset, scene, sensor, completer, restorer)]
            _add(measurement, sensor, measured)
        measurement.report(options.out)


def _add(measurement: Measurement, sensor: str, measured: list[Measured | None]) -> None:
    """Add the rows of a sensor to the tables."""
    rows = [row for row in measured if row is not None]
    errors, clusters = np.array([row.errors for row in rows]), [row.assembly_id for row in rows]
    for k, method in enumerate(METHODS):
        error = estimate(errors[:, k], clusters)
        row = {"n": len(rows), "error": error, "median": error["median"]}
        measurement.tables["errors"].add(sensor=sensor, method=method, **row)
    measurement.tables["plates"].add(
        sensor=sensor,
        n=len(measured),
        found=rate([row is not None for row in measured]),
        hidden=estimate([row.hidden for row in rows], clusters),
        seen=np.median([row.seen for row in rows]),
    )
    seconds = estimate([row.seconds for row in rows])
    measurement.tables["seconds"].add(sensor=sensor, n=len(rows), seconds=seconds, median=seconds["median"])


def _measured(
    dataset: Dataset, scene: RecordedScene, sensor: str, completer: ReliefCompleter, restorer: Restorer
) -> Iterator[Measured | None]:
    """Each plate of a scene; None where it is not found or hardly a cell of it is hidden."""
    image = restorer(calibrated_image(scene.labelled_depth(sensor), sensor), sensor, (ASSEMBLY_LABEL,))
    kits = ObservedKits(image, noise_of(sensor, restored=True), scene.id, completer=completer)
    body = scene.scene.bodies[0]
    assembly, world_from_assembly = dataset.geometry.assembly(body.id), body.world_from_body
    for mount in assembly.mounts:
        world_from_kit = world_from_assembly @ mount.assembly_from_kit
        start = time.process_time()
        relief = kits.relief(world_from_kit.xyz) if kits.plates else None
        seconds = time.process_time() - start
        if relief is None or not _is_face(relief.shown.world_from_plate, world_from_kit):
            yield None
            continue
        plate = on_plate(relief.shown.world_from_plate.inverse() @ world_from_kit, mount.kit.extent)
        truth = true_depths(assembly.mesh, world_from_assembly, relief.shown.world_from_plate)
        hidden = plate & ~relief.shown.seen
        if hidden.sum() < HIDDEN_CELLS:
            yield None
            continue
        found = relief.shown.least.clip(0), filled_by_columns(image, relief.shown).depths, relief.depths
        errors = tuple(float(np.abs(depths - truth)[hidden].mean()) for depths in found)
        seen = float(np.median(np.abs(relief.depths - truth)[plate & relief.shown.seen]))
        yield Measured(body.id, errors, seen, float(hidden.sum() / plate.sum()), seconds)


def _is_face(world_from_plate: Pose, world_from_kit: Pose) -> bool:
    """Whether a plate that was found is that of a kit."""
    kit_from_plate = world_from_kit.inverse() @ world_from_plate
    cosine = kit_from_plate.rotate((0.0, 0.0, 1.0))[2]
    return bool(cosine > np.cos(FOUND_ANGLE) and length(kit_from_plate.xyz) < FOUND_DISTANCE)


if __name__ == "__main__":
    try:
        main(tyro.cli(KitRelief))
    except Kit1000Error as error:
        raise SystemExit(f"kit_relief: {error}") from error
