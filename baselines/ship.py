"""Copying trained weights to where methods look for them, with how they were trained."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from baselines.training.checkpoint import LARGEST, load_weights
from baselines.training.loop import BEST, LOG
from kit1000.errors import InputError
from kit1000.files import write_bytes, write_json


def ship(run: Path, weights: Path, commit: str) -> Path:
    """Copy the best weights of a run, with the rows of its log, from which the learning curve can be drawn.

    Args:
        run: folder that `train` wrote.
        weights: folder for them.
        commit: of the code that trained them.

    Returns:
        The stem of both files, which have the network's name.

    Raises:
        InputError: no weights, damaged ones, or ones too large to be shipped.
    """
    stem = run / BEST
    _, info = load_weights(stem)
    size = stem.with_suffix(".safetensors").stat().st_size
    if size > LARGEST:
        raise InputError(f"{stem}.safetensors: {size / 2**20:.1f} MiB, and at most {LARGEST / 2**20:g} are shipped")
    described: dict[str, Any] = json.loads(stem.with_suffix(".json").read_bytes())
    rows = (run / LOG).read_text(encoding="utf-8").splitlines()
    target = weights / info["about"]["name"]
    write_bytes(target.with_suffix(".safetensors"), stem.with_suffix(".safetensors").read_bytes())
    write_json(target.with_suffix(".json"), described | {"commit": commit, "log": [json.loads(row) for row in rows]})
    return target
