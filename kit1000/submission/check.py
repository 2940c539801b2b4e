"""Checking a submission: every fault of its two files, by themselves or against what a dataset asks."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kit1000.submission import manifest as manifests
from kit1000.submission import predictions as answers
from kit1000.submission.faults import Fault, Report, in_order, named, printable
from kit1000.submission.form import form_faults
from kit1000.submission.manifest import Manifest, line_of, manifest_of
from kit1000.submission.reading import aside, file_bytes, text_of, whole
from kit1000.submission.rows import Rows, read_rows
from kit1000.submission.suspicions import suspicions
from kit1000.tracks import ALL_TRACKS, CURVES

if TYPE_CHECKING:
    from kit1000.submission.asked import Asked

USUAL_ID = re.compile(r"(?:(?:train|val|test)-s\d+-p\d+-([a-z0-9-]+)|(curves)-s\d+-p\d+-[a-z0-9-]+)\Z")
MOST_LOOKED_UP = 20  # unknown ids for which near ones are looked for thoroughly


def check(path: str | Path, data: str | Path | None = None, split: str = "test") -> Report:
    """Find every fault of a submission folder, or of a predictions file alone.

    Args:
        path: the folder with manifest.toml and predictions.csv, or one predictions file.
        data: the dataset it answers; without it the form alone is checked. No truth is read.
        split: whose queries are to be answered: test (those drawn, and the curves if claimed), test-all, val or train.

    Raises:
        InputError: when the dataset cannot be read. The submission may be anything.
    """
    place = Path(path)
    manifest, rows, faults, read = _read(place)
    asked = None if data is None else _asked(Path(data), split, rows)
    if manifest is not None and asked is not None:
        faults += _dataset_faults(manifest, asked, place / manifests.FILE)
    if rows is not None:
        file = rows.file
        claims = None if manifest is None else manifest.tracks
        faults += _asked_faults(rows, asked) if asked else _usual_faults(rows)
        faults += _claim_faults(rows, claims, file) if asked is None else _coverage_faults(rows, claims, asked, file)
        faults += suspicions(rows, asked, manifest is not None and manifest.predicts == "rotation")
    return Report(printable(place), in_order(faults), read, asked is not None)


def _asked(data: Path, split: str, rows: Rows | None) -> Asked:
    from kit1000.submission.asked import asked_of  # with it comes the reader of datasets, which takes a second

    return asked_of(data, split, () if rows is None else rows.query_ids)


def _read(place: Path) -> tuple[Manifest | None, Rows | None, list[Fault], int]:
    """The two files as far as they can be read, all that is wrong with their form, and the number of rows."""
    manifest, faults = None, []
    if _is_folder(place):
        manifest, faults = manifest_of(place / manifests.FILE, manifests.FILE)
        place = place / answers.FILE
        file = answers.FILE
    else:
        file = printable(place)
    if place.name == manifests.FILE:
        seen, wanted = "is a manifest alone", "the folder of a submission, or its predictions file"
        return None, None, [whole(file, "manifest-alone", seen, wanted, "give the folder around it")], 0
    data, more = file_bytes(place, file)
    text, found = (None, []) if data is None else text_of(data, file)
    rows, rest = (None, []) if text is None else read_rows(text, file)
    faults += [*more, *found, *rest]
    if rows is None:
        return manifest, None, faults, 0
    faults += form_faults(rows)
    if len(rows) == 0:
        faults.append(whole(file, "no-rows", "has no row that can be read", "a row a query", "write the predictions"))
    return manifest, rows, faults, len(rows)


def _is_folder(place: Path) -> bool:
    try:
        return place.is_dir()
    except (OSError, ValueError, RuntimeError):  # links in a circle, a NUL in the path
        return False


def _dataset_faults(manifest: Manifest, asked: Asked, path: Path) -> list[Fault]:
    """Whether the manifest speaks of this dataset."""
    file, faults = manifests.FILE, []
    text = path.read_text("utf-8", "replace")

    def add(name: str, field: str, seen: str, wanted: str, repair: str, kind: str) -> None:
        line = line_of(field, text)
        faults.append(Fault(file, line, None, seen, wanted, repair, "error" if kind == "error" else "warning", name))

    if manifest.dataset_id != asked.dataset_id:
        seen = f'dataset_id = "{printable(manifest.dataset_id)}"'
        repair = "check against the dataset that was answered, or answer this one"
        add("foreign-dataset", "dataset_id", seen, f'"{asked.dataset_id}", that of --data', repair, "error")
    told = manifest.dataset_checksum
    if told and asked.checksum and told != asked.checksum:
        seen = f'dataset_checksum = "{printable(told)}"'
        wanted = f'"{asked.checksum}": the same plan, built on another machine'
        repair = "nothing need be done: kit1000 verify says how far the two agree"
        add("other-bytes", "dataset_checksum", seen, wanted, repair, "warning")
    for track in manifest.tracks:
        if track not in set(asked.tracks):
            has = ", ".join(track for track in ALL_TRACKS if track in set(asked.tracks))
            add("no-such-track", "tracks", f'tracks has "{track}"', f"some of {has}", f"delete {track}", "error")
    return faults


def _usual_faults(rows: Rows) -> list[Fault]:
    """Ids that no dataset of ours has, as far as that can be seen without one."""
    odd = [i for i, query_id in enumerate(rows.query_ids) if query_id and not _track(query_id)]
    if not odd:
        return []
    seen = f"{len(odd)} ids are of an unusual form ({named((rows.query_ids[i] for i in odd), len(odd))})"
    repair = "copy the ids as the dataset has them"
    return [aside(rows.file, "unusual-ids", printable(seen[:300]), "ids such as test-s0007-p2-snap", repair)]


def _asked_faults(rows: Rows, asked: Asked) -> list[Fault]:
    """Ids that the dataset does not have."""
    faults = []
    for i, query_id in enumerate(rows.query_ids):
        if query_id and query_id not in asked.index:
            near = asked.near(query_id, thoroughly=len(faults) < MOST_LOOKED_UP)
            repair = (
                f"did you mean {near}?" if near else "delete the row, or check against the dataset that was answered"
            )
            faults.append(rows.fault(i, "query_id", "unknown-id", "the id of a query of this dataset", repair))
    return faults


def _claim_faults(rows: Rows, claims: Iterable[str] | None, file: str) -> list[Fault]:
    """Tracks that are claimed without a row, or answered without a claim, by the look of the ids."""
    if claims is None:
        return []
    counts = _counts(_track(query_id) for query_id in rows.query_ids)
    empty = [_no_rows(track, file) for track in claims if track not in counts] if len(rows) else []
    return [*empty, *_unclaimed(counts, claims, file)]


def _coverage_faults(rows: Rows, claims: Iterable[str] | None, asked: Asked, file: str) -> list[Fault]:
    """Queries without a row, by track, and rows that nobody asks for."""
    held = [asked.index[query_id] for query_id in rows.query_ids if query_id in asked.index]
    answered = set(held)
    counts = _counts(asked.tracks[i] for i in held if asked.wanted[i])
    claimed = [track for track in ALL_TRACKS if track in (counts if claims is None else claims)]
    faults: list[Fault] = []
    for track in claimed:
        queries = [i for i, of in enumerate(asked.tracks) if of == track and asked.wanted[i]]
        if track == CURVES:
            queries, left_out = _thinned(queries, answered, asked, file)
            faults += left_out
        missing = [asked.query_ids[i] for i in queries if i not in answered]
        if missing:
            seen = (
                f"track {track}: {len(missing)} of {len(queries)} queries have no row ({named(missing, len(missing))})"
            )
            repair = "add them; a query without a row counts as a part that is not moved"
            faults.append(whole(file, "missing", seen, "a row a query", repair))
    checked = {asked.splits[i] for i in np.flatnonzero(asked.wanted)}
    others = _counts(asked.splits[i] for i in held if asked.splits[i] not in checked)
    for split, count in others.items():
        seen = f"{count} rows of the split {split}"
        repair = f"nothing need be done: they are not looked at; --split {split} checks them"
        faults.append(aside(file, "other-split", seen, "rows of the split that is checked", repair))
    return [*faults, *([] if claims is None else _unclaimed(counts, claims, file))]


def _thinned(queries: list[int], answered: set[int], asked: Asked, file: str) -> tuple[list[int], list[Fault]]:
    """The queries of the curves in scenes of which any is answered: whole scenes may be left out of curves."""
    held = {asked.part(i) for i in queries if i in answered}
    kept = [i for i in queries if asked.part(i) in held]
    if not held or len(kept) == len(queries):
        return queries, []
    scenes = len({asked.part(i) for i in queries})
    seen = f"track {CURVES}: {len(held)} of {scenes} scenes are answered"
    repair = "nothing need be done: the curves are drawn of these and say how many they are"
    return kept, [aside(file, "thinned", seen, "all scenes, or some of them whole", repair)]


def _unclaimed(counts: dict[str, int], claims: Iterable[str], file: str) -> list[Fault]:
    repair = "add the track to tracks in manifest.toml, or leave out its rows"
    return [
        aside(file, "unclaimed", f"{n} rows of track {track}, which is not claimed", "rows of claimed tracks", repair)
        for track, n in counts.items()
        if track not in set(claims)
    ]


def _no_rows(track: str, file: str) -> Fault:
    repair = f"predict it, or take {track} out of tracks in manifest.toml"
    return whole(file, "empty-track", f"track {track} is claimed and has no row", "a row a query", repair)


def _track(query_id: str) -> str:
    """The track that an id names; "" when it is of no usual form."""
    match = USUAL_ID.match(query_id)
    track = (match[1] or match[2]) if match else ""
    return track if track in ALL_TRACKS else ""


def _counts(values: Iterable[str]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for value in values:
        if value:
            counts[value] = counts.get(value, 0) + 1
    return counts
