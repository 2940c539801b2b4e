"""What the pages are made of: the scored submissions of a folder, all under one protocol and on one dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.submission.manifest import Manifest, read_manifest

COMMON = ("protocol", "status", "metric_versions", "dataset_id", "split")  # scores that differ in one share no table
STATED = (*COMMON, "evaluator", "commit", "method", "tracks", "breakdown", "curves")


@dataclass(frozen=True, eq=False)
class Entry:
    """A method on the board."""

    name: str
    """That of the folder: names the pages."""
    folder: Path
    manifest: Manifest
    scores: Mapping[str, Any]
    """What scores.json holds."""


@dataclass(frozen=True, eq=False)
class Board:
    """All methods, and what their scores have in common."""

    entries: tuple[Entry, ...]
    """By name of their folders; never empty."""
    unscored: tuple[str, ...]
    """Folders that hold no scores.json yet."""

    @property
    def stated(self) -> Mapping[str, Any]:
        """Protocol, its status, metric versions, dataset and split of all scores."""
        return self.entries[0].scores

    @property
    def evaluators(self) -> tuple[str, ...]:
        """Which evaluators made the scores: one, unless some are older."""
        return tuple(sorted({entry.scores["evaluator"] for entry in self.entries}))

    @property
    def date(self) -> str:
        """Of the latest submission, YYYY-MM-DD."""
        return max(entry.manifest.date for entry in self.entries)

    @property
    def tracks(self) -> tuple[str, ...]:
        """Tracks that some method was scored on, in any order."""
        return tuple({track: None for entry in self.entries for track in entry.scores["tracks"]})


def read_board(submissions: Path) -> Board:
    """Read all submissions of a folder. Raises InputError when there is none, or when two cannot be compared."""
    if not submissions.is_dir():
        raise InputError(f"{submissions}: no folder of submissions")
    folders = sorted(path.parent for path in submissions.glob("*/manifest.toml"))
    scored = [folder for folder in folders if (folder / "scores.json").is_file()]
    if not scored:
        raise InputError(f"{submissions}: no scored submission (folders with manifest.toml and scores.json)")
    entries = tuple(map(_entry, scored))
    _check_alike(entries)
    return Board(entries, tuple(folder.name for folder in folders if folder not in scored))


def _entry(folder: Path) -> Entry:
    path = folder / "scores.json"
    scores = read_json(path)
    missing = [name for name in STATED if name not in scores] if isinstance(scores, dict) else list(STATED)
    if missing:
        raise InputError(f"{path}: expected scores of `python -m benchmark score`; there is no {', '.join(missing)}")
    return Entry(folder.name, folder, read_manifest(folder / "manifest.toml"), scores)


def _check_alike(entries: Sequence[Entry]) -> None:
    first = entries[0]
    for entry in entries[1:]:
        for name in COMMON:
            ours, theirs = first.scores[name], entry.scores[name]
            if ours != theirs:
                raise InputError(
                    f"{entry.folder}: its scores have {name} {theirs}, those of {first.name} {ours}; score both again"
                )
