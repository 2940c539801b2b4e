"""Types of options that several commands share: what tyro parses, and what --help calls the value."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg


def optional(type_: Any, metavar: str | None = None) -> Any:
    """The mark of an option that is None when absent: its words are parsed as a type without None.

    Its help text says what None means, so that no default is printed.
    """
    return arg(metavar=metavar, constructor=type_, help_behavior_hint="")


LengthUnit = Literal["mm", "cm", "m", "inch"]
OptionalInt = Annotated[int | None, optional(int, "N")]
OptionalFloat = Annotated[float | None, optional(float, "X")]
OptionalPath = Annotated[Path | None, optional(Path, "PATH")]
OptionalId = Annotated[str | None, optional(str, "ID")]
OptionalName = Annotated[str | None, optional(str, "NAME")]
Unit = Annotated[LengthUnit | None, optional(LengthUnit)]
Folder = Annotated[Positional[Path], arg(metavar="DATA")]
