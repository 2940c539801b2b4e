"""Weights of a user's own training runs in the place of the published ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from kit1000.errors import InputError
from kit1000.files import read_json, sha256
from kit1000.prediction.catalog import Method

BEST = "best"  # stem of the best weights in the folder of a run
MAX_LABEL = 80  # characters of a label in a manifest
DIGITS = 12  # of a hash in a text


def with_weights(method: Method, runs: Sequence[str | Path]) -> Method:
    """A method with the weights of runs instead of its published ones; its training data names them.

    Args:
        method: of the catalog.
        runs: folders that `python -m baselines train` wrote, or files NAME.safetensors beside their NAME.json.

    Raises:
        InputError: a run without weights, or with those of a network that the method does not use.
    """
    if not runs:
        return method
    weights, texts = dict(method.weights), []
    for run in map(Path, runs):
        stem = _stem(run)
        about = _about(stem, run)
        name = about.get("name")
        places = [argument for argument, path in method.weights.items() if path.name == name]
        if not places:
            used = ", ".join(sorted(path.name for path in method.weights.values())) or "no weights"
            raise InputError(f"--weights {run}: weights of {name}, which the method does not use; it uses {used}")
        weights |= dict.fromkeys(places, stem)
        texts.append(_text(stem, about))
    published = [path for argument, path in method.weights.items() if weights[argument] == path]
    others = [f"published weights of the other networks: {method.training_data}"] if published else []
    label = f"{method.label}, own weights"[:MAX_LABEL] if method.label else ""
    return replace(method, weights=weights, label=label, training_data="; ".join([*texts, *others]))


def _stem(run: Path) -> Path:
    """The path of a run's weights without suffix."""
    stem = run.with_suffix("") if run.suffix == ".safetensors" else run / BEST
    for suffix in (".json", ".safetensors"):
        path = stem.with_name(stem.name + suffix)
        if not path.is_file():
            raise InputError(f"--weights {run}: no file {path}; expected the folder of a run with its best weights")
    return stem


def _about(stem: Path, run: Path) -> dict[str, Any]:
    info = read_json(stem.with_name(f"{stem.name}.json"))
    about = info.get("about") if isinstance(info, dict) else None
    if not isinstance(about, dict):
        raise InputError(f"--weights {run}: {stem.name}.json describes no weights of a training run")
    return about


def _text(stem: Path, about: dict[str, Any]) -> str:
    """What weights learned from, and which they are."""
    digest = sha256(stem.with_name(f"{stem.name}.safetensors")) or ""
    data = f"split train of dataset {about.get('dataset_id', 'unknown')}, preset {about.get('preset', 'unknown')}"
    return f"{about.get('name')}: {data} (own weights {digest[:DIGITS]})"
