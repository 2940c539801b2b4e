"""How well parts are completed from one image: by columns, and by the network.

    python bench/quality/completion.py data/kit1000 --split test

IoU of the occupied voxels of 1 mm and surface Chamfer distance, of all space, of hidden and of seen space; of the
network also the expected calibration error (ECE) of its probabilities in hidden cells, and its seconds on one core. The
image of the d415 is calibrated by the table first.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
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
from benchmark.measurements import Column, Measurement, estimate
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import Kit1000Error
from kit1000.generation.presets import HELD_OUT
from kit1000.perception.completion.parts.completed import CompletedPart, PartCompleter
from kit1000.perception.completion.parts.frame import CODE
from kit1000.perception.observed.occupancy import filled_share
from kit1000.perception.observed.parts import ObservedPart
from kit1000.perception.restoration import calibrated_image
from kit1000.registration import METHODS
from kit1000.values import FIRST_PART_LABEL, Query, Truth
from kit1000.voxels import signed_distance

WEIGHTS = METHODS["registration-completed"].weights
SHIPPED = {"ideal": WEIGHTS["completion"], "d415": WEIGHTS["noisy_completion"]}
VOXEL = 1e-3  # [m]
BINS = 10  # of probability, for the calibration error
METHODS = ("columns", "network")
SENSOR, N = Column("sensor", "sensor"), Column("n", "n")
GROUP_COLUMNS = (
    SENSOR,
    Column("group", "parts"),
    N,
    Column("columns", "IoU, columns", 3),
    Column("network", "IoU, network", 3),
    Column("gain", "gain", 3),
    Column("median", "gain, median", 3),
    Column("ece", "ECE", 3),
)
SECONDS = (SENSOR, N, Column("seconds", "mean, s", 3), Column("median", "median", 3))


@dataclass(frozen=True)
class Completion:
    """Measure the completion of parts."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    split: str = "test"
    sensor: Literal["ideal", "d415"] | None = None
    """One sensor; both when absent."""
    weights: Path | None = None
    """Stem of the network's weights; those of the sensor when absent."""
    parts: int = 200
    """Most parts, spread evenly over the split; one of each scene."""
    csv: Path | None = None
    """File for one row per part."""
    components: Path | None = None
    """JSON file for Table II, to which the means are added."""
    out: Path | None = None
    """JSON file of the tables, such as results/completion.json."""


class Measured(NamedTuple):
    """A part, completed."""

    query: Query
    truth: Truth
    columns: Scores
    network: Scores
    seconds: float
    counts: np.ndarray
    """(3, BINS) by the probability of hidden cells: their number, the sums of probability and of filled share."""


GROUPS: dict[str, Callable[[Truth], bool]] = {
    "all": lambda truth: True,
    "upright": lambda truth: truth.rest_mode == "upright",
    "tumbled": lambda truth: truth.rest_mode == "tumbled",
    "crowded": lambda truth: truth.crowded,
    "known families": lambda truth: truth.family not in HELD_OUT,
    "held-out families": lambda truth: truth.family in HELD_OUT,
}


def main(options: Completion) -> None:
    """Print the scores of each sensor, and the IoU by groups of parts."""
    torch.set_num_threads(1)
    with measured_dataset(options.data) as (dataset, _):
        measurement = Measurement.begin(dataset)
        title = f"Completed parts, voxels of {1e3 * VOXEL:g} mm, scenes of {options.split}"
        measurement.table("scores", title, SENSOR, Column("method", "method"), N, *score_columns())
        measurement.table("groups", "IoU of all space by groups of parts", *GROUP_COLUMNS)
        measurement.table("seconds", "CPU seconds of the network a part", *SECONDS)
        for sensor in (options.sensor,) if options.sensor else ("ideal", "d415"):
            completer = PartCompleter(options.weights or SHIPPED[sensor])
            found = list(_measured(dataset, options, completer, sensor))
            if not found:
                continue
            _report(measurement, sensor, found)
            if options.csv is not None:
                _write(options.csv.with_stem(f"{options.csv.stem}-{sensor}"), found)
            if options.components is not None:
                _add(options.components, sensor, found)
        measurement.report(options.out)


def _report(measurement: Measurement, sensor: str, found: list[Measured]) -> None:
    """Add the rows of a sensor to the tables."""
    clusters = [row.truth.assembly_id for row in found]
    for method in METHODS:
        estimates = score_estimates([getattr(row, method) for row in found], clusters)
        measurement.tables["scores"].add(sensor=sensor, method=method, n=len(found), **estimates)
    for name, belongs in GROUPS.items():
        _add_group(measurement, sensor, name, [row for row in found if belongs(row.truth)])
    seconds = estimate([row.seconds for row in found])
    measurement.tables["seconds"].add(sensor=sensor, n=len(found), seconds=seconds, median=seconds["median"])


def _add_group(measurement: Measurement, sensor: str, group: str, rows: list[Measured]) -> None:
    if not rows:
        return
    columns, network = (np.array([getattr(row, method).all.iou for row in rows]) for method in METHODS)
    gain = estimate(network - columns, [row.truth.assembly_id for row in rows])
    shares = {"columns": columns.mean(), "network": network.mean(), "gain": gain, "median": gain["median"]}
    ece = calibration_error(np.sum([row.counts for row in rows], axis=0))
    measurement.tables["groups"].add(sensor=sensor, group=group, n=len(rows), ece=ece, **shares)


def _add(path: Path, sensor: str, rows: list[Measured]) -> None:
    methods = {method: [getattr(row, method) for row in rows] for method in METHODS}
    clusters = [row.truth.assembly_id for row in rows]
    add_components(path, f"part completion, {sensor}", component_measures(methods), clusters)


def _measured(dataset: Dataset, options: Completion, completer: PartCompleter, sensor: str) -> Iterator[Measured]:
    split = dataset.split(options.split, truth=True)
    ids = split.scene_ids
    chosen = [ids[i * len(ids) // min(options.parts, len(ids))] for i in range(min(options.parts, len(ids)))]
    for scene in map(split.scene, chosen):
        query = next((query for query in scene.queries if query.drawn and query.sensor == sensor), None)
        if query is not None:
            yield _measure(scene, query, completer, dataset)


def _measure(scene: RecordedScene, query: Query, completer: PartCompleter, dataset: Dataset) -> Measured:
    truth, image = scene.truth_of(query.id), calibrated_image(query.image, query.sensor)
    observed = ObservedPart(image, FIRST_PART_LABEL + query.part, query.pivot)
    start = time.process_time()
    completed = CompletedPart(observed, completer, None if query.sensor == "ideal" else image)
    logits = completed.logits
    seconds = time.process_time() - start
    mesh = dataset.geometry.part(truth.part_id).mesh
    columns, network = observed.volume(VOXEL), completed.volume(VOXEL)
    exact = signed_distance(columns.grid, [(mesh, truth.world_from_part)], threads=1)
    hidden = np.isnan(observed.columns(VOXEL).distance[::2, ::2])
    counts = np.zeros((3, BINS))
    if logits is not None and completed.framed is not None:
        cells = completed.framed.codes == -CODE
        share = filled_share(mesh, truth.world_from_part, logits.grid)
        counts = bin_counts(logits.probability[cells], share[cells])
    scores = [completion_scores(volume, exact, hidden) for volume in (columns, network)]
    return Measured(query, truth, scores[0], scores[1], seconds, counts)


def bin_counts(probability: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(3, BINS): by probability, the number of cells and the sums of their probabilities and filled shares (n,)."""
    bins = np.minimum((probability * BINS).astype(int), BINS - 1)
    return np.stack([np.bincount(bins, weights, BINS) for weights in (np.ones(len(bins)), probability, share)])


def calibration_error(counts: np.ndarray) -> float:
    """The expected calibration error of (3, BINS) counts: the mean distance of probability and filled share."""
    return float(np.abs(counts[1] - counts[2]).sum() / max(counts[0].sum(), 1))


def _write(path: Path, rows: list[Measured]) -> None:
    lines = ["query,family,rest_mode,crowded,columns_iou,network_iou,columns_mm,network_mm"]
    for row in rows:
        spaces = row.columns.all, row.network.all
        numbers = [*(space.iou for space in spaces), *(1e3 * space.chamfer for space in spaces)]
        names = [row.query.id, row.truth.family, row.truth.rest_mode, str(int(row.truth.crowded))]
        lines.append(",".join([*names, *(f"{number:.4f}" for number in numbers)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    try:
        main(tyro.cli(Completion))
    except Kit1000Error as error:
        raise SystemExit(f"completion: {error}") from error
