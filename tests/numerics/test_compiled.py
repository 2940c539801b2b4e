"""The cache of compiled loops: a damaged file costs a compilation, and is whole again afterwards."""

from __future__ import annotations

import os
import shutil
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

@compiled
def triple(x):
    return 3 * x

print(double(21), double(1.5), triple(7))
print(sum(double.stats.cache_hits.values()), sum(triple.stats.cache_hits.values()))
"""
RESULTS = "42 3.0 21"


def run(folder: Path) -> list[str]:
    """The results of a module that uses the cache in a folder, and the number of loops that came from it."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "module.py"], cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout.split("\n")[:2]


@pytest.fixture(scope="module")
def cached(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the module and a complete cache."""
    folder = tmp_path_factory.mktemp("cached")
    (folder / "module.py").write_text(MODULE)
    assert run(folder) == [RESULTS, "0 0"]
    return folder


def test_a_cut_file_of_the_cache_is_made_anew(cached: Path, tmp_path: Path) -> None:
    """The index of one loop is cut, and the code of another."""
    folder = shutil.copytree(cached, tmp_path / "copy")
    for pattern in ("*double*.nbi", "*triple*.nbc"):
        cut = list((folder / "__pycache__").glob(pattern))
        assert cut
        for path in cut:
            os.truncate(path, 10)
    assert run(folder)[0] == RESULTS
    assert run(folder) == [RESULTS, "2 1"]


def test_a_cache_that_cannot_be_written_costs_nothing_else(cached: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(cached, tmp_path / "copy")
    for path in (folder / "__pycache__").glob("*.nbi"):
        path.unlink()
        path.mkdir()
    assert run(folder)[0] == RESULTS
