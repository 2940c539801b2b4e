"""What a session leaves: an event log that can be replayed, and a submission with the confirmed parts.

Every operation is a line of events.jsonl, flushed to the disk before the page answers. The same command again reads
them back: a crash, a reload or a closed laptop loses nothing. A line that was cut off is dropped.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from kit1000.dataset.json_rows import pose_of, pose_row
from kit1000.dataset.reader import Dataset
from kit1000.editor.keys import Interface
from kit1000.editor.session import PartEdit, Session
from kit1000.errors import InputError
from kit1000.queries.tracks import TRACKS
from kit1000.submission import Manifest, Predictions, read_submission, write_submission
from kit1000.submission import manifest as manifests
from kit1000.submission.predictions import NOT_MEASURED
from kit1000.values import Prediction, Query

FILE = "events.jsonl"
METHOD = "edit"
Sink = Callable[[dict[str, Any]], None]
"""Takes an event."""
LABELS: Mapping[Interface, str] = {"scene": "Scene editing", "hand": "Hand control", "hand-bare": "Hand control, bare"}
MILLISECOND = 3  # decimals of a time


@dataclass(frozen=True)
class Header:
    """What a log is about; the same for all events of a scene."""

    dataset_id: str
    scene: str
    sensor: str
    truth: bool  # whether the page shows true shapes
    snap: str  # the method that snaps
    interface: Interface
    shapes: bool = False  # whether shapes of the scene are known, by the user or the dataset

    def key(self) -> tuple[str, str]:
        """Events with the same belong to one session."""
        return self.scene, self.sensor


class EventLog:
    """The events of all scenes edited into one folder."""

    def __init__(
        self, folder: Path, header: Header, clock: Callable[[], float] = time.time, sink: Sink | None = None
    ) -> None:
        """Open or begin the log. Raises InputError if the folder holds events of another dataset or kind.

        clock: [s]. sink: called with each event that is added, after it is written.
        """
        self.path, self.header, self._clock, self._sink = folder / FILE, header, clock, sink
        rows = _rows(self.path)
        self.rows = [row for row in rows if (row["scene"], row["sensor"]) == header.key()]
        for row in rows:
            for name in ("dataset_id", "truth", "interface", "shapes"):
                if row.get(name, False) != getattr(header, name):  # older logs know no shapes
                    text = f"{name} {row.get(name, False)}, not {getattr(header, name)}; choose another --out"
                    raise InputError(f"{self.path}: holds events of {text}")
        _drop_cut_line(self.path)

    def restored(self, edited: tuple[int, ...]) -> Session:
        """The session as the log has it, also of parts that the page does not show yet. edited: what has edits."""
        logged = {int(part) for row in self.rows for part in row.get("edits", ())}
        session = Session.begin((*edited, *(logged - {*edited})))
        for row in self.rows:
            session = _applied(session, row)
        return session

    def add(self, event: str, **values: Any) -> None:
        """Write an event."""
        row = {"time": round(self._clock(), MILLISECOND), "event": event, **self.header.__dict__, **values}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with open(self.path, "a", encoding="utf-8") as file:
            file.write(json.dumps(row, sort_keys=True, allow_nan=False) + "\n")
            file.flush()
            os.fsync(file.fileno())
        if self._sink is not None:
            self._sink(row)

    def did(self, session: Session) -> None:
        """Write the latest operation of a session."""
        operation = session.done[-1]
        edits = {str(part): _edit_row(change.after) for part, change in operation.changes.items()}
        self.add("do", name=operation.name, edits=edits)


def write_predictions_of(
    folder: Path, dataset: Dataset, header: Header, queries: Mapping[str, Query], session: Session
) -> int:
    """Write the confirmed parts of a scene into the submission in a folder, beside those of other scenes.

    queries: by id, those that the edits answer. Returns the number of predictions of this scene.
    """
    own = [
        Prediction(query.id, edit.goal_from_now, edit.confidence, NOT_MEASURED)
        for query in queries.values()
        if (edit := session.edits.get(query.part)) is not None and edit.confirmed
    ]
    others = _other_predictions(folder, queries)
    if not own and not others:
        for name in (manifests.FILE, "predictions.csv"):
            (folder / name).unlink(missing_ok=True)
        return 0
    predictions = sorted([*others, *own], key=lambda prediction: prediction.query_id)
    ids = [prediction.query_id for prediction in predictions]
    tracks = tuple(track for track in TRACKS if any(query_id.endswith(f"-{track}") for query_id in ids))
    write_submission(folder, _manifest(dataset, header, tracks), Predictions.of(predictions))
    return len(own)


def _manifest(dataset: Dataset, header: Header, tracks: tuple[str, ...]) -> Manifest:
    snap = "without snapping" if header.snap == "none" else f"snapped by {header.snap}"
    shown = " True shapes were shown." if header.truth else ""
    return Manifest(
        method=METHOD,
        label=LABELS[header.interface],
        authors=("The person at the page",),
        description=f"Parts placed in the page of kit1000 edit ({header.interface}), {snap}.{shown}",
        date=date.today().isoformat(),
        dataset_id=dataset.id,
        dataset_checksum=dataset.summary.get("checksum", ""),
        tracks=tracks,
        learned=False,
        uses_true_geometry=header.truth,
        reads="shapes" if header.shapes else "image",
    )


def _other_predictions(folder: Path, own: Mapping[str, Query]) -> list[Prediction]:
    """What the folder holds about other queries."""
    if not (folder / manifests.FILE).is_file():
        return []
    submission = read_submission(folder)
    if submission.manifest.method != METHOD:
        raise InputError(f"{folder}: holds predictions of {submission.manifest.method}; choose another --out")
    table = submission.predictions
    rows = zip(table.query_ids, table.motions, table.confidence.tolist(), table.seconds.tolist(), strict=True)
    return [Prediction(*row) for row in rows if row[0] not in own]


def _applied(session: Session, row: Mapping[str, Any]) -> Session:
    event = row["event"]
    if event == "do":
        return session.did(row["name"], {int(part): _edit_of(edit) for part, edit in row["edits"].items()})
    if event == "undo":
        return session.undo()
    return session.redo() if event == "redo" else session


def _edit_row(edit: PartEdit) -> dict[str, Any]:
    flags = {name: getattr(edit, name) for name in ("snapped", "confidence", "turned", "confirmed")}
    return {"goal_from_now": pose_row(edit.goal_from_now), **flags}


def _edit_of(row: Mapping[str, Any]) -> PartEdit:
    flags = {name: row[name] for name in ("snapped", "confidence", "turned", "confirmed")}
    return PartEdit(pose_of(row["goal_from_now"]), **flags)


def _rows(path: Path) -> list[dict[str, Any]]:
    """The events of a file; raises InputError for a damaged line that is not the last."""
    if not path.is_file():
        return []
    rows = []
    for number, line in enumerate(path.read_bytes().splitlines(keepends=True), start=1):
        try:
            rows.append(json.loads(line))
        except ValueError as error:
            if line.endswith(b"\n"):
                raise InputError(f"{path}:{number}: no JSON ({error}); mend or remove the line") from None
    return rows


def _drop_cut_line(path: Path) -> None:
    """Remove a last line without its end, which a crash has left."""
    if not path.is_file():
        return
    data = path.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if whole != data:
        with open(path, "rb+") as file:
            file.truncate(len(whole))
