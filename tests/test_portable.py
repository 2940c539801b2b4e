"""The same plan gives the same bytes on any x86-64 processor: with another BLAS kernel, libm and numpy."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from mini import file_hashes

from bench.portable import OLD_PROCESSOR

ROOT = Path(__file__).resolve().parents[1]
GENERATE_MINI = """
import sys
from pathlib import Path
from mini import MINI
from kit1000.generation.build import generate
generate(MINI, Path(sys.argv[1]), workers=1)
"""


def test_an_older_processor_writes_the_same_bytes(mini: Path, tmp_path: Path) -> None:
    paths = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    environment = os.environ | OLD_PROCESSOR | {"PYTHONPATH": paths}
    command = [sys.executable, "-W", "ignore", "-c", GENERATE_MINI, str(tmp_path / "mini")]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    assert file_hashes(tmp_path / "mini") == file_hashes(mini)
