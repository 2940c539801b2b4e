"""The entries of a leaderboard: the scored submissions of a folder, all under one protocol and on one dataset."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmark.protocol import masks_of
from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.submission.faults import Fault
from kit1000.submission.manifest import Manifest, read_manifest
from kit1000.submission.predictions import FILE as PREDICTIONS
from kit1000.submission.reading import read_file

SETTING = ("protocol", "status", "metric_versions", "dataset_id", "split")
"""Keys of scores.json that entries must agree in: else their numbers cannot be compared."""
PROVENANCE = ("evaluator", "commit", "method", "manifest", "predictions_sha256")
KEYS = (*SETTING, *PROVENANCE, "tracks", "breakdown", "curves", "curve_scenes")
SHOWN_DIGITS = 16  # of a SHA-256 in a message


@dataclass(frozen=True, eq=False)
class Entry:
    """A scored submission."""

    name: str
    """Name of its folder, and of its page."""
    folder: Path
    manifest: Manifest
    scores: Mapping[str, Any]
    """The content of scores.json."""

    @property
    def setting(self) -> dict[str, Any]:
        """Protocol, its status, metric versions, dataset and split of the scores."""
        return {key: self.scores[key] for key in SETTING}

    @property
    def knows_shapes(self) -> bool:
        """Whether it gets the meshes of the scene; it is compared with such methods only."""
        return self.manifest.reads == "shapes"

    def masks(self, track: str) -> str:
        """Whose masks the figures of a track rest on, see `benchmark.protocol.masks_of`."""
        return masks_of(self.scores, track)


def read_entries(submissions: Path) -> tuple[Entry, ...]:
    """The scored submissions of a folder, by name.

    Raises InputError if scores were made of other files than those beside them, or if two entries cannot share a table.
    """
    entries = tuple(_read(folder) for folder in _folders(submissions) if (folder / "scores.json").is_file())
    _check_setting(entries)
    _check_unique(entries)
    return entries


def unscored(submissions: Path) -> tuple[str, ...]:
    """Names of the folders with a manifest and without scores."""
    return tuple(folder.name for folder in _folders(submissions) if not (folder / "scores.json").is_file())


def _folders(submissions: Path) -> list[Path]:
    """The folders with a manifest."""
    if not submissions.is_dir():
        raise InputError(f"{submissions}: no folder of submissions")
    return sorted(path.parent for path in submissions.glob("*/manifest.toml"))


def _read(folder: Path) -> Entry:
    path = folder / "scores.json"
    scores = read_json(path)
    missing = [key for key in KEYS if not isinstance(scores, dict) or key not in scores]
    if missing:
        raise InputError(f"{path}: expected scores of `python -m benchmark score`; there is no {', '.join(missing)}")
    entry = Entry(folder.name, folder, read_manifest(folder / "manifest.toml", folder), scores)
    _check_files(entry)
    return entry


def with_newer_fields(scored: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, Any]:
    """A manifest as scores have it, with the empty fields of today's that it lacks: they are newer than the scores."""
    return {name: value for name, value in now.items() if value == ""} | dict(scored)


def _check_files(entry: Entry) -> None:
    """Refuse scores that were made of another manifest or of other predictions than those beside them."""
    scored, now = entry.scores["manifest"], json.loads(json.dumps(asdict(entry.manifest)))
    if not isinstance(scored, dict):
        raise _other_files(entry, "its manifest is no table")
    scored = with_newer_fields(scored, now)
    changed = sorted(name for name in scored | now if scored.get(name) != now.get(name))
    if changed:
        raise _other_files(entry, f"manifest.toml has another {', '.join(changed)}")
    if entry.scores["method"] != entry.manifest.method:
        raise _other_files(entry, "manifest.toml has another method")
    path = entry.folder / PREDICTIONS
    data = read_file(path, str(path), entry.folder)
    if isinstance(data, Fault):
        raise InputError(str(data))
    scored, now = entry.scores["predictions_sha256"], hashlib.sha256(data).hexdigest()
    if scored != now:
        hashes = f"has SHA-256 {now[:SHOWN_DIGITS]}, the scored one had {str(scored)[:SHOWN_DIGITS]}"
        raise _other_files(entry, f"{PREDICTIONS} {hashes}")


def _other_files(entry: Entry, difference: str) -> InputError:
    repair = f"`python -m benchmark score {entry.folder} --data DIR` scores what is there"
    return InputError(f"{entry.folder}: scores.json was made of other files: {difference}; {repair}")


def _check_setting(entries: Sequence[Entry]) -> None:
    for entry in entries[1:]:
        for key, ours in entries[0].setting.items():
            theirs = entry.setting[key]
            if theirs != ours:
                raise InputError(
                    f"{entry.folder}: its scores have {key} {theirs}, those of {entries[0].name} {ours}; "
                    "score both again, on one dataset"
                )


def _check_unique(entries: Sequence[Entry]) -> None:
    """Refuse two entries of one method, with one label, or for one row of the paper."""
    for what, of in (
        ("method", lambda manifest: manifest.method),
        ("label", lambda manifest: manifest.display_name),
        ("paper_row", lambda manifest: manifest.paper_row),
    ):
        first: dict[str, Entry] = {}
        for entry in entries:
            value = of(entry.manifest)
            other = first.setdefault(value, entry) if value else entry
            if other is not entry:
                raise InputError(
                    f"{entry.folder}: {what} {value!r} is that of {other.name} too; change it in one manifest.toml"
                )
