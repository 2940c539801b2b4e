"""Which frames of a recording make an image."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Selection:
    """Which frames of the sources."""

    frames: int = 1
    """Number of frames of which an image is the median."""
    first: int = 0
    """Index of the first one in a recording."""
    topic: str | None = None
    """Topic of the depth images in a recording; None: the only one."""
