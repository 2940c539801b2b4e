"""The same plan gives the same bytes on any x86-64 processor: with another BLAS kernel, libm and numpy."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bench.outside.portable import OLD_PROCESSOR
from kit1000.queries.guesses import draw_direction, draw_tilt_error
from tests.samples.checkout import ROOT
from tests.samples.mini import file_hashes
from tests.sim.test_world import SHAPES, drops, part_of

GENERATE_MINI = """
import sys
from pathlib import Path
from tests.samples.mini import MINI
from kit1000.generation.build import generate
generate(MINI, Path(sys.argv[1]), workers=2)
"""


def on_an_older_processor(code: str, *arguments: str) -> str:
    """What Python code prints there."""
    paths = str(ROOT)
    environment = os.environ | OLD_PROCESSOR | {"PYTHONPATH": paths}
    command = [sys.executable, "-W", "ignore", "-c", code, *arguments]
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout


@pytest.mark.slow
def test_two_workers_on_an_older_processor_write_the_same_bytes_as_one_here(mini: Path, tmp_path: Path) -> None:
    on_an_older_processor(GENERATE_MINI, str(tmp_path / "mini"))
    assert file_hashes(tmp_path / "mini") == file_hashes(mini)


def roller_poses() -> str:
    """The rest poses of rollers, which amplify differences most: without rounding, two of three would differ."""
    poses = [rest.world_from_part for rest in drops(part_of(SHAPES["roller"]()), 6)]
    return " ".join(pose.wxyz.tobytes().hex() + pose.xyz.tobytes().hex() for pose in poses)


def drawn_errors() -> str:
    """Errors of guesses: sine and cosine differ in the last bit of one number in 1,400."""
    rng = np.random.default_rng(0)
    rows = [np.concatenate([draw_direction(rng), *draw_tilt_error(rng)]) for _ in range(5000)]
    return np.stack(rows).tobytes().hex()


@pytest.fixture(scope="module")
def lines_there() -> list[str]:
    """Poses and errors there, a line each."""
    code = "from tests.outside import test_portable as here; print(here.roller_poses()); print(here.drawn_errors())"
    return on_an_older_processor(code).splitlines()


def test_parts_settle_alike_on_an_older_processor(lines_there: list[str]) -> None:
    assert lines_there[0].split() == roller_poses().split()


def test_guesses_are_drawn_alike_on_an_older_processor(lines_there: list[str]) -> None:
    assert lines_there[1] == drawn_errors()
