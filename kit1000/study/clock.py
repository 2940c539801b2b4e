"""The clock of a task, and the paper's rule: in a task of n kits an upload may start while it reads under n minutes.

The clock starts when the scene is shown. It runs while the participant specifies, and advances by the robot's own
seconds when an upload is executed; an upload that started in time runs to its end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from kit1000.errors import InputError

SECONDS_A_KIT = 60.0


def time_limit(kits: int) -> float:
    """[s] until which an upload may start."""
    if kits < 1:
        raise InputError(f"kits: expected 1 or more, got {kits}")
    return SECONDS_A_KIT * kits


@dataclass
class TaskClock:
    """Specification and execution seconds of one task."""

    kits: int
    now: Callable[[], float]
    """[s] of a clock that never goes back."""
    specification: float = 0.0
    """[s] until it was last stopped."""
    execution: float = 0.0
    """[s] of the robot."""
    _since: float | None = field(default=None, init=False)

    def start(self) -> None:
        """The participant is in charge from now on."""
        if self._since is None:
            self._since = self.now()

    def stop(self) -> None:
        """The participant is no longer in charge: the robot works, or the page is closed."""
        self.specification, self._since = self.specified, None

    @property
    def specified(self) -> float:
        """[s] for which the participant has been in charge."""
        return self.specification + (0.0 if self._since is None else self.now() - self._since)

    @property
    def reading(self) -> float:
        """[s]"""
        return self.specified + self.execution

    @property
    def left(self) -> float:
        """[s] in which an upload may still start; 0 if none may."""
        return max(time_limit(self.kits) - self.reading, 0.0)

    def may_upload(self) -> bool:
        """Whether an upload may start now."""
        return self.reading < time_limit(self.kits)

    def executed(self, seconds: float) -> None:
        """Add the seconds of the robot for an upload."""
        if not seconds >= 0:
            raise InputError(f"seconds of the robot: expected 0 or more, got {seconds}")
        self.execution += seconds
