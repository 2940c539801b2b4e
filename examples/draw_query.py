"""python examples/draw_query.py tiny --out query.png

Draws one query into a PNG: heights over the table in grey, the part in orange, the part moved by the user's initial
guess in blue and by the ground truth in green. Takes 2 s.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro
from PIL import Image

from kit1000 import Dataset, Pose, Query

ORANGE, BLUE, GREEN = (232, 114, 42), (60, 120, 200), (40, 160, 80)


def pixels_after(query: Query, points: np.ndarray, motion: Pose) -> np.ndarray:
    """(m, 2) int: column and row of points (n, 3) [m] in the world after a motion, as far as they are in the image."""
    view = query.view
    moved = view.world_from_camera.inverse().apply(motion.apply(points))
    uv = np.rint(view.camera.project(moved)).astype(int)
    inside = ((uv >= 0) & (uv < (view.camera.width, view.camera.height))).all(axis=1)
    return uv[inside]


def main(data: tyro.conf.Positional[Path] = Path("tiny"), out: Path = Path("query.png"), track: str = "snap") -> None:
    """Draw the first validation query of a track.

    Args:
        data: the dataset folder.
        out: the picture to write.
        track: a track with a guess.
    """
    dataset = Dataset(data)
    query = next(dataset.split("val").queries(track))
    view = query.view
    points = view.world_from_camera.apply(view.camera.unproject(view.depth))  # (H, W, 3) [m] in the world
    grey = np.where(view.depth > 0, 60 + 1500 * np.clip(points[..., 2], 0, 0.12), 0)
    picture = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
    picture[query.part_mask] = ORANGE
    assert query.guess is not None
    for motion, colour in ((query.guess, BLUE), (dataset.truth_of(query).goal_drawn, GREEN)):
        u, v = pixels_after(query, points[query.part_mask], motion).T
        picture[v, u] = colour
    v, u = np.nonzero(query.part_mask | query.kit_region)
    Image.fromarray(picture[max(v.min() - 20, 0) : v.max() + 20, max(u.min() - 20, 0) : u.max() + 20]).save(out)
    print(f"{query.id} drawn into {out}")


if __name__ == "__main__":
    tyro.cli(main)
