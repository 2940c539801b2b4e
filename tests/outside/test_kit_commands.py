"""Programs that time `kit1000 kit`: the functions that they replace exist, and a whole command is counted."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest
import trimesh

from bench.speed.kit_files import MADE, REFUSED, command
from bench.speed.kit_profile import STAGES


@pytest.mark.parametrize(("module", "name"), [place for places in STAGES.values() for place in places])
def test_a_profiled_function_stands_where_its_callers_find_it(module: str, name: str) -> None:
    assert callable(getattr(import_module(module), name))


def test_a_command_counts_from_its_start_to_its_outcome(tmp_path: Path) -> None:
    trimesh.creation.box((30, 20, 10)).export(tmp_path / "block.stl")
    seconds, outcome = command(tmp_path / "block.stl")
    assert outcome == MADE
    assert seconds > 0.3  # imports alone take as long
    (tmp_path / "empty.stl").write_bytes(b"")
    assert command(tmp_path / "empty.stl")[1] == REFUSED
