"""What a score depends on: the commit, and a hash of the sources that scoring imports."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

import kit1000
from kit1000.prediction.imported_sources import hash_of, imported_modules

BENCHMARK = Path(__file__).parent
LIBRARY = Path(kit1000.__file__).parent
ENTRY = "benchmark.score"  # the evaluator is this module and all it imports
PROTOCOLS = "protocols/*.json"
UNKNOWN = "unknown"
DIGITS = 16  # of the hash of the evaluator


@cache
def evaluator(benchmark: Path = BENCHMARK, library: Path = LIBRARY) -> str:
    """A hash of the protocols and of the sources that scoring imports: equal hashes give equal scores.

    Args:
        benchmark: folder of the package `benchmark`.
        library: folder of the package `kit1000`.
    """
    files = {f"benchmark/{path.relative_to(benchmark).as_posix()}": path for path in benchmark.glob(PROTOCOLS)}
    return hash_of(files | evaluator_modules(benchmark, library))[:DIGITS]


def evaluator_modules(benchmark: Path = BENCHMARK, library: Path = LIBRARY) -> dict[str, Path]:
    """The modules of `benchmark` and `kit1000` that `benchmark.score` imports, directly or not, and their files.

    Imports inside functions count too; those for type checkers alone do not.
    """
    return imported_modules([ENTRY], {"benchmark": benchmark, "kit1000": library})


@cache
def commit() -> str:
    """The commit of this checkout, followed by `-dirty` if its code was changed since; `unknown` outside one."""
    head = _git("rev-parse", "--show-prefix", "HEAD")
    if head is None:
        return UNKNOWN
    prefix, _, head = head.partition("\n")
    if prefix:  # a checkout of something else holds this folder
        return UNKNOWN
    library = [LIBRARY.name] if LIBRARY.parent == BENCHMARK.parent else []  # or it is installed elsewhere
    changed = _git("status", "--porcelain", "--", BENCHMARK.name, *library)
    return head.strip() + ("-dirty" if changed else "")


def _git(*words: str) -> str | None:
    """The output of git in this checkout; None if there is no git or no checkout."""
    try:
        done = subprocess.run(["git", *words], cwd=BENCHMARK.parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout
