"""The handler of SIGTERM: an interrupt while a command runs, and after it what it was before."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import pytest

from kit1000.cli.command_line import INTERRUPTED, run
from kit1000.interrupts import keeping_sigterm, terminated_as_interrupted


@pytest.fixture(autouse=True)
def unharmed() -> Iterator[None]:
    """The handler of the tests is the same after each of them."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    assert signal.getsignal(signal.SIGTERM) is before


@dataclass
class Quiet:
    """A command that does nothing."""

    def run(self) -> int:
        return 0


@dataclass
class Terminated:
    """A command that is asked to end."""

    def run(self) -> int:
        os.kill(os.getpid(), signal.SIGTERM)
        return 0


def test_a_command_in_this_process_leaves_the_handler_as_it_was(capsys: pytest.CaptureFixture[str]) -> None:
    """Else a pool forked later would hang about one time in ten: SIGTERM would interrupt its workers, not end them."""
    before = signal.getsignal(signal.SIGTERM)
    assert run("tool", {"quiet": Quiet}, "A tool.", ["quiet"]) == 0
    assert signal.getsignal(signal.SIGTERM) is before
    assert run("tool", {"terminated": Terminated}, "A tool.", ["terminated"]) == INTERRUPTED
    assert capsys.readouterr().err == "tool: interrupted; run the same command again to continue\n"


def test_sigterm_interrupts_within_the_block_alone() -> None:
    with pytest.raises(KeyboardInterrupt), terminated_as_interrupted():
        os.kill(os.getpid(), signal.SIGTERM)


def _ignore_and_fail() -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise ValueError("from the block")


def test_a_handler_set_in_the_block_is_replaced_by_the_one_before() -> None:
    with pytest.raises(ValueError, match="from the block"), keeping_sigterm():
        _ignore_and_fail()


def test_a_thread_runs_a_command_without_touching_the_handler() -> None:
    before = signal.getsignal(signal.SIGTERM)

    def seen() -> object:
        with terminated_as_interrupted():
            return signal.getsignal(signal.SIGTERM)

    with ThreadPoolExecutor(1) as threads:
        assert threads.submit(seen).result() is before
        assert threads.submit(run, "tool", {"quiet": Quiet}, "A tool.", ["quiet"]).result() == 0
