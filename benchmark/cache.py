"""Results kept on disk: the rows of a submission are measured once for each evaluator, dataset and set of answers.

An entry is a file of numpy arrays named by a hash of all that decides them. One that is damaged is measured again.
"""

from __future__ import annotations

import hashlib
import io
import os
import sys
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from benchmark.per_query import PerQuery
from benchmark.provenance import evaluator
from kit1000.errors import InputError
from kit1000.files import json_bytes, write_bytes
from kit1000.submission import Predictions

COLUMNS = tuple(field.name for field in fields(PerQuery))


def user_folder() -> Path:
    """Where results are kept when nobody says where: below $XDG_CACHE_HOME, or ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "kit1000" / "scores"


def key_of(
    predictions: Predictions, dataset_id: str, split: str, tracks: Sequence[str], rotations: bool, judge: str
) -> str:
    """The name of a result: a hash of every answer, of what is asked, and of the sources that measure."""
    digest = hashlib.sha256()
    asked = [evaluator(), dataset_id, split, sorted(tracks), rotations, judge, list(predictions.query_ids)]
    digest.update(json_bytes(asked))
    motions = predictions.motions
    for array in (motions.wxyz, motions.xyz, predictions.confidence, predictions.seconds):
        digest.update(np.ascontiguousarray(array, "<f8").tobytes())
    return digest.hexdigest()


class ResultCache:
    """A folder of measured rows; processes may share it, and deleting it costs nothing but time."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def rows(self, key: str, make: Callable[[], PerQuery]) -> PerQuery:
        """The rows of a key, measured when they are not there yet."""
        path = self.root / f"{key}.npz"
        found = _read(path)
        if found is None:
            found = make()
            try:
                write_bytes(path, _packed(found))
            except InputError as error:  # a result that cannot be kept is a result all the same
                print(f"note: the result is not kept: {error}", file=sys.stderr)
        return found


def _packed(rows: PerQuery) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **rows.columns())
    return file.getvalue()


def _read(path: Path) -> PerQuery | None:
    """The rows of a file; None where there is none, or none that is whole."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            columns = {name: stored[name] for name in COLUMNS}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
    lengths = {column.shape for column in columns.values()}
    return PerQuery(**columns) if len(lengths) == 1 else None
