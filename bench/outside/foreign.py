"""Checks by programs that are not ours: running one, and a line for each check."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from kit1000.cli import main

SECONDS = 900  # a program that takes longer hangs


def run(command: Sequence[str | Path], environment: Mapping[str, str] = {}) -> tuple[int, str]:
    """The exit status and the output of a program, errors included; 124 when it takes longer than SECONDS."""
    words = [str(word) for word in command]
    try:
        done = subprocess.run(
            words, env=os.environ | environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=SECONDS
        )
    except FileNotFoundError:
        return 127, f"no program {words[0]}"
    except subprocess.TimeoutExpired:
        return 124, f"{words[0]} took more than {SECONDS} s"
    return done.returncode, done.stdout.decode("utf-8", "replace")


class Report:
    """Prints a line for each check and counts the failed ones."""

    def __init__(self) -> None:
        self.failed = 0

    def line(self, what: str, fault: str | None = None) -> None:
        """Report a check: good without a fault, which is one line."""
        self.failed += fault is not None
        print(f"ok     {what}" if fault is None else f"FAILED {what}: {fault}", flush=True)


def kit1000(*words: str | Path) -> None:
    """Run a command of kit1000 without what it prints; ends this program when it fails, with the line that it gave."""
    with redirect_stdout(StringIO()):
        status = main([str(word) for word in words])
    if status:
        sys.exit(status)


def dataset_of(data: Path | None, scratch: Path) -> Path:
    """The dataset to check: `data` where it is one, else a tiny one that is generated below `scratch`."""
    if data is not None and (data / "dataset.json").is_file():
        return data
    kit1000("generate", "tiny", "--out", scratch / "tiny")
    return scratch / "tiny"


def tail(text: str) -> str:
    """The last line of an output with words in it."""
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "no output")
