"""The cache of results: the rows of a submission are measured once per evaluator, dataset and set of predictions.

An entry is a file of numpy arrays, named by a hash of all that determines them. A damaged entry is measured again.
"""

from __future__ import annotations

import hashlib
import io
import sys
import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmark.per_query import PerQuery
from benchmark.provenance import evaluator
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import json_bytes, write_bytes
from kit1000.submission import Predictions


def cache_key(
    predictions: Predictions, dataset: Dataset, split: str, tracks: Sequence[str], rotation_only: bool, exact: str
) -> str:
    """The name of a result: a hash of all predictions, the copy of the dataset, the options, and the evaluator."""
    digest = hashlib.sha256()
    data = [dataset.id, dataset.summary.get("checksum")]
    options = [split, sorted(tracks), rotation_only, exact]
    digest.update(json_bytes([evaluator(), *data, *options, list(predictions.query_ids)]))
    motions = predictions.motions
    for array in (motions.wxyz, motions.xyz, predictions.confidence, predictions.seconds):
        digest.update(np.ascontiguousarray(array, "<f8").tobytes())
    return digest.hexdigest()


class ResultCache:
    """A folder of measured rows; processes may share it, and it may be deleted at any time."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def rows(self, key: str, measure: Callable[[], PerQuery]) -> PerQuery:
        """The rows of a key, measured where there is no entry."""
        path = self.root / f"{key}.npz"
        rows = _read(path)
        if rows is None:
            rows = measure()
            try:
                write_bytes(path, _packed(rows))
            except InputError as error:  # the result is valid without an entry
                print(f"note: the result is not cached: {error}", file=sys.stderr)
        return rows


def _packed(rows: PerQuery) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **rows.columns())
    return file.getvalue()


def _read(path: Path) -> PerQuery | None:
    """The rows of an entry; None where there is none, or a damaged one."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            columns = {name: stored[name] for name in stored.files}
        rows = PerQuery.of_columns(columns)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
    lengths = {column.shape for column in columns.values()}
    return rows if len(lengths) == 1 else None
