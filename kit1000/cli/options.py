"""Types of options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

OptionalInt = Annotated[int | None, tyro.conf.arg(metavar="N")]
OptionalFloat = Annotated[float | None, tyro.conf.arg(metavar="X")]
OptionalPath = Annotated[Path | None, tyro.conf.arg(metavar="PATH")]
Unit = Annotated[Literal["mm", "cm", "m", "inch"] | None, tyro.conf.arg(metavar="{mm,cm,m,inch}")]
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Folder = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATA")]
