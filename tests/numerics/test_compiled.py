"""The cache of compiled loops: a damaged file costs a compilation, and is whole again afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from kit1000.numerics.compiled import compiled
from tests.samples.checkout import ROOT

MODULE = f"""
from {compiled.__module__} import {compiled.__name__}

@compiled
def double(x):
    return 2 * x

print(double(21), double(1.5))
print(sum(double.stats.cache_hits.values()))
"""


def run(folder: Path) -> list[str]:
    """The results of a module that uses the cache in a folder, and the number of loops that came from it."""
    (folder / "module.py").write_text(MODULE)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "module.py"], cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout.split("\n")[:2]


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
def test_a_cut_file_of_the_cache_is_made_anew(suffix: str, tmp_path: Path) -> None:
    assert run(tmp_path) == ["42 3.0", "0"]
    for path in (tmp_path / "__pycache__").glob(f"*{suffix}"):
        os.truncate(path, 10)
    assert run(tmp_path)[0] == "42 3.0"
    assert run(tmp_path) == ["42 3.0", "2"]


def test_a_cache_that_cannot_be_written_costs_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "__pycache__"
    run(tmp_path)
    for path in folder.glob("*.nbi"):
        path.unlink()
        path.mkdir()
    assert run(tmp_path)[0] == "42 3.0"
