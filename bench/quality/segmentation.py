"""Mean IoU of the instance masks that `kit1000.perception.segmentation` finds, over the scenes of a split.

python bench/quality/segmentation.py data/kit1000 --split test --sensor ideal
"""

from __future__ import annotations

from pathlib import Path
from time import process_time
from typing import Literal

import numpy as np
import tyro

from bench.quality.components import add_components
from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error
from kit1000.metrics.segmentation import matched_masks
from kit1000.perception.segmentation.instances import segmented
from kit1000.perception.segmentation.predicted_masks import mask_networks


def main(
    data: tyro.conf.Positional[Path],
    split: str = "test",
    sensor: str = "ideal",
    limit: int | None = None,
    networks: Literal["both", "restoration", "none"] = "both",
    components: Path | None = None,
) -> None:
    """Segment the scenes, then print a line for all, for those whose parts lie apart and for crowded ones.

    Args:
        data: dataset folder.
        split: of its scenes.
        sensor: ideal or d415.
        limit: only the first so many scenes.
        networks: for noisy images: one restores them and another one tells parts apart, the first alone, or none.
        components: JSON file for Table II, to which the mean is added.
    """
    dataset = Dataset(data)
    assemblies = []
    scenes, scale = dataset.split(split, truth=True), dataset.summary["config"]["scale"]
    rows: list[tuple[float, ...]] = []
    restorer, finder = (None, None) if networks == "none" or sensor == "ideal" else mask_networks()
    finder = finder if networks == "both" else None
    for scene_id in scenes.scene_ids[:limit]:
        scene = scenes.scene(scene_id)
        image = scene.labelled_depth(sensor)
        start = process_time()
        found = segmented(image.view, sensor, scale, restorer, finder)
        seconds = process_time() - start
        iou = matched_masks(found, image.labels).iou
        assemblies.append(scene.scene.bodies[0].id)
        crowded = any(truth.crowded for truth in scene.truths.values())
        rows.append((crowded, iou.mean(), iou[1:].mean(), iou[0], found.max() == image.labels.max(), seconds))
    table = np.array(rows, float)
    for name, chosen in (("all", table[:, 0] >= 0), ("apart", table[:, 0] == 0), ("crowded", table[:, 0] == 1)):
        mean, half = table[chosen].mean(0), 196 * table[chosen, 1].std() / np.sqrt(max(chosen.sum(), 1))
        print(
            f"{name:8s} n {chosen.sum():3d}: mean IoU {100 * mean[1]:.1f} +- {half:.1f} %, "
            f"parts {100 * mean[2]:.1f} %, kits {100 * mean[3]:.1f} %, number of parts right {100 * mean[4]:.0f} %, "
            f"{mean[5]:.2f} s (most {table[chosen, 5].max():.2f})"
        )
    if components is not None:
        method = "pieces of surfaces" if finder is None else "votes of pixels"
        measure = f"{method}: mean IoU of a scene"
        add_components(components, f"segmentation, {sensor}", {measure: table[:, 1].tolist()}, assemblies)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except Kit1000Error as error:
        raise SystemExit(f"segmentation: {error}") from error
