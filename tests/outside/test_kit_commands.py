"""The program that times `kit1000 kit` counts a whole command."""

from __future__ import annotations

from pathlib import Path

import trimesh

from bench.speed.kit_files import MADE, REFUSED, command


def test_a_command_counts_from_its_start_to_its_outcome(tmp_path: Path) -> None:
    trimesh.creation.box((30, 20, 10)).export(tmp_path / "block.stl")
    seconds, outcome = command(tmp_path / "block.stl")
    assert outcome == MADE
    assert seconds > 0.3  # imports alone take as long
    (tmp_path / "empty.stl").write_bytes(b"")
    assert command(tmp_path / "empty.stl")[1] == REFUSED
