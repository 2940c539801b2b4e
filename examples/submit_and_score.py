"""python examples/submit_and_score.py tiny --out my-submission

Predicts every query of one track, writes the submission folder, checks it and scores it. The method returns the user's
initial guess unchanged, so its error is that of the guess: about 27 mm and 14 degrees. Takes 3 s.
"""

from __future__ import annotations

import time
from pathlib import Path

import tyro

from benchmark.score import read_checked, score
from kit1000 import Dataset, Manifest, Pose, Prediction, Query, write_submission


def initial_guess(query: Query) -> Pose:
    """The user's initial guess, unchanged. A method would improve it from query.view and the masks."""
    assert query.guess is not None
    return query.guess


def main(data: tyro.conf.Positional[Path] = Path("tiny"), out: Path = Path("my-submission")) -> None:
    """Predict, write, check and score.

    Args:
        data: the dataset folder.
        out: the submission folder to write.
    """
    dataset = Dataset(data)
    predictions = []
    for query in dataset.split("test").queries("snap"):
        start = time.perf_counter()
        motion = initial_guess(query)
        predictions.append(Prediction(query.id, motion, confidence=0.5, seconds=time.perf_counter() - start))
    manifest = Manifest(
        method="initial guess",
        authors=("A. Name",),
        description="The user's initial guess, unchanged.",
        date="2026-01-31",
        dataset_id=dataset.id,
        tracks=("snap",),
        learned=False,
        uses_true_geometry=False,
    )
    write_submission(out, manifest, predictions)
    submission = read_checked(out, data, "test")  # raises InputError for a fault of form
    snap = score(submission, dataset).summary["tracks"]["snap"]
    print(f"position {snap['position_mm']['mean']:.1f} mm, rotation {snap['rotation_deg']['mean']:.1f} degrees")
    print(f"seated {snap['seated']['rate']:.0%} of {snap['n']} parts; the submission is in {out}")


if __name__ == "__main__":
    tyro.cli(main)
