"""The picture of restored depth: a good, a median and a bad kit of the split test, by the error beside its edges.

    python docs/pictures/restoration.py data/kit1000

The slot of a scene's drawn target in the image of the d415; the darker, the deeper below the face of its plate. From
left to right: calibrated by the table, restored by rules, restored by the network, the true depth.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from kit_completion import joined
from PIL import Image

from baselines.training.tasks.restoration import FACTS, SENSOR, beside_jumps, box_about, example_of
from kit1000.dataset.reader import Dataset, RecordedScene, Split
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.restoration.rules import calibrated_image, closed_gaps, restored_edges
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, View
from kit1000.weights import WEIGHTS

OUT = Path(__file__).with_name("restoration.png")
SCENES, CASES = 30, (0.1, 0.5, 0.9)  # of which slots are drawn, and the quantiles of their error that are shown
ZOOM = 2
HIGHEST, LOWEST = 4e-3, -22e-3  # [m] above the plate's face: white, and black

Case = tuple[float, str, list[np.ndarray]]


def main(data: Path) -> None:
    """Draw the picture."""
    split, restorer = Dataset(data).split("test", truth=True), Restorer(WEIGHTS / "restoration")
    chosen = split.scene_ids[:: max(len(split.scene_ids) // SCENES, 1)][:SCENES]
    found = sorted((_case(split, split.scene(scene_id), restorer) for scene_id in chosen), key=lambda case: case[0])
    shown = [found[min(int(share * len(found)), len(found) - 1)] for share in CASES]
    for error, name, _ in shown:
        print(f"{name}: {error:.2f} mm")
    levels = np.rint(255 * joined([joined(row, axis=1) for _, _, row in shown], axis=0)).astype(np.uint8)
    picture = Image.fromarray(levels)
    picture.resize((ZOOM * picture.width, ZOOM * picture.height), Image.Resampling.NEAREST).save(OUT, optimize=True)


def _case(split: Split, scene: RecordedScene, restorer: Restorer) -> Case:
    """The error of the network beside edges [mm], the scene, and the four pictures."""
    image = calibrated_image(scene.labelled_depth(SENSOR), FACTS)
    exact = scene.labelled_depth("ideal").view
    target = next(query for query in scene.queries if query.drawn)
    world_from_kit = scene.truth_of(target.id).world_from_kit
    camera = exact.camera
    column, row = (
        np.rint(camera.project(exact.world_from_camera.inverse().apply(world_from_kit.xyz))).astype(int).tolist()
    )
    box = box_about(row, column)
    network = restorer(image, FACTS, [ASSEMBLY_LABEL]).view
    beside = beside_jumps(torch.from_numpy(example_of(image, exact.depth)["truth"])[None])[0].numpy()[box]
    kits = (image.labels == ASSEMBLY_LABEL)[box]
    wrong = 1e3 * np.abs(network.depth - exact.depth)[box][beside & kits]
    views = [closed_gaps(image).view, restored_edges(image, FACTS).view, network, exact]
    pictures = [np.where(kits, _grey(view, world_from_kit)[box], 1.0) for view in views]
    return float(wrong.mean()) if len(wrong) else 0.0, scene.id, pictures


def _grey(view: View, world_from_kit: Pose) -> np.ndarray:
    """(H, W) brightness of a view's pixels by their height over the face of a plate."""
    points = view.world_from_camera.apply(view.camera.unproject(view.depth))
    heights = world_from_kit.inverse().apply(points)[..., 2]
    return np.clip((heights - LOWEST) / (HIGHEST - LOWEST), 0, 1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
