"""Scoring committed submissions again: is what stands in their scores.json what comes out?"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from benchmark.report import json_text
from benchmark.score import read_checked, score
from kit1000.dataset.reader import Dataset
from kit1000.engines import local
from kit1000.files import read_json

MADE = ("commit", "evaluator")
"""What a score says of the code that made it: another commit may well give the same numbers."""


def rescored(folders: Sequence[Path], data: Path, workers: int = 1) -> Iterator[tuple[Path, list[str]]]:
    """Score submissions again, with nothing kept from before, and compare to the last digit.

    Args:
        folders: of the submissions, each with predictions.csv and scores.json.
        data: dataset folder, with its truth.
        workers: processes, each of which scores a submission at a time.

    Yields:
        Each folder when it is done, with a line for each value that differs, such as
        `tracks.snap.position_mm.mean: 1.82 there, 1.83 now`.
    """
    with local(min(workers, len(folders))) as spread:
        yield from spread(partial(_rescored, data), folders)


def _rescored(data: Path, folder: Path) -> tuple[Path, list[str]]:
    there: dict[str, Any] = read_json(folder / "scores.json")
    split, judge = there.get("split", "test"), there.get("judge", "near")
    submission = read_checked(folder, data, split)
    summary = score(submission, _opened(data), None, split, judge).summary
    now = json.loads(json_text(summary))
    return folder, [line for line in _differences(there, now, "") if line.partition(":")[0] not in MADE]


@lru_cache(maxsize=1)
def _opened(data: Path) -> Dataset:
    """The dataset, opened once a process: truths and shapes are read once for all submissions."""
    return Dataset(data)


def _differences(there: Any, now: Any, name: str) -> Iterator[str]:
    """Where two values as JSON has them differ, entry by entry."""
    if isinstance(there, dict) and isinstance(now, dict):
        for key in there | now:
            yield from _differences(there.get(key), now.get(key), f"{name}.{key}" if name else key)
    elif there != now:
        yield f"{name}: {_short(there)} there, {_short(now)} now"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
