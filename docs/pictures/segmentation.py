"""The picture of masks from noisy depth: scenes of the split test by the mean IoU of their parts.

    python docs/pictures/segmentation.py data/kit1000

From left to right: heights as restored, where each pixel says the middle of its part is, the parts by rules, by the
network, and the true ones. A pixel's colour says how far to the right (red) and down (blue) its vote is.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from kit_completion import joined
from PIL import Image

from baselines.training.tasks.restoration import FACTS, SENSOR
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.metrics.segmentation import matched_masks
from kit1000.perception.segmentation.instances import find_bodies, segmented
from kit1000.perception.segmentation.part_finder import inputs_of
from kit1000.perception.segmentation.predicted_masks import mask_networks
from kit1000.values import FIRST_PART_LABEL

OUT = Path(__file__).with_name("segmentation.png")
SCENES, CASES = 40, (0.9, 0.5, 0.1)  # of which images are segmented, and the quantiles of their IoU that are shown
SIZE = (208, 304)  # [px] rows and columns about the parts, multiples of 16
HIGHEST = 60.0  # [px] of height that is white
FARTHEST = 40.0  # [px] of a vote that has full colour
COLOURS = np.array(
    [
        [0.1, 0.1, 0.12],
        [0.9, 0.5, 0.2],
        [0.3, 0.6, 0.9],
        [0.5, 0.8, 0.3],
        [0.8, 0.4, 0.7],
        [0.95, 0.85, 0.3],
        [0.4, 0.8, 0.8],
    ]
)

Case = tuple[float, str, list[np.ndarray]]


def main(data: Path) -> None:
    """Draw the picture."""
    split = Dataset(data).split("test")
    chosen = split.scene_ids[:: max(len(split.scene_ids) // SCENES, 1)][:SCENES]
    found = sorted((_case(split.scene(scene_id)) for scene_id in chosen), key=lambda case: case[0])
    shown = [found[min(int(share * len(found)), len(found) - 1)] for share in CASES]
    for iou, name, _ in shown:
        print(f"{name}: {100 * iou:.1f} %")
    levels = np.rint(255 * joined([joined(row, axis=1) for *_, row in shown], axis=0)).astype(np.uint8)
    Image.fromarray(levels).save(OUT, optimize=True)


def _case(scene: RecordedScene) -> Case:
    """The mean IoU of the parts of a scene, its id, and the pictures."""
    image, (restorer, finder) = scene.labelled_depth(SENSOR), mask_networks()
    rules, network = (segmented(image.view, FACTS, 1.0, restorer, each) for each in (None, finder))
    bodies = find_bodies(image.view, FACTS, restorer)
    rows, columns = np.nonzero(image.labels >= FIRST_PART_LABEL)
    tall, broad = (
        slice(start, start + size)
        for at, size, most in zip((rows, columns), SIZE, image.labels.shape, strict=True)
        for start in [int(np.clip((at.min() + at.max() - size) // 2, 0, most - size))]
    )
    box = tall, broad
    heights = np.clip(inputs_of(bodies)["restored"][box] / HIGHEST, 0, 1)
    offset, logits = finder.votes(bodies, box)
    vote = np.stack([offset[0], np.zeros_like(offset[0]), offset[1]], axis=-1) / FARTHEST
    pictures = [
        np.repeat(heights[..., None], 3, axis=-1),
        np.where(logits[..., None] > 0, np.clip(0.5 + vote / 2, 0, 1), COLOURS[0]),
        *(_coloured(labels, image.labels)[box] for labels in (rules, network, image.labels)),
    ]
    return float(matched_masks(network, image.labels).iou[1:].mean()), scene.id, pictures


def _coloured(labels: np.ndarray, true: np.ndarray) -> np.ndarray:
    """(H, W, 3) the parts of masks in the colours of those they match; what matches none is white."""
    colours = np.ones((256, 3))
    colours[:FIRST_PART_LABEL] = COLOURS[0]
    for number, match in enumerate(matched_masks(labels, true).match[1:]):
        if match >= 0:
            colours[np.unique(labels[labels > 0])[match]] = COLOURS[1 + number % (len(COLOURS) - 1)]
    return colours[labels]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
