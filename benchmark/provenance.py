"""What a score depends on: the commit, a hash of the sources that scoring imports, and a cache of results by these.

The rows of a submission are measured once per evaluator, dataset and set of predictions. An entry of the cache is a
file of numpy arrays, named by a hash of all that determines them. A damaged entry is measured again.
"""

from __future__ import annotations

import hashlib
import io
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

import kit1000
from benchmark.evaluate import PerQuery
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import json_bytes, write_bytes
from kit1000.prediction.imported_sources import hash_of, imported_modules
from kit1000.submission import Predictions

BENCHMARK = Path(__file__).parent
LIBRARY = Path(kit1000.__file__).parent
ENTRY = "benchmark.score"  # the evaluator is this module and all it imports
PROTOCOLS = "protocols/*.json"
UNKNOWN = "unknown"
DIGITS = 16  # of the hash of the evaluator


@cache
def evaluator(benchmark: Path = BENCHMARK, library: Path = LIBRARY) -> str:
    """A hash of the protocols and of the sources that scoring imports: equal hashes give equal scores.

    Args:
        benchmark: folder of the package `benchmark`.
        library: folder of the package `kit1000`.
    """
    files = {f"benchmark/{path.relative_to(benchmark).as_posix()}": path for path in benchmark.glob(PROTOCOLS)}
    return hash_of(files | evaluator_modules(benchmark, library))[:DIGITS]


def evaluator_modules(benchmark: Path = BENCHMARK, library: Path = LIBRARY) -> dict[str, Path]:
    """The modules of `benchmark` and `kit1000` that `benchmark.score` imports, directly or not, and their files.

    Imports inside functions count too; those for type checkers alone do not.
    """
    return imported_modules([ENTRY], {"benchmark": benchmark, "kit1000": library})


@cache
def commit() -> str:
    """The commit of this checkout, followed by `-dirty` if its code was changed since; `unknown` outside one."""
    head = _git("rev-parse", "--show-prefix", "HEAD")
    if head is None:
        return UNKNOWN
    prefix, _, head = head.partition("\n")
    if prefix:  # a checkout of something else holds this folder
        return UNKNOWN
    library = [LIBRARY.name] if LIBRARY.parent == BENCHMARK.parent else []  # or it is installed elsewhere
    changed = _git("status", "--porcelain", "--", BENCHMARK.name, *library)
    return head.strip() + ("-dirty" if changed else "")


def _git(*words: str) -> str | None:
    """The output of git in this checkout; None if there is no git or no checkout."""
    try:
        done = subprocess.run(["git", *words], cwd=BENCHMARK.parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout


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
        """The rows of a key; they are measured if there is no entry."""
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
    """The rows of an entry; None if it is absent or damaged."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            columns = {name: stored[name] for name in stored.files}
        rows = PerQuery.of_columns(columns)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
    lengths = {column.shape for column in columns.values()}
    return rows if len(lengths) == 1 else None
