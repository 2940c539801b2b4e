"""Checking a submission: all faults of its two files, by themselves or against the queries of a dataset."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kit1000.queries.tracks import ALL_TRACKS, CURVES
from kit1000.submission import manifest as manifests
from kit1000.submission import predictions as prediction_files
from kit1000.submission.conventions import convention_faults
from kit1000.submission.faults import MOST_KEPT, Fault, Report, file_error, file_warning, listed, printable
from kit1000.submission.manifest import Manifest, line_of, parse_manifest
from kit1000.submission.predictions import ID_PATTERN, Rows, read_rows
from kit1000.submission.reading import read_text

if TYPE_CHECKING:
    from kit1000.submission.expected_queries import ExpectedQueries

ID_FORMAT = re.compile(r"(?:(?:train|val|test)-s\d+-p\d+-([a-z0-9-]+)|(curves)-s\d+-p\d+-[a-z0-9-]+)\Z")
CHECKSUM_2_0_0 = "574db3e1a06a759aa59d14b97c336797ce5103ef00e57fbebf4075a77f17ac62"
"""Of `kit1000` in data version 2.0.0, whose content is that of 2.1.0."""


def check(path: str | Path, data: str | Path | None = None, split: str = "test") -> Report:
    """Find the faults of a submission folder, or of a predictions file alone.

    The report holds the first thousand errors.

    Args:
        path: the folder with manifest.toml and predictions.csv, or one predictions file.
        data: the dataset of the predictions; only the format is checked without. No ground truth is read.
        split: the split whose queries need predictions: test (the drawn queries, and the curves if the manifest lists
            them), test-all, val or train.

    Raises:
        InputError: if the dataset cannot be read. The submission may be anything.
    """
    path, form = Path(path), list[Fault]()
    manifest = _read_manifest(path, form) if _is_folder(path) else None
    rows = _read_rows(path, form)
    of_rows = [] if rows is None else rows.faults()
    expected = None if data is None else _read_expected(Path(data), split, rows)
    if expected is not None and manifest is not None:
        form.extend(_dataset_faults(manifest, expected, path / manifests.FILE))
    if rows is not None:
        _check_rows(rows, manifest, expected, form)
    return Report.of(path, form, of_rows, 0 if rows is None else len(rows), expected is not None)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError, RuntimeError):  # a loop of links, a NUL in the path
        return False


def _read_manifest(folder: Path, form: list[Fault]) -> Manifest | None:
    """The manifest of a folder; its faults are added to `form`."""
    text = read_text(folder / manifests.FILE, manifests.FILE, folder)
    manifest, faults = parse_manifest(text, manifests.FILE)
    form.extend(faults)
    return manifest


def _read_rows(path: Path, form: list[Fault]) -> Rows | None:
    """The rows of a folder or of a predictions file; faults of the file and its header are added to `form`."""
    file, inside = printable(path), None
    if _is_folder(path):
        path, file, inside = path / prediction_files.FILE, prediction_files.FILE, path
    elif path.name == manifests.FILE:
        expected, repair = "the folder of a submission, or its predictions file", "give the folder that contains it"
        form.append(file_error(file, "manifest-only", "is only the manifest", expected, repair))
        return None
    text = read_text(path, file, inside)
    rows = text if isinstance(text, Fault) else read_rows(text, file)
    if isinstance(rows, Fault):
        form.append(rows)
        return None
    return rows


def _read_expected(data: Path, split: str, rows: Rows | None) -> ExpectedQueries:
    from kit1000.submission.expected_queries import read_expected_queries  # the dataset reader takes a second to import

    return read_expected_queries(data, split, () if rows is None else rows.query_ids)


def _check_rows(rows: Rows, manifest: Manifest | None, expected: ExpectedQueries | None, form: list[Fault]) -> None:
    """Add the faults of ids and of all rows together."""
    tracks = None if manifest is None else manifest.tracks
    form += [*_line_end_faults(rows), *rows.duplicates()]
    if expected is None:
        form.extend(_track_faults(rows, tracks))
    else:
        form += [*_unknown_ids(rows, expected), *coverage_faults(rows, tracks, expected)]
    rotation_only = manifest is not None and manifest.predicts == "rotation"
    form.extend(convention_faults(rows, expected, rotation_only))


def _line_end_faults(rows: Rows) -> Iterator[Fault]:
    if len(rows) == 0:
        yield file_error(rows.file, "no-rows", "has no readable row", "one row per query", "write the predictions")
    if rows.text[-1].strip():
        actual, repair = "the last line has no line end", "check that its last number is complete"
        yield Fault(rows.file, len(rows.text), "no-line-end", actual, "a line end after every row", repair, "warning")


def _dataset_faults(manifest: Manifest, expected: ExpectedQueries, path: Path) -> Iterator[Fault]:
    """Differences between the dataset of the manifest and the given one."""
    text = read_text(path, manifests.FILE, path.parent)

    def fault(field: str, code: str, actual: str, expectation: str, repair: str) -> Fault:
        line = None if isinstance(text, Fault) else line_of(field, text)
        return Fault(manifests.FILE, line, code, actual, expectation, repair)

    if manifest.dataset_id not in (expected.dataset_id, expected.public_id):
        actual = f'dataset_id = "{printable(manifest.dataset_id)}"'
        repair = "check against the dataset of the predictions, or predict this one"
        yield fault("dataset_id", "other-dataset", actual, f'"{expected.dataset_id}", that of --data', repair)
    checksum = manifest.dataset_checksum
    if checksum and expected.checksum and checksum not in (expected.checksum, CHECKSUM_2_0_0):
        actual = f'dataset_checksum = "{printable(checksum)}"'
        expectation = f'"{expected.checksum}": the same plan, built on another machine'
        repair = "no change needed: kit1000 verify compares the two copies"
        other = fault("dataset_checksum", "other-checksum", actual, expectation, repair)
        yield replace(other, severity="warning")
    known = [track for track in ALL_TRACKS if track in expected.tracks]
    for track in manifest.tracks:
        if track not in known:
            actual, expectation = f'tracks has "{track}"', f"some of {', '.join(known)}"
            yield fault("tracks", "unknown-track", actual, expectation, f"delete {track}")


def _unknown_ids(rows: Rows, expected: ExpectedQueries) -> list[Fault]:
    """Ids that the dataset does not have; an invalid id is a fault of its row instead."""
    unknown = [i for i, name in enumerate(rows.query_ids) if ID_PATTERN.match(name) and name not in expected.index]
    known, repair = "the id of a query of this dataset", "copy the id, or check against the dataset of the predictions"
    return [rows.fault(i, "query_id", "unknown-id", known, repair) for i in unknown[:MOST_KEPT]]


def _track_faults(rows: Rows, listed_tracks: Iterable[str] | None) -> Iterator[Fault]:
    """Listed tracks without a row, and rows of tracks that are not listed, by the format of the ids."""
    if listed_tracks is None:
        return
    counts = Counter(track for query_id in rows.query_ids if (track := _track_of(query_id)))
    for track in listed_tracks if len(rows) else ():
        if track not in counts:
            repair = f"predict it, or delete {track} from tracks in manifest.toml; else its queries count as no motion"
            actual = f"track {track} is listed in manifest.toml and has no row"
            yield file_warning(rows.file, "empty-track", actual, "one row per query", repair)
    yield from _unlisted_track_faults(counts, listed_tracks, rows.file)


def coverage_faults(rows: Rows, listed_tracks: Iterable[str] | None, expected: ExpectedQueries) -> Iterator[Fault]:
    """Queries without a row, by track, and rows of tracks and splits that are not checked."""
    known = [expected.index[query_id] for query_id in rows.query_ids if query_id in expected.index]
    counts = Counter(expected.tracks[i] for i in known if expected.required[i])
    for track in ALL_TRACKS:
        if track in (counts if listed_tracks is None else listed_tracks):
            yield from _missing_faults(track, set(known), expected, rows.file)
    checked = {expected.splits[i] for i in np.flatnonzero(expected.required)}
    for split, count in Counter(expected.splits[i] for i in known if expected.splits[i] not in checked).items():
        repair = f"no change needed: they are ignored; --split {split} checks them"
        actual, expectation = f"{count} rows of split {split}", "rows of the checked split"
        yield file_warning(rows.file, "other-split", actual, expectation, repair)
    if listed_tracks is not None:
        yield from _unlisted_track_faults(counts, listed_tracks, rows.file)


def _missing_faults(track: str, predicted: set[int], expected: ExpectedQueries, file: str) -> Iterator[Fault]:
    """Warnings about the queries of a track without a row. All queries of a scene of the curves may be left out."""
    queries = [i for i, name in enumerate(expected.tracks) if name == track and expected.required[i]]
    scenes = {expected.scene_part(i) for i in queries if i in predicted}
    if track == CURVES and scenes:
        total = len({expected.scene_part(i) for i in queries})
        queries = [i for i in queries if expected.scene_part(i) in scenes]
        if len(scenes) < total:
            actual = f"track {CURVES}: {len(scenes)} of {total} scenes have predictions"
            repair = "no change needed for the first scenes of the protocol; else each counts as no motion"
            yield file_warning(file, "partial-curves", actual, "all scenes, or some of them completely", repair)
    missing = [expected.query_ids[i] for i in queries if i not in predicted]
    if missing:
        examples = listed(missing, len(missing))
        actual = f"track {track}: {len(missing)} of {len(queries)} queries have no row ({examples})"
        repair = "no change needed if the method leaves them out: each counts as no motion"
        yield file_warning(file, "missing-predictions", actual, "one row per query", repair)


def _unlisted_track_faults(counts: Counter[str], listed_tracks: Iterable[str], file: str) -> Iterator[Fault]:
    for track in counts.keys() - set(listed_tracks):
        actual = f"{counts[track]} rows of track {track}, which manifest.toml does not list"
        repair = "add the track to tracks in manifest.toml, or delete its rows"
        yield file_warning(file, "unlisted-track", actual, "rows of listed tracks", repair)


def _track_of(query_id: str) -> str:
    """The track of an id; "" for an unusual format."""
    match = ID_FORMAT.match(query_id)
    track = (match[1] or match[2]) if match else ""
    return track if track in ALL_TRACKS else ""
