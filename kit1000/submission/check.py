"""Checking a submission: all faults of its two files, by themselves or against the queries of a dataset."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kit1000.queries.tracks import ALL_TRACKS, CURVES
from kit1000.submission import manifest as manifests
from kit1000.submission import predictions as prediction_files
from kit1000.submission.faults import Fault, FaultList, Report, listed, printable, sorted_faults
from kit1000.submission.manifest import Manifest, line_of, manifest_of
from kit1000.submission.plausibility import plausibility_faults
from kit1000.submission.reading import decode_text, file_error, file_warning, read_file
from kit1000.submission.row_rules import ID_PATTERN, duplicate_faults, value_faults
from kit1000.submission.rows import Rows, read_rows

if TYPE_CHECKING:
    from kit1000.submission.expected_queries import ExpectedQueries

ID_FORMAT = re.compile(r"(?:(?:train|val|test)-s\d+-p\d+-([a-z0-9-]+)|(curves)-s\d+-p\d+-[a-z0-9-]+)\Z")
MOST_SUGGESTED = 20  # unknown ids for which similar ones are searched


def check(path: str | Path, data: str | Path | None = None, split: str = "test") -> Report:
    """Find the faults of a submission folder, or of a predictions file alone.

    All are counted; the report holds the first thousand errors and warnings.

    Args:
        path: the folder with manifest.toml and predictions.csv, or one predictions file.
        data: the dataset of the predictions; without it only the format is checked. No ground truth is read.
        split: whose queries need a prediction: test (the drawn ones, and the curves if listed), test-all, val or train.

    Raises:
        InputError: when the dataset cannot be read. The submission may be anything.
    """
    path = Path(path)
    manifest, rows, form, of_rows = _read_files(path)
    expected = None if data is None else _read_expected(Path(data), split, rows)
    if manifest is not None and expected is not None:
        form.add(_dataset_faults(manifest, expected, path / manifests.FILE))
    elif expected is not None:
        form.kept = [_naming_dataset(fault, expected) for fault in form.kept]
    if rows is not None:
        listed_tracks = None if manifest is None else manifest.tracks
        if expected is None:
            form.add([*_id_format_faults(rows), *_track_faults(rows, listed_tracks)])
        else:
            form.add(_unknown_id_faults(rows, expected))
            form.add(coverage_faults(rows, listed_tracks, expected))
        rotation_only = manifest is not None and manifest.predicts == "rotation"
        form.add(plausibility_faults(rows, expected, rotation_only))
    form_errors = tuple(fault for fault in form.kept if fault.severity == "error")
    row_count = 0 if rows is None else len(rows)
    of_rows.add(form)
    faults = sorted_faults(of_rows.kept)
    counts = of_rows.errors, of_rows.warnings
    return Report(printable(path), faults, row_count, expected is not None, *counts, form_errors)


def _read_expected(data: Path, split: str, rows: Rows | None) -> ExpectedQueries:
    from kit1000.submission.expected_queries import read_expected_queries  # imports the dataset reader: a second

    return read_expected_queries(data, split, () if rows is None else rows.query_ids)


def _read_files(path: Path) -> tuple[Manifest | None, Rows | None, FaultList, FaultList]:
    """The two files as far as they can be read, the faults of their form, and those of single rows."""
    manifest, faults, inside = None, [], None
    if _is_folder(path):
        inside = path
        manifest, faults = manifest_of(path / manifests.FILE, manifests.FILE, path)
        path = path / prediction_files.FILE
        file = prediction_files.FILE
    else:
        file = printable(path)
    if path.name == manifests.FILE:
        expected = "the folder of a submission, or its predictions file"
        fault = file_error(file, "manifest-only", "is only the manifest", expected, "give the folder that contains it")
        return None, None, FaultList.of([fault]), FaultList()
    data, open_faults = read_file(path, file, inside)
    text, text_faults = (None, []) if data is None else decode_text(data, file)
    rows, format_faults, of_rows = (None, [], FaultList()) if text is None else read_rows(text, file)
    form = FaultList.of([*faults, *open_faults, *text_faults, *format_faults])
    if rows is None:
        return manifest, None, form, of_rows
    of_rows.add(value_faults(rows))
    form.add(duplicate_faults(rows))
    if len(rows) == 0:
        form.add([file_error(file, "no-rows", "has no readable row", "one row per query", "write the predictions")])
    return manifest, rows, form, of_rows


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError, RuntimeError):  # a loop of links, a NUL in the path
        return False


def _naming_dataset(fault: Fault, expected: ExpectedQueries) -> Fault:
    """The fault; where the id of the dataset is to be added, with the id itself."""
    example = f"dataset_id = {manifests.EXAMPLES['dataset_id']}"
    return replace(fault, repair=fault.repair.replace(example, f'dataset_id = "{expected.dataset_id}"'))


def _dataset_faults(manifest: Manifest, expected: ExpectedQueries, path: Path) -> list[Fault]:
    """Differences between the dataset of the manifest and the given one."""
    faults: list[Fault] = []
    text = (read_file(path, manifests.FILE, path.parent)[0] or b"").decode("utf-8", "replace")

    def add(code: str, field: str, actual: str, expectation: str, repair: str, error: bool = True) -> None:
        severity = "error" if error else "warning"
        line = line_of(field, text)
        faults.append(Fault(manifests.FILE, line, None, actual, expectation, repair, severity, code))

    if manifest.dataset_id not in (expected.dataset_id, expected.public_id):
        actual = f'dataset_id = "{printable(manifest.dataset_id)}"'
        repair = "check against the dataset of the predictions, or predict this one"
        add("other-dataset", "dataset_id", actual, f'"{expected.dataset_id}", that of --data', repair)
    checksum = manifest.dataset_checksum
    if checksum and expected.checksum and checksum != expected.checksum:
        actual = f'dataset_checksum = "{printable(checksum)}"'
        expectation = f'"{expected.checksum}": the same plan, built on another machine'
        repair = "no change needed: kit1000 verify compares the two copies"
        add("other-checksum", "dataset_checksum", actual, expectation, repair, error=False)
    for track in manifest.tracks:
        if track not in set(expected.tracks):
            present = ", ".join(track for track in ALL_TRACKS if track in set(expected.tracks))
            add("unknown-track", "tracks", f'tracks has "{track}"', f"some of {present}", f"delete {track}")
    return faults


def _id_format_faults(rows: Rows) -> list[Fault]:
    """A warning of ids without the format of a dataset of kit1000."""
    unusual = [i for i, query_id in enumerate(rows.query_ids) if query_id and not _track_of(query_id)]
    if not unusual:
        return []
    examples = listed((rows.query_ids[i] for i in unusual), len(unusual))
    actual = printable(f"{len(unusual)} ids have an unusual format ({examples})"[:300])
    repair = "copy the ids from the dataset"
    return [file_warning(rows.file, "unusual-ids", actual, "ids such as test-s0007-p2-snap", repair)]


def _unknown_id_faults(rows: Rows, expected: ExpectedQueries) -> FaultList:
    """Ids that the dataset does not have; those of no valid format are faults of their rows."""
    unknown = [i for i, name in enumerate(rows.query_ids) if ID_PATTERN.match(name) and name not in expected.index]
    suggested = set(unknown[:MOST_SUGGESTED])

    def fault(i: int) -> Fault:
        closest = expected.closest_id(rows.query_ids[i], fuzzy=i in suggested)
        other = "delete the row, or check against the dataset of the predictions"
        repair = f"did you mean {closest}?" if closest else other
        return rows.fault(i, "query_id", "unknown-id", "the id of a query of this dataset", repair)

    return FaultList.of_rows(unknown, fault)


def _track_faults(rows: Rows, listed_tracks: Iterable[str] | None) -> list[Fault]:
    """Listed tracks without a row, and rows of tracks that are not listed, by the format of the ids."""
    if listed_tracks is None:
        return []
    counts = _count(_track_of(query_id) for query_id in rows.query_ids)
    empty = [_empty_track_fault(track, rows.file) for track in listed_tracks if track not in counts]
    return [*(empty if len(rows) else []), *_unlisted_track_faults(counts, listed_tracks, rows.file)]


def coverage_faults(rows: Rows, listed_tracks: Iterable[str] | None, expected: ExpectedQueries) -> list[Fault]:
    """Queries without a row, by track, and rows of tracks and splits that are not checked."""
    known = [expected.index[query_id] for query_id in rows.query_ids if query_id in expected.index]
    predicted = set(known)
    counts = _count(expected.tracks[i] for i in known if expected.required[i])
    tracks = [track for track in ALL_TRACKS if track in (counts if listed_tracks is None else listed_tracks)]
    faults: list[Fault] = []
    for track in tracks:
        queries = [i for i, name in enumerate(expected.tracks) if name == track and expected.required[i]]
        if track == CURVES:
            queries, warnings = _predicted_scenes(queries, predicted, expected, rows.file)
            faults += warnings
        missing = [expected.query_ids[i] for i in queries if i not in predicted]
        if missing:
            examples = listed(missing, len(missing))
            actual = f"track {track}: {len(missing)} of {len(queries)} queries have no row ({examples})"
            repair = "no change needed where the method leaves them out: each counts as no motion"
            faults.append(file_warning(rows.file, "missing-predictions", actual, "one row per query", repair))
    checked = {expected.splits[i] for i in np.flatnonzero(expected.required)}
    others = _count(expected.splits[i] for i in known if expected.splits[i] not in checked)
    for split, count in others.items():
        repair = f"no change needed: they are ignored; --split {split} checks them"
        actual, expectation = f"{count} rows of split {split}", "rows of the checked split"
        faults.append(file_warning(rows.file, "other-split", actual, expectation, repair))
    return [*faults, *([] if listed_tracks is None else _unlisted_track_faults(counts, listed_tracks, rows.file))]


def _predicted_scenes(
    queries: list[int], predicted: set[int], expected: ExpectedQueries, file: str
) -> tuple[list[int], list[Fault]]:
    """The queries of the curves in scenes with a prediction: other scenes may be left out, with a warning."""
    predicted_parts = {expected.scene_part(i) for i in queries if i in predicted}
    kept = [i for i in queries if expected.scene_part(i) in predicted_parts]
    if not predicted_parts or len(kept) == len(queries):
        return queries, []
    scenes = len({expected.scene_part(i) for i in queries})
    actual = f"track {CURVES}: {len(predicted_parts)} of {scenes} scenes have predictions"
    repair = (
        "no change needed for the first scenes of the protocol alone; else all are scored, a missing row as no motion"
    )
    return kept, [file_warning(file, "partial-curves", actual, "all scenes, or some of them completely", repair)]


def _unlisted_track_faults(counts: dict[str, int], listed_tracks: Iterable[str], file: str) -> list[Fault]:
    expected, repair = "rows of listed tracks", "add the track to tracks in manifest.toml, or delete its rows"
    actual = {track: f"{n} rows of track {track}, which manifest.toml does not list" for track, n in counts.items()}
    unlisted = [track for track in counts if track not in set(listed_tracks)]
    return [file_warning(file, "unlisted-track", actual[track], expected, repair) for track in unlisted]


def _empty_track_fault(track: str, file: str) -> Fault:
    repair = f"predict it, or delete {track} from tracks in manifest.toml; else all its queries count as no motion"
    actual = f"track {track} is listed in manifest.toml and has no row"
    return file_warning(file, "empty-track", actual, "one row per query", repair)


def _track_of(query_id: str) -> str:
    """The track of an id; "" for an unusual format."""
    match = ID_FORMAT.match(query_id)
    track = (match[1] or match[2]) if match else ""
    return track if track in ALL_TRACKS else ""


def _count(values: Iterable[str]) -> dict[str, int]:
    """The number of times each value occurs, without empty ones."""
    counts: dict[str, int] = {}
    for value in values:
        if value:
            counts[value] = counts.get(value, 0) + 1
    return counts
