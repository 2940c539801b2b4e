"""How well a volume is completed: in all space, in the space that the image does not show, and in that it shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from benchmark.measurements import Column, estimate
from kit1000.metrics.volumes import occupancy_iou, surface_chamfer
from kit1000.voxels import Volume, surface_points


class Space(NamedTuple):
    """IoU of the occupied voxels of a space, and the Chamfer distance of the surfaces in it."""

    iou: float
    chamfer: float
    """[m]"""


class Scores(NamedTuple):
    """Of a completed volume against the true one."""

    all: Space
    hidden: Space
    """What the image does not show: behind what it shows, farther than the truncation."""
    seen: Space


def score_columns() -> list[Column]:
    """Columns of a table for IoU and Chamfer distance in each space, and for their medians in all space."""
    spaces = {name: "" if name == "all" else f", {name}" for name in Scores._fields}
    iou = [Column(f"iou_{name}", f"IoU{where}", 3) for name, where in spaces.items()]
    chamfer = [Column(f"chamfer_{name}", f"Chamfer{where}, mm", 2) for name, where in spaces.items()]
    return [*iou, Column("iou_median", "IoU, median", 3), *chamfer, Column("chamfer_median", "Chamfer, median", 2)]


def score_estimates(scores: Sequence[Scores], clusters: Sequence[str]) -> dict[str, Any]:
    """The values of `score_columns` over n scores. clusters: n labels, as in `benchmark.measurements.estimate`."""
    values: dict[str, Any] = {}
    for name in Scores._fields:
        spaces: list[Space] = [getattr(one, name) for one in scores]
        values[f"iou_{name}"] = estimate([space.iou for space in spaces], clusters)
        values[f"chamfer_{name}"] = estimate([1e3 * space.chamfer for space in spaces], clusters)
    return values | {f"{key}_median": values[f"{key}_all"]["median"] for key in ("iou", "chamfer")}


def component_measures(methods: Mapping[str, Sequence[Scores]]) -> dict[str, list[float]]:
    """The scores of methods as measures of a component, see `components.add_components`."""
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
    spaces = [
        Space(
            occupancy_iou(*(np.where(space, one.values, np.float32(np.nan)) for one in (completed, exact))),
            _chamfer_within(surfaces, [space[_voxels(exact, points)] for points in surfaces]),
        )
        for space in (hidden, ~hidden)
    ]
    return Scores(Space(occupancy_iou(completed, exact), surface_chamfer(completed, exact)), *spaces)


def _voxels(volume: Volume, points: np.ndarray) -> tuple[np.ndarray, ...]:
    """The indices of the voxels nearest to points (n, 3) [m] on the surfaces in a volume."""
    return tuple(np.rint(volume.grid.indices(points)).astype(int).T)


def _chamfer_within(surfaces: tuple[np.ndarray, np.ndarray], within: list[np.ndarray]) -> float:
    """[m] The mean of both directions, each over the points of one surface within a space to the whole other one.

    A direction without points there does not count; 0 without any, infinite where one whole surface is missing.
    """
    if not all(map(len, surfaces)):
        return 0.0 if not any(map(len, surfaces)) else float("inf")
    ways = ((0, 1), (1, 0))
    means = [
        KDTree(surfaces[to]).query(surfaces[start][within[start]])[0].mean()
        for start, to in ways
        if within[start].any()
    ]
    return float(np.mean(means)) if means else 0.0
