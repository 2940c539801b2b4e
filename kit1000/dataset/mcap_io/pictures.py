"""Recordings made for looking at: one scene, all of it at one time."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

from kit1000.dataset.mcap_io.messages import Message
from kit1000.dataset.mcap_io.writing import ShardWriter


class PictureWriter(ShardWriter):
    """Writes the messages of one scene."""

    CONTENTS = "pictures"

    def __init__(self, path: str | Path, stamp: int) -> None:
        super().__init__(path)
        self._stamp = stamp

    @property
    def stamp(self) -> int:
        """The time of the scene [ns]."""
        return self._stamp

    def add(self, scene_id: str, messages: list[Message]) -> None:
        """Write the messages of the scene."""
        self.record(scene_id, sha256(b"".join(message.data for message in messages)).hexdigest(), messages)
