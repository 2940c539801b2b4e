"""Scoring committed submissions again: is what stands in their scores.json what comes out?"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmark.report import json_text
from benchmark.score import read_checked, score
from kit1000.data.files import read_json
from kit1000.data.reader import Dataset

MADE = ("commit", "evaluator")
"""What a score says of the code that made it: another commit may well give the same numbers."""


def rescored(folder: Path, data: Path, workers: int = 1) -> list[str]:
    """Score a submission again, with nothing kept from before, and compare to the last digit.

    Args:
        folder: of the submission, with predictions.csv and scores.json.
        data: dataset folder, with its truth.
        workers: processes for the seating test.

    Returns:
        A line for each value that differs, such as `tracks.snap.position_mm.mean: 1.82 there, 1.83 now`.
    """
    there: dict[str, Any] = read_json(folder / "scores.json")
    split, judge = there.get("split", "test"), there.get("judge", "near")
    submission = read_checked(folder, data, split)
    summary = score(submission, Dataset(data), None, split, judge, workers).summary
    now = json.loads(json_text(summary))
    return [line for line in _differences(there, now, "") if line.partition(":")[0] not in MADE]


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
