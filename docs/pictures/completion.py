"""The picture of completed parts: a good, a median and a bad case of the split test, by IoU.

    python docs/pictures/completion.py data/kit1000

Each case is cut vertically along the view, the camera to the left, and horizontally at half its height. From left to
right: what the image shows (white free, black a surface, grey unknown), filled columns, the network's probability, the
true part.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from kit1000.dataset.reader import Dataset
from kit1000.perception.completion.parts import CODE, SHAPE, FramedPart, PartCompleter, framed
from kit1000.perception.observed.occupancy import filled_share
from kit1000.perception.observed.parts import ObservedPart
from kit1000.values import FIRST_PART_LABEL, Query, Truth
from kit1000.voxels import resample
from kit1000.weights import WEIGHTS

OUT = Path(__file__).with_suffix(".png")
PARTS, CASES = 60, (0.9, 0.5, 0.05)  # drawn targets, and the quantiles of their IoU that are shown
ZOOM, GAP = 4, 6  # [px] of a cell and between pictures
SURFACE = 0.2  # of a truncation: half the thickness at which a surface is drawn

Row = list[np.ndarray]


def main(data: Path) -> None:
    """Draw the picture."""
    dataset, completer = Dataset(data), PartCompleter(WEIGHTS / "completion")
    split = dataset.split("test", truth=True)
    found: list[tuple[float, str, Row]] = []
    for scene_id in split.scene_ids[:: max(len(split.scene_ids) // PARTS, 1)][:PARTS]:
        scene = split.scene(scene_id)
        query = next((query for query in scene.queries if query.drawn and query.sensor == "ideal"), None)
        if query is not None:
            found.append(_case(dataset, completer, query, scene.truth_of(query.id)))
    found.sort(key=lambda case: case[0])
    chosen = [found[min(int(share * len(found)), len(found) - 1)] for share in CASES]
    for iou, name, _ in chosen:
        print(f"{name}: IoU {iou:.3f}")
    levels = np.rint(255 * _joined([_joined(row, axis=1) for _, _, row in chosen], axis=0)).astype(np.uint8)
    picture = Image.fromarray(levels)
    picture.resize((ZOOM * picture.width, ZOOM * picture.height), Image.Resampling.NEAREST).save(OUT, optimize=True)


def _case(dataset: Dataset, completer: PartCompleter, query: Query, truth: Truth) -> tuple[float, str, Row]:
    label = FIRST_PART_LABEL + query.part
    part = framed(query.image, label)
    assert part is not None, "queries are about visible parts"
    probability = completer(part).probability
    share = filled_share(dataset.geometry.part(truth.part_id).mesh, truth.world_from_part, part.grid)
    iou = ((probability > 0.5) & (share > 0.5)).sum() / ((probability > 0.5) | (share > 0.5)).sum()
    columns = resample(ObservedPart(query.image, label, query.pivot).volume(1e-3), part.grid, threads=1)
    solids = [(columns.filled(1) < 0).astype(float), probability, share]
    height = int(np.flatnonzero(share.max((0, 1)) > 0.5).mean())
    row = [_slices(_shown(part), height), *(_slices(1 - solid, height) for solid in solids)]
    return float(iou), f"{query.id} ({truth.family})", row


def _shown(part: FramedPart) -> np.ndarray:
    """SHAPE brightness of what the image shows."""
    unknown, near = part.codes <= -CODE, np.abs(part.codes) < SURFACE * CODE
    return np.where(near, 0.0, np.where(unknown, 0.6, np.where(part.codes > 0, 1.0, 0.3)))


def _slices(brightness: np.ndarray, height: int) -> np.ndarray:
    """(h, w) of the vertical slice above the horizontal one."""
    upright, level = brightness[:, SHAPE[1] // 2].T[::-1], brightness[:, :, height].T
    return np.concatenate([upright, np.full((2, SHAPE[0]), 0.8), level])


def _joined(pictures: list[np.ndarray], axis: int) -> np.ndarray:
    """Pictures (h, w) side by side (axis 1) or below each other, with gaps."""
    gap = np.full((pictures[0].shape[0], GAP) if axis else (GAP, pictures[0].shape[1]), 0.8)
    return np.concatenate([piece for picture in pictures for piece in (picture, gap)][:-1], axis=axis)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
