"""python examples/own_method.py tiny

Defines a method, runs it on the validation queries and checks it. Takes 2 s. This predicts a full split:
`python -m baselines predict examples.own_method:Lifted --data tiny --tracks snap --out my-submission`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro

from kit1000 import Dataset, Pose, PredictedMotion, Query, TrueGeometry
from kit1000.testing import check_predictor


class Lifted:
    """The user's initial guess, raised until no visible point of the part lies below the table."""

    tracks = ("snap", "snap-tilt", "snap-d415", "curves")
    """The tracks that the method predicts: here, those with an initial guess."""
    learned = False
    uses_true_geometry = False

    def __init__(self, dataset: Dataset) -> None:
        """A learned method would read its weights here."""

    def __call__(self, query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
        """Predict from this query alone. The geometry is None unless `uses_true_geometry` is set."""
        view = query.view
        points = view.world_from_camera.apply(view.camera.unproject(view.depth)[query.part_mask])
        assert query.guess is not None
        lowest = query.guess.apply(points)[:, 2].min()  # [m] height over the table
        lifted = Pose.from_translation((0.0, 0.0, max(0.0, -lowest))) @ query.guess
        return PredictedMotion(lifted, confidence=0.5)


def main(data: tyro.conf.Positional[Path] = Path("tiny")) -> None:
    """Run and check the method.

    Args:
        data: the dataset folder.
    """
    dataset = Dataset(data)
    method = Lifted(dataset)
    queries = list(dataset.split("val").queries("snap"))
    for query in queries:
        predicted = method(query, None)
        truth = dataset.truth_of(query)
        error = predicted.goal_from_now.apply(truth.anchor) - truth.goal_drawn.apply(truth.anchor)
        print(f"{query.id}: {np.linalg.norm(error) * 1e3:.1f} mm off")
    check_predictor(method, queries)  # raises AssertionError with one line when the method depends on anything else
    print("the method passes the checks")


if __name__ == "__main__":
    tyro.cli(main)
