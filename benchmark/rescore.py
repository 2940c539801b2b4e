"""Scoring submissions again and comparing the result with their scores.json."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from benchmark.entries import with_newer_fields
from benchmark.report import json_text
from benchmark.score import read_checked, score
from kit1000.dataset.reader import Dataset
from kit1000.files import read_json, write_bytes
from kit1000.parallel import local_engine

CODE_KEYS = ("commit", "evaluator")
"""Keys of scores.json about the code that made it; they are not compared: another commit may give the same numbers."""


def rescore(
    folders: Sequence[Path], data: Path, workers: int = 1, refresh: bool = False
) -> Iterator[tuple[Path, list[str]]]:
    """Score submissions again, without any cache, and compare to the last digit.

    Args:
        folders: of the submissions, each with predictions.csv and scores.json.
        data: dataset folder, with its truth.
        workers: processes; each scores one submission at a time.
        refresh: write the new scores.json if the scores are the same: it then names the current code.

    Yields:
        Each folder once it is done, with a line for each value that differs, such as
        `tracks.snap.position_mm.mean: 1.82 before, 1.83 now`.
    """
    with local_engine(min(workers, len(folders))) as spread:
        yield from spread(partial(_rescore, data, refresh), folders)


def _rescore(data: Path, refresh: bool, folder: Path) -> tuple[Path, list[str]]:
    before: dict[str, Any] = read_json(folder / "scores.json")
    split, exact = before.get("split", "test"), before.get("exact", "near")
    submission = read_checked(folder, data, split)
    summary = score(submission, _dataset(data), None, split, exact).summary
    text = json_text(summary)
    now = json.loads(text)
    found = _differences(before | {"manifest": with_newer_fields(before["manifest"], now["manifest"])}, now, "")
    differences = [line for line in found if line.partition(":")[0] not in CODE_KEYS]
    if refresh and not differences:
        write_bytes(folder / "scores.json", text.encode())
    return folder, differences


@lru_cache(maxsize=1)
def _dataset(data: Path) -> Dataset:
    """The dataset, opened once in each process: ground truth and shapes are read once for all submissions."""
    return Dataset(data)


def _differences(before: Any, now: Any, name: str) -> Iterator[str]:
    """A line for each entry in which two JSON values differ."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in before | now:
            yield from _differences(before.get(key), now.get(key), f"{name}.{key}" if name else key)
    elif before != now:
        yield f"{name}: {_short(before)} before, {_short(now)} now"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
