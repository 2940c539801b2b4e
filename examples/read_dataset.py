"""python examples/read_dataset.py tiny

Prints what a dataset holds: its splits, the first scene of the validation split, one query about that scene, and the
ground truth of the query. Takes 2 s; `kit1000 generate tiny --out tiny` makes the dataset.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro

from kit1000 import Dataset


def main(data: tyro.conf.Positional[Path] = Path("tiny")) -> None:
    """Read a dataset folder.

    Args:
        data: the dataset folder.
    """
    dataset = Dataset(data)
    print(f"dataset {dataset.id}")
    for name in ("train", "val", "test"):
        split = dataset.split(name)
        print(f"  {name:5}  {len(split):4} scenes, {len(list(split.queries('snap'))):4} queries of the track snap")

    val = dataset.split("val", truth=True)  # without truth=True no file of ground truth is opened
    scene = val.scene(val.scene_ids[0])
    query = next(query for query in scene.queries if query.track == "snap")
    depth = query.view.depth  # (H, W) float32 [m], 0 = no return
    points = query.view.camera.unproject(depth)[query.part_mask]  # (n, 3) [m] in the camera frame
    print(f"query {query.id}: depth image {depth.shape}, {len(points)} points of the part")
    assert query.guess is not None  # snap is a track with a guess
    print(f"  the guess moves the pivot {np.round(query.pivot, 3)} to {np.round(query.guess.apply(query.pivot), 3)}")

    truth = scene.truth_of(query.id)
    part = dataset.geometry.part(truth.part_id)
    error = truth.goal_drawn.inverse() @ query.guess
    print(f"  ground truth: a {part.family}, {truth.rest_mode}, {len(truth.slot.goals)} goals")
    print(f"  the guess is rotated by {np.degrees(error.angle()):.1f} degrees from its goal")


if __name__ == "__main__":
    tyro.cli(main)
