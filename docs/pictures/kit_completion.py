"""The picture of completed kits: a good, a median and a bad case of the split test, by the error of hidden cells.

    python docs/pictures/kit_completion.py data/kit1000

The relief of a plate from above, the camera to the left; the darker, the deeper. From left to right: what the image
shows (hidden cells white), filled columns, the network, the true plate.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.perception.completion.kits import KitCompleter, filled_by_columns
from kit1000.perception.image_kinds import IDEAL
from kit1000.perception.observed.kits import DEEPEST, ObservedKits, true_depths
from kit1000.weights import WEIGHTS

OUT = Path(__file__).with_name("kit-completion.png")
SCENES, CASES = 20, (0.1, 0.5, 0.95)  # whose first plates are drawn, and the quantiles of their error that are shown
ZOOM, GAP = 3, 6  # [px] of a cell and between pictures
LIGHTEST, PAPER = 0.9, 1.0  # of a plate's face, and of hidden cells

Row = list[np.ndarray]


def main(data: Path) -> None:
    """Draw the picture."""
    dataset, completer = Dataset(data), KitCompleter(WEIGHTS / "kit-completion")
    split = dataset.split("test", truth=True)
    chosen = split.scene_ids[:: max(len(split.scene_ids) // SCENES, 1)][:SCENES]
    found = [_case(dataset, completer, split.scene(scene_id)) for scene_id in chosen]
    found.sort(key=lambda case: case[0])
    shown = [found[min(int(share * len(found)), len(found) - 1)] for share in CASES]
    for error, name, _ in shown:
        print(f"{name}: {error:.2f} mm")
    levels = np.rint(255 * joined([joined(row, axis=1) for _, _, row in shown], axis=0)).astype(np.uint8)
    picture = Image.fromarray(levels)
    picture.resize((ZOOM * picture.width, ZOOM * picture.height), Image.Resampling.NEAREST).save(OUT, optimize=True)


def _case(dataset: Dataset, completer: KitCompleter, scene: RecordedScene) -> tuple[float, str, Row]:
    image, body = scene.labelled_depth("ideal"), scene.scene.bodies[0]
    kits = ObservedKits(image, IDEAL.noise, scene.id, completer=completer)
    relief = kits.height_map(kits.plates[0].point)
    assert relief is not None, "some plate is seen in every scene"
    truth = true_depths(dataset.geometry.assembly(body.id).mesh, body.world_from_body, relief.shown.world_from_plate)
    hidden = ~relief.shown.seen & (truth < DEEPEST)
    error = float(np.abs(relief.depths - truth)[hidden].mean()) if hidden.any() else 0.0
    shown = np.where(relief.shown.seen, _grey(relief.shown.least), PAPER)
    others = filled_by_columns(image, relief.shown).depths, relief.depths, truth
    return error, scene.id, [shown.T[::-1], *(_grey(depths).T[::-1] for depths in others)]


def _grey(depths: np.ndarray) -> np.ndarray:
    """Brightness of depths [mm]."""
    return LIGHTEST * (1 - np.clip(depths, 0, DEEPEST) / DEEPEST)


def joined(pictures: list[np.ndarray], axis: int) -> np.ndarray:
    """Pictures (h, w), or (h, w, 3), side by side (axis 1) or below each other, with gaps."""
    shape = list(pictures[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, PAPER)
    return np.concatenate([piece for picture in pictures for piece in (picture, gap)][:-1], axis=axis)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
