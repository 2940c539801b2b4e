"""Predictions of a run, kept in a file beside the submission so that a killed run resumes where it stopped."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from kit1000.errors import InputError
from kit1000.files import check_writable, lock_file
from kit1000.pose import Pose
from kit1000.values import Prediction


class Journal:
    """A file with the run's settings in the first line and a prediction in each further one; locked by one run."""

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        """Continue a journal, or begin one; raises InputError if it belongs to a run with other settings.

        settings: all that the predictions depend on, as values of JSON.
        """
        self.path = path
        check_writable(path.parent)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(path, "a+", encoding="utf-8", newline="\n")  # noqa: SIM115 (closed on leaving)
        try:  # the lock ends with the process, also when it is killed
            lock_file(self._file)
            self.done = self._read_back(json.loads(json.dumps(settings)))
        except BaseException as error:
            self._file.close()
            if isinstance(error, BlockingIOError):
                raise InputError(f"{self.path} is being written by another process: wait for it") from None
            raise

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._file.close()

    def add(self, prediction: Prediction) -> None:
        """Write a prediction."""
        motion = prediction.goal_from_now
        row = [*motion.wxyz.tolist(), *motion.xyz.tolist(), prediction.confidence, prediction.seconds]
        self._write([prediction.query_id, *row])
        self.done[prediction.query_id] = prediction

    def delete(self) -> None:
        """Delete the file, once its predictions are in a submission."""
        self.path.unlink()

    def _read_back(self, settings: dict[str, Any]) -> dict[str, Prediction]:
        """The predictions in the file, by query id; a line that was not finished is cut off."""
        self._file.seek(0)
        whole, broken, _ = self._file.read().rpartition("\n")
        if not broken:
            self._file.truncate(0)
            self._write(settings)
            return {}
        self._file.truncate(len((whole + broken).encode()))
        try:
            first, *rows = map(json.loads, whole.split("\n"))
            done = {row[0]: Prediction(row[0], Pose(row[1:5], row[5:8]), *row[8:]) for row in rows}
        except (ValueError, LookupError, TypeError) as error:
            raise InputError(f"{self.path} is no journal of predictions, or damaged: delete it") from error
        if first != settings:
            key = next(key for key in settings if first.get(key) != settings[key])
            difference = f"{key} {first.get(key)!r}, now {settings[key]!r}"
            raise InputError(f"{self.path}: an unfinished run with {difference}; finish that one, or delete the file")
        return done

    def _write(self, value: Any) -> None:
        self._file.write(json.dumps(value) + "\n")
        self._file.flush()
