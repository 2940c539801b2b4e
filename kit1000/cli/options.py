"""Options of commands: how a field of a command is typed, and types that several commands share.

The annotations are ours, so that a command starts without the package that prints --help.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal


@dataclass(frozen=True)
class Argument:
    """How a field is given on the command line."""

    metavar: str
    """What --help calls its value."""
    positional: bool = False
    """Whether it is given by its place, without its name."""


OptionalInt = Annotated[int | None, Argument("N")]
OptionalFloat = Annotated[float | None, Argument("X")]
OptionalPath = Annotated[Path | None, Argument("PATH")]
Unit = Annotated[Literal["mm", "cm", "m", "inch"] | None, Argument("{mm,cm,m,inch}")]
Folder = Annotated[Path, Argument("DATA", positional=True)]
