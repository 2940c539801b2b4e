"""The progress of a training run on stderr: a bar in a terminal, lines in a log file."""

from __future__ import annotations

import sys
import time
from types import TracebackType

from tqdm import tqdm

LINE_EVERY_S = 60.0  # [s] between two lines without a validation


class Report:
    """Shows the steps of a run; a context manager."""

    def __init__(self, shown: bool, first: int, steps: int) -> None:
        """shown: whether this process reports; first: steps done before; steps: of the whole run."""
        self.steps = steps
        self._lines = shown and not sys.stderr.isatty()
        self._last_line = time.monotonic()
        silent = None if shown else True
        self._bar = tqdm(desc="training", total=steps, initial=first, unit="step", disable=silent)

    def __enter__(self) -> Report:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._bar.close()

    def step(self, step: int, seconds: float, measured: str | None) -> None:
        """A step is done.

        Args:
            step: number of steps done.
            seconds: [s] of all calls together.
            measured: what its validation found; None without one.
        """
        self._bar.update()
        if measured is not None:
            self._bar.set_postfix_str(measured)
        if self._lines and (measured is not None or time.monotonic() - self._last_line > LINE_EVERY_S):
            self._last_line = time.monotonic()
            found = f", {measured}" if measured is not None else ""
            print(f"training: step {step} of {self.steps}, {seconds:.0f} s{found}", file=sys.stderr, flush=True)
