"""The same plan gives the same bytes on any x86-64 processor: with another BLAS kernel and another libm."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from mini import file_hashes

ROOT = Path(__file__).resolve().parents[1]
OLD_PROCESSOR = {
    "OPENBLAS_CORETYPE": "Sandybridge",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX",
}
"""What OpenBLAS and glibc choose on a processor of 2011, which has neither AVX2 nor FMA."""
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
    command = [sys.executable, "-c", GENERATE_MINI, str(tmp_path / "mini")]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    assert file_hashes(tmp_path / "mini") == file_hashes(mini)
