"""Jobs for the tests of engines, as functions of a module, which workers can import."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

from kit1000.errors import InputError
from tests.samples.checkout import ROOT


def square(x: int) -> int:
    return x * x


def fail_at_three(x: int) -> int:
    if x == 3:
        raise ValueError("two\nlines")
    if x < 0:
        raise InputError("disk full")
    return x


def kill_own_process(x: int) -> int:
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def process_id(folder: str) -> int:
    """The id of this process, after a second process has started."""
    (Path(folder) / f"{os.getpid()}.pid").touch()
    deadline = time.monotonic() + 30
    while len(list(Path(folder).glob("*.pid"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    return os.getpid()


def sleep(_: int) -> None:
    time.sleep(60)


def nap(x: int) -> int:
    time.sleep(0.2)
    return x


def signalled(script: str, folder: Path, number: signal.Signals) -> list[int]:
    """The ids of processes that a script prints, which gets a signal after that line, and has ended on return."""
    path = folder / "script.py"
    path.write_text(script)
    run = subprocess.Popen(
        [sys.executable, str(path), str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # tests run in the background ignore Ctrl-C
    )
    assert run.stdout is not None
    ids = [int(word) for word in run.stdout.readline().split()]
    run.send_signal(number)
    run.communicate(timeout=60)
    return ids


def all_end(ids: list[int], within: float) -> bool:
    """Whether processes end within some seconds; a zombie has ended."""
    deadline = time.monotonic() + within
    while any(map(_runs, ids)) and time.monotonic() < deadline:
        time.sleep(0.05)
    return not any(map(_runs, ids))


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{process}/stat")  # only Linux has it, and there zombies are found
    return not stat.exists() or stat.read_text().rsplit(")", 1)[1].split()[0] != "Z"
