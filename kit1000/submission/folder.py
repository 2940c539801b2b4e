"""The folder of a submission: manifest.toml describes the method, predictions.csv has its predictions."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kit1000.errors import InputError
from kit1000.submission import manifest as manifests
from kit1000.submission import predictions as prediction_files
from kit1000.submission.manifest import Manifest, read_manifest, write_manifest
from kit1000.submission.predictions import (
    NO_INVALID,
    InvalidRows,
    Predictions,
    read_valid_predictions,
    write_predictions,
)

if TYPE_CHECKING:
    from kit1000.values import Prediction


@dataclass(frozen=True, eq=False)
class Submission:
    """A method and its predictions."""

    name: str
    """The name of the folder."""
    manifest: Manifest
    predictions: Predictions
    folder: Path
    invalid: InvalidRows = NO_INVALID
    """Rows of the file that were left out."""


def read_submission(folder: str | Path) -> Submission:
    """Read a submission. Raises InputError with its first error, if it has any."""
    submission = read_valid_submission(folder)
    if submission.invalid.first is not None:
        raise InputError(f"{submission.invalid.first} (`kit1000 check` lists all faults)")
    return submission


def read_valid_submission(folder: str | Path) -> Submission:
    """Read a submission without its invalid rows.

    Raises InputError with the first error of the manifest, or of the predictions file itself.
    """
    path = Path(folder)
    manifest = read_manifest(path / manifests.FILE, path)
    predictions, invalid = read_valid_predictions(path / prediction_files.FILE, path)
    return Submission(path.resolve().name, manifest, predictions, path, invalid)


def write_submission(
    folder: str | Path, manifest: Manifest, predictions: Predictions | Iterable[Prediction]
) -> Submission:
    """Write and return a submission. The manifest is written last: a folder with a manifest is complete."""
    path = Path(folder)
    if not isinstance(predictions, Predictions):
        predictions = Predictions.of(predictions)
    try:
        (path / manifests.FILE).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {path}: {error.strerror or error}") from error
    write_predictions(path / prediction_files.FILE, predictions)
    write_manifest(path / manifests.FILE, manifest)
    return Submission(path.resolve().name, manifest, predictions, path)
