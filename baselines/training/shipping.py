"""Copying trained weights to where methods look for them, with how they were trained."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from baselines.training.loop import BEST, LOG
from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.perception.networks.precision import Precision
from kit1000.perception.networks.weight_files import LARGEST, load_weights, save_tensors


def ship(run: Path, weights_folder: Callable[[str], Path], commit: str, precision: Precision = "float32") -> Path:
    """Copy the best weights of a run, with the rows of its log.

    Args:
        run: folder that `train` wrote.
        weights_folder: folder for the weights of a network, by its name.
        commit: of the code that trained them.
        precision: in which they are stored.

    Returns:
        The stem of both files, which have the network's name.

    Raises:
        InputError: no weights, damaged ones, ones too large to be shipped, or ones trained on another dataset than
            those that they replace, whose name the methods' manifests would go on to give.
    """
    stem = run / BEST
    tensors, info = load_weights(stem)
    rows = (run / LOG).read_text(encoding="utf-8").splitlines()
    name = info["about"]["name"]
    target = weights_folder(name) / name
    path = target.with_name(f"{target.name}.json")
    published = read_json(path)["about"].get("dataset_id") if path.is_file() else None
    own = info["about"].get("dataset_id")
    if published not in (None, own):
        raise InputError(
            f"{target.name}: the published weights were trained on dataset {published}, these on {own}: manifests "
            "would name the wrong data; predict --weights RUN uses them as your own"
        )
    described = info | {"commit": commit, "log": [json.loads(row) for row in rows]}
    save_tensors(target, tensors, described, precision, LARGEST)
    return target
