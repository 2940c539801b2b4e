"""The command that makes kits for mesh files of the user's own."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from kit1000.cli.command_line import check_least
from kit1000.cli.options import OptionalFloat, OptionalInt, Unit, optional
from kit1000.cli.summaries import kit_report_text
from kit1000.errors import InputError

if TYPE_CHECKING:
    from kit1000.export.own_part import KitOptions


@dataclass(frozen=True)
class MakeKit:
    """Make a kit for your own part at true size: kit.stl, part.stl, seated.glb, report.json, preview.png."""

    parts: Annotated[Positional[tuple[Path, ...]], arg(metavar="PART [PART ...]")]
    """Mesh files: STL, OBJ, PLY, 3MF, GLB (and STEP with `pip install kit1000[step]`)."""
    out: Path
    """Folder to write to, new or of an earlier run; for several files it gets a folder for each."""
    clearance_mm: float = 2.5
    """Horizontal gap between part and cavity walls."""
    unit: Unit = None
    """Unit of the file. Default: guessed and reported."""
    fit_mm: OptionalFloat = None
    """Scale the part to this longest side. Default: true size."""
    bodies: Annotated[Literal["union", "largest"] | None, optional(Literal["union", "largest"])] = None
    """Treatment of several bodies in the file: all as one part (they touch or overlap), or the largest alone. Default:
    several are refused unless one holds nearly all of the volume."""
    no_preview: bool = False
    """Draw no preview.png."""
    workers: OptionalInt = None
    """Number of processes for several files. Default: one per core."""

    def run(self) -> int:
        """Make the kits and print their reports; returns 1 if a kit is not exact, or if one of several has none."""
        from kit1000.export.own_part import InexactKit, KitOptions, make_kit_from_file

        paths = list(self.parts)
        check_least(workers=(self.workers, 1))
        for name, value in (("--clearance-mm", self.clearance_mm), ("--fit-mm", self.fit_mm)):
            if value is not None and not 0.05 <= value <= 1000:
                raise InputError(f"{name}: expected 0.05 to 1000, got {value:g}")
        longest = None if self.fit_mm is None else self.fit_mm * 1e-3
        options = KitOptions(self.clearance_mm * 1e-3, self.unit, longest, self.bodies, not self.no_preview)
        if len(paths) > 1:
            return self._make_several(paths, options)
        try:
            print(kit_report_text(make_kit_from_file(paths[0], self.out, options), self.out))
            return 0
        except InexactKit as refusal:
            print(f"kit1000: {refusal}", file=sys.stderr)
            return 1

    def _make_several(self, paths: list[Path], options: KitOptions) -> int:
        """Make several kits and print each report; returns 1 if one has none."""
        from tqdm import tqdm

        from kit1000.export.own_part import make_kits

        status = 0
        made = make_kits(paths, self.out, options, self.workers)
        for name, report in tqdm(made, total=len(paths), desc="kits", unit="file", disable=None):
            if isinstance(report, str):
                tqdm.write(f"kit1000: {report}", file=sys.stderr)
                status = 1
            else:
                tqdm.write(kit_report_text(report, self.out / name), file=sys.stdout)
        return status
