"""Do other processors write the same bytes? Generates presets twice and compares every file: `make portable`.

The second run lets OpenBLAS, glibc, numpy and PyTorch choose what they would on a processor of 2011, without AVX2 and
FMA, and compiles every loop for it. The exit status is 1 when a file differs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from numpy._core._multiarray_umath import __cpu_dispatch__  # pyright: ignore[reportAttributeAccessIssue]

from kit1000.files import sha256

OLD_PROCESSOR = {
    "OPENBLAS_CORETYPE": "Sandybridge",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX",
    "NPY_DISABLE_CPU_FEATURES": " ".join(__cpu_dispatch__),
    "ONEDNN_MAX_CPU_ISA": "SSE41",
    "ATEN_CPU_CAPABILITY": "default",
}
OLD_LOOPS = {"NUMBA_CPU_NAME": "sandybridge", "NUMBA_CPU_FEATURES": ""}
"""Apart from the others, as every loop is compiled anew for these, which takes a minute."""


def generate(preset: str, out: Path, environment: dict[str, str]) -> dict[str, str]:
    """Generate a preset; the SHA-256 of every file by name."""
    command = [sys.executable, "-W", "ignore", "-m", "kit1000", "generate", preset, "--out", str(out)]
    subprocess.run(command, env=os.environ | environment, check=True, stdout=subprocess.DEVNULL)
    files = (path for path in out.rglob("*") if path.is_file() and path.name != ".lock")
    return {path.relative_to(out).as_posix(): str(sha256(path)) for path in files}


def compare(preset: str) -> int:
    """Print which files of a preset differ; returns their number."""
    with TemporaryDirectory() as folder:
        here = generate(preset, Path(folder) / "here", {})
        there = generate(preset, Path(folder) / "there", OLD_PROCESSOR | OLD_LOOPS)
    different = sorted(name for name in here.keys() | there.keys() if here.get(name) != there.get(name))
    print(f"{preset}: {len(here)} files, {len(different)} differ", *different, sep="\n  ")
    return len(different)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("presets", nargs="+")
    sys.exit(1 if sum(map(compare, parser.parse_args().presets)) else 0)
