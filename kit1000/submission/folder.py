"""The folder of a submission: manifest.toml says what the method is, predictions.csv what it answers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kit1000.errors import InputError
from kit1000.submission import manifest as manifests
from kit1000.submission import predictions as answers
from kit1000.submission.manifest import Manifest, read_manifest, write_manifest
from kit1000.submission.predictions import Predictions, read_predictions, write_predictions

if TYPE_CHECKING:
    from kit1000.values import Prediction


@dataclass(frozen=True, eq=False)
class Submission:
    """A method and its answers."""

    name: str
    """That of the folder."""
    manifest: Manifest
    predictions: Predictions
    folder: Path


def read_submission(folder: str | Path) -> Submission:
    """Read a submission. Raises InputError, with the first fault, when it cannot be scored as it is."""
    place = Path(folder)
    manifest = read_manifest(place / manifests.FILE)
    predictions = read_predictions(place / answers.FILE)
    return Submission(place.resolve().name, manifest, predictions, place)


def write_submission(
    folder: str | Path, manifest: Manifest, predictions: Predictions | Iterable[Prediction]
) -> Submission:
    """Write a submission, the manifest last, so that a folder with one is whole; returns what was written."""
    place = Path(folder)
    if not isinstance(predictions, Predictions):
        predictions = Predictions.of(predictions)
    try:
        (place / manifests.FILE).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {place}: {error.strerror or error}") from error
    write_predictions(place / answers.FILE, predictions)
    write_manifest(place / manifests.FILE, manifest)
    return Submission(place.resolve().name, manifest, predictions, place)
