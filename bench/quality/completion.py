"""Quality of completed shapes from one image: parts by columns and by the network, kits by columns.

    python bench/quality/completion.py parts data/kit1000 --split test
    python bench/quality/completion.py kits data/kit1000 --split test

The tables hold the IoU of the occupied voxels and the Chamfer distance of the surfaces, in all space, in hidden and in
seen space, and the seconds of the network on one core. Parts have voxels of 1 mm, kits of 2 mm. A kit is compared
within its plate and up to ABOVE it; the true kit with its cavity filled shows what a score is worth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
import tyro
from scipy.spatial import KDTree

from bench.measured import add_components, measured_dataset, run, spread, timed
from benchmark.measurements import Column, Measurement, estimate
from kit1000.dataset.reader import Dataset
from kit1000.metrics.volumes import occupancy_iou, surface_chamfer
from kit1000.perception.completion.parts import CompletedPart, PartCompleter
from kit1000.perception.observed.kits import ObservedKits
from kit1000.perception.observed.parts import ObservedPart
from kit1000.perception.restoration import calibrated_image, restored
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.registration import METHODS
from kit1000.values import FIRST_PART_LABEL, Query, Truth
from kit1000.voxels import Volume, signed_distance, surface_points
from kit1000.voxels.grid import DEFAULT_TRUNCATION

WEIGHTS = METHODS["registration-completed"].weights
SHIPPED = {"ideal": WEIGHTS["completion"], "d415": WEIGHTS["noisy_completion"]}
PART_VOXEL, KIT_VOXEL = 1e-3, 2e-3  # [m]
ABOVE = 10e-3  # [m] above the plate of a kit, where space is free
SENSOR, N = Column("sensor", "sensor"), Column("n", "n")
SECONDS = (SENSOR, N, Column("seconds", "mean, s", 3), Column("median", "median", 3))


@dataclass(frozen=True)
class Completion:
    """Measure the completion of parts or of kits."""

    what: tyro.conf.Positional[Literal["parts", "kits"]]
    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    split: str = "test"
    sensor: Literal["ideal", "d415"] | None = None
    """One sensor; both when absent."""
    parts: int = 200
    """Most parts or kits, spread evenly over the split; one of each scene."""
    components: Path | None = None
    """JSON file for Table II, to which the means are added."""
    out: Path | None = None
    """JSON file of the tables, such as results/completion.json."""


class Space(NamedTuple):
    """Scores of a completed volume in a space."""

    iou: float
    """IoU of the occupied voxels."""
    chamfer: float
    """Chamfer distance of the surfaces [m]."""


class Scores(NamedTuple):
    """Scores of a completed volume in all space, and in what the image does not show and shows."""

    all: Space
    hidden: Space
    seen: Space


class Measured(NamedTuple):
    """A completed part or kit."""

    truth: Truth
    scores: dict[str, Scores]
    """Scores by method."""
    seconds: float = 0.0
    """Processor time of the network [s]."""


def main(options: Completion) -> None:
    """Print the scores of each sensor, and for parts the seconds of the network."""
    torch.set_num_threads(1)
    kits = options.what == "kits"
    with measured_dataset(options.data) as (dataset, _):
        measurement = Measurement.begin(dataset)
        voxel = KIT_VOXEL if kits else PART_VOXEL
        title = f"Completed {options.what}, voxels of {1e3 * voxel:g} mm, scenes of {options.split}"
        table = measurement.table("scores", title, SENSOR, Column("method", "method"), N, *score_columns())
        if not kits:
            measurement.table("seconds", "CPU seconds of the network a part", *SECONDS)
        for sensor in (options.sensor,) if options.sensor else ("ideal", "d415"):
            measure = _kit if kits else _part_by(PartCompleter(SHIPPED[sensor]))
            found = [measure(dataset, query, truth) for query, truth in _drawn(dataset, options, sensor)]
            if not found:
                continue
            clusters = [row.truth.assembly_id for row in found]
            methods = {method: [row.scores[method] for row in found] for method in found[0].scores}
            for method, scores in methods.items():
                table.add(sensor=sensor, method=method, n=len(found), **score_estimates(scores, clusters))
            if options.components is not None:
                component = f"{options.what[:-1]} completion, {sensor}"
                add_components(options.components, component, component_measures(methods), clusters)
            if not kits:
                seconds = estimate([row.seconds for row in found])
                row = {"seconds": seconds, "median": seconds["median"]}
                measurement.tables["seconds"].add(sensor=sensor, n=len(found), **row)
        measurement.report(options.out)


def _drawn(dataset: Dataset, options: Completion, sensor: str) -> Iterator[tuple[Query, Truth]]:
    """The first sampled query of each scene, with its truth."""
    scenes = dataset.split(options.split, truth=True)
    for scene in map(scenes.scene, spread(scenes.scene_ids, options.parts)):
        query = next((query for query in scene.queries if query.drawn and query.sensor == sensor), None)
        if query is not None:
            yield query, scene.truth_of(query.id)


def _part_by(completer: PartCompleter) -> Callable[[Dataset, Query, Truth], Measured]:
    """A function that completes the part of a query by columns and by a network."""

    def measured(dataset: Dataset, query: Query, truth: Truth) -> Measured:
        image = calibrated_image(query.image, simulated_sensor(query.sensor))
        observed = ObservedPart(image, FIRST_PART_LABEL + query.part, query.pivot)
        completed = CompletedPart(observed, completer, None if query.sensor == "ideal" else image)
        seconds, _ = timed(lambda: completed.logits, process_time)
        mesh = dataset.geometry.part(truth.part_id).mesh
        columns, network = observed.volume(PART_VOXEL), completed.volume(PART_VOXEL)
        exact = signed_distance(columns.grid, [(mesh, truth.world_from_part)], threads=1)
        hidden = np.isnan(observed.columns(PART_VOXEL).distance[::2, ::2])
        volumes = {"columns": columns, "network": network}
        scores = {name: completion_scores(volume, exact, hidden) for name, volume in volumes.items()}
        return Measured(truth, scores, seconds)

    return measured


def _kit(dataset: Dataset, query: Query, truth: Truth) -> Measured:
    """The kit of a query completed by columns along the normal of its plate, and the true kit without its cavity."""
    extent = dataset.geometry.kit(truth.part_id).extent
    half_width = float(extent[:2].max() / 2)
    facts = simulated_sensor(query.sensor)
    kits = ObservedKits(restored(query.image, facts), facts.kind.noise, query.scene_id, half_width)
    columns = kits.columns(truth.world_from_kit.apply(np.array([0, 0, -extent[2] / 2])), KIT_VOXEL)
    filled, hidden = columns.filled(largest_only=False), np.isnan(columns.distance[::2, ::2])
    true = dataset.geometry.true_geometry(truth)
    exact = signed_distance(filled.grid, [(true.assembly, true.world_from_assembly)], threads=1)
    kit = truth.world_from_kit.inverse().apply(filled.grid.centres())
    sides = np.abs(kit[..., :2]) - extent[:2] / 2
    plate = np.max([*np.moveaxis(sides, -1, 0), kit[..., 2], -extent[2] - kit[..., 2]], axis=0)
    solid = np.minimum(exact.values, (plate / (DEFAULT_TRUNCATION * KIT_VOXEL)).clip(-1, 1))
    within = (sides < 0).all(-1) & (kit[..., 2] > -extent[2]) & (kit[..., 2] < ABOVE)
    filled, exact, solid = (
        Volume.adopt(exact.grid, np.where(within, values, np.nan).astype(np.float32))
        for values in (filled.values, exact.values, solid)
    )
    volumes = {"columns": filled, "without cavity": solid}
    return Measured(truth, {name: completion_scores(volume, exact, hidden) for name, volume in volumes.items()})


def score_columns() -> list[Column]:
    """Columns of a table for IoU and Chamfer distance in each space, and for their medians in all space."""
    spaces = {name: "" if name == "all" else f", {name}" for name in Scores._fields}
    iou = [Column(f"iou_{name}", f"IoU{where}", 3) for name, where in spaces.items()]
    chamfer = [Column(f"chamfer_{name}", f"Chamfer{where}, mm", 2) for name, where in spaces.items()]
    return [*iou, Column("iou_median", "IoU, median", 3), *chamfer, Column("chamfer_median", "Chamfer, median", 2)]


def score_estimates(scores: Sequence[Scores], clusters: Sequence[str]) -> dict[str, Any]:
    """Values for `score_columns` over n scores. clusters: n labels, as in `benchmark.measurements.estimate`."""
    values: dict[str, Any] = {}
    for name in Scores._fields:
        spaces: list[Space] = [getattr(one, name) for one in scores]
        values[f"iou_{name}"] = estimate([space.iou for space in spaces], clusters)
        values[f"chamfer_{name}"] = estimate([1e3 * space.chamfer for space in spaces], clusters)
    return values | {f"{key}_median": values[f"{key}_all"]["median"] for key in ("iou", "chamfer")}


def component_measures(methods: Mapping[str, Sequence[Scores]]) -> dict[str, list[float]]:
    """The scores of methods as measures of a component, see `add_components`."""
    measures: dict[str, list[float]] = {}
    for method, scores in methods.items():
        for name in Scores._fields:
            spaces = [getattr(one, name) for one in scores]
            where = "" if name == "all" else f" in {name} space"
            measures[f"{method}: IoU{where}"] = [space.iou for space in spaces]
            measures[f"{method}: surface Chamfer distance{where}, mm"] = [1e3 * space.chamfer for space in spaces]
    return measures


def completion_scores(completed: Volume, exact: Volume, hidden: np.ndarray) -> Scores:
    """Compare two volumes on one grid. hidden: (nx, ny, nz) bool, the voxels that the image does not show."""
    surfaces = surface_points(completed), surface_points(exact)
    nearest = [np.rint(exact.grid.indices(points)).astype(int).T for points in surfaces]
    spaces = [
        Space(
            occupancy_iou(*(np.where(space, one.values, np.float32(np.nan)) for one in (completed, exact))),
            _chamfer_within(surfaces, [space[tuple(cells)] for cells in nearest]),
        )
        for space in (hidden, ~hidden)
    ]
    return Scores(Space(occupancy_iou(completed, exact), surface_chamfer(completed, exact)), *spaces)


def _chamfer_within(surfaces: tuple[np.ndarray, np.ndarray], within: list[np.ndarray]) -> float:
    """The mean distance from the points of each surface within a space to the whole other surface [m].

    A direction without points in the space does not count. The result is 0 if no direction has points, and infinite if
    one of the surfaces is missing.
    """
    if not all(map(len, surfaces)):
        return 0.0 if not any(map(len, surfaces)) else float("inf")
    means = [
        KDTree(surfaces[to]).query(surfaces[start][within[start]])[0].mean()
        for start, to in ((0, 1), (1, 0))
        if within[start].any()
    ]
    return float(np.mean(means)) if means else 0.0


if __name__ == "__main__":
    run(main, Completion, __doc__)
