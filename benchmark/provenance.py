"""What stands behind a score: the commit, and a hash of every source that decides a number."""

from __future__ import annotations

import hashlib
import subprocess
from functools import cache
from pathlib import Path

import kit1000

BENCHMARK = Path(__file__).parent
LIBRARY = Path(kit1000.__file__).parent
UNKNOWN = "unknown"
DIGITS = 16  # of the hash of the evaluator

EVALUATOR = (
    (
        BENCHMARK,
        (
            "breakdown.py", "curves.py", "intervals.py", "measure.py", "per_query.py", "protocol.py", "score.py",
            "summary.py", "truths.py", "protocols/*.json",
        ),
    ),
    (
        LIBRARY,
        (
            "metrics/*.py", "kits/seating.py", "kits/contact.py", "pose.py", "rng.py", "mesh.py",
            "data/making/guesses.py",
        ),
    ),
)  # fmt: skip
"""By folder, the sources that decide a number of scores.json; what only draws or writes it is left out."""


@cache
def evaluator() -> str:
    """A hash of the sources that decide scores: equal hashes score alike."""
    digest = hashlib.sha256()
    for folder, patterns in EVALUATOR:
        for path in sorted({path for pattern in patterns for path in folder.glob(pattern)}):
            name = f"{folder.name}/{path.relative_to(folder).as_posix()}".encode()
            digest.update(name + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:DIGITS]


@cache
def commit() -> str:
    """The commit of this checkout, with `-dirty` behind it when its code was changed since; `unknown` outside one."""
    said = _git("rev-parse", "--show-prefix", "HEAD")
    if said is None:
        return UNKNOWN
    prefix, _, head = said.partition("\n")
    if prefix:  # a checkout of something else holds this folder
        return UNKNOWN
    beside = [LIBRARY.name] if LIBRARY.parent == BENCHMARK.parent else []  # or the library is installed
    changed = _git("status", "--porcelain", "--", BENCHMARK.name, *beside)
    return head.strip() + ("-dirty" if changed else "")


def _git(*words: str) -> str | None:
    """What git says of this checkout; None where there is no git, or no checkout."""
    try:
        done = subprocess.run(["git", *words], cwd=BENCHMARK.parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout
