"""How well kits are completed from one image, about the slot of a part: columns along the normal of its plate.

    python bench/quality/kit_completion.py data/kit1000 --split test --sensor d415

IoU of the occupied voxels of 2 mm and surface Chamfer distance, of all space, of hidden and of seen space, within the
plate and ABOVE it. Beside it a kit without cavity, the true one with its cavity filled, which shows what a number is
worth. The image of the d415 is calibrated and its edges are restored.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tyro

from bench.quality.completion_scores import Scores, completion_scores, component_measures
from bench.quality.components import add_components
from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error
from kit1000.perception.observed.kits import ObservedKits
from kit1000.perception.observed.pixels import noise_of
from kit1000.perception.restoration import restored
from kit1000.values import Query, Truth
from kit1000.voxels import Volume, signed_distance
from kit1000.voxels.grid import DEFAULT_TRUNCATION

VOXEL = 2e-3  # [m]
ABOVE = 10e-3  # [m] the plate: there is free space to be found too
METHODS = ("columns", "without cavity")


def main(
    data: tyro.conf.Positional[Path],
    split: str = "test",
    sensor: str = "d415",
    parts: int = 200,
    components: Path | None = None,
) -> None:
    """Print the means over the kits of drawn queries.

    Args:
        data: dataset folder.
        split: of its scenes.
        sensor: ideal or d415.
        parts: most kits, those of the first scenes; one of each.
        components: JSON file for Table II, to which the means are added.
    """
    dataset = Dataset(data)
    rows, assemblies = [], []
    for query, truth in _drawn(dataset, split, sensor, parts):
        rows.append(_measure(dataset, query, truth))
        assemblies.append(truth.assembly_id)
    for method, scores in zip(METHODS, zip(*rows, strict=True), strict=True):
        iou, chamfer = np.array(scores).mean(0).T
        words = [*(f"{share:.3f}" for share in iou), *(f"{1e3 * distance:.2f}" for distance in chamfer)]
        print(f"{method:14} n {len(rows)}: IoU / hidden / seen, Chamfer mm / hidden / seen: {' / '.join(words)}")
    if components is not None:
        methods = {method: [row[i] for row in rows] for i, method in enumerate(METHODS)}
        add_components(components, f"kit completion, {sensor}", component_measures(methods), assemblies)


def _drawn(dataset: Dataset, split: str, sensor: str, most: int) -> Iterator[tuple[Query, Truth]]:
    """The first drawn query of each of the first scenes, with its truth."""
    scenes = dataset.split(split, truth=True)
    for scene_id in scenes.scene_ids[:most]:
        scene = scenes.scene(scene_id)
        query = next((query for query in scene.queries if query.drawn and query.sensor == sensor), None)
        if query is not None:
            yield query, scene.truth_of(query.id)


def _measure(dataset: Dataset, query: Query, truth: Truth) -> tuple[Scores, Scores]:
    """Of the columns, and of the true kit without its cavity."""
    extent = dataset.geometry.kit(truth.part_id).extent
    half_width = float(extent[:2].max() / 2)
    kits = ObservedKits(restored(query.image, query.sensor), noise_of(query.sensor), query.scene_id, half_width)
    columns = kits.columns(truth.world_from_kit.apply(np.array([0, 0, -extent[2] / 2])), VOXEL)
    filled, hidden = columns.filled(largest_only=False), np.isnan(columns.distance[::2, ::2])
    true = dataset.geometry.true_geometry(truth)
    exact = signed_distance(filled.grid, [(true.assembly, true.world_from_assembly)], threads=1)
    kit = truth.world_from_kit.inverse().apply(filled.grid.centres())
    sides = np.abs(kit[..., :2]) - extent[:2] / 2
    plate = np.max([*np.moveaxis(sides, -1, 0), kit[..., 2], -extent[2] - kit[..., 2]], axis=0)
    solid = np.minimum(exact.values, (plate / (DEFAULT_TRUNCATION * VOXEL)).clip(-1, 1))
    within = (sides < 0).all(-1) & (kit[..., 2] > -extent[2]) & (kit[..., 2] < ABOVE)
    filled, exact, solid = (
        Volume.adopt(exact.grid, np.where(within, values, np.nan).astype(np.float32))
        for values in (filled.values, exact.values, solid)
    )
    return completion_scores(filled, exact, hidden), completion_scores(solid, exact, hidden)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except Kit1000Error as error:
        raise SystemExit(f"kit_completion: {error}") from error
