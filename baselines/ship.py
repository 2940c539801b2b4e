"""Copying trained weights to where methods look for them, with how they were trained."""

from __future__ import annotations

import json
from pathlib import Path

from baselines.training.checkpoint import LARGEST, load_weights, save_tensors
from baselines.training.loop import BEST, LOG


def ship(run: Path, weights: Path, commit: str, half: bool = False) -> Path:
    """Copy the best weights of a run, with the rows of its log, from which the learning curve can be drawn.

    Args:
        run: folder that `train` wrote.
        weights: folder for them.
        commit: of the code that trained them.
        half: store them as float16, for a network too large otherwise.

    Returns:
        The stem of both files, which have the network's name.

    Raises:
        InputError: no weights, damaged ones, or ones too large to be shipped.
    """
    stem = run / BEST
    tensors, info = load_weights(stem)
    rows = (run / LOG).read_text(encoding="utf-8").splitlines()
    target = weights / info["about"]["name"]
    described = info | {"commit": commit, "log": [json.loads(row) for row in rows]}
    save_tensors(target, tensors, described, half, LARGEST)
    return target
