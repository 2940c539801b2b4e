"""The command `kit1000`: each subcommand is a typed dataclass whose fields are its options.

Results go to stdout, progress to stderr. Exit 0 good, 1 the answer is no, 2 wrong usage or bad input with one line.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from kit1000 import __version__
from kit1000.errors import InputError, Kit1000Error

INTERRUPTED = 130  # exit status of a command stopped by Ctrl-C, as shells have it


@dataclass(frozen=True)
class Generate:
    """Build a dataset; run the same command again to continue one that was interrupted."""

    preset: tyro.conf.Positional[str]
    """tiny, small, kit1000, paper, real-like or study."""
    out: Path
    """Folder to build in."""
    seed: int | None = None
    """Root of all draws; the preset's own when absent."""
    workers: int | None = None
    """Processes; one per core when absent. Any number gives the same bytes."""
    parts: Path | None = None
    """Folder, file or .txt list of meshes to use in place of procedural parts."""
    unit: Literal["mm", "cm", "m", "inch"] | None = None
    """Unit of those meshes; guessed and reported when absent."""

    def run(self) -> int:
        """Build, then say what came out."""
        from kit1000.data.build import generate
        from kit1000.data.presets import preset
        from kit1000.parts.sources import mesh_files

        if self.workers is not None and self.workers < 1:
            raise InputError(f"--workers: expected 1 or more, got {self.workers}")
        if self.seed is not None and self.seed < 0:
            raise InputError(f"--seed: expected 0 or more, got {self.seed}")
        sources = None if self.parts is None else mesh_files(self.parts)
        summary = generate(preset(self.preset), self.out, self.seed, self.workers, sources, self.unit)
        print(describe(summary))
        return 0


@dataclass(frozen=True)
class MakeKit:
    """A kit for your own part, true size: kit.stl and part.stl for a slicer, seated.glb, report.json, preview.png."""

    part: tyro.conf.Positional[Path]
    """Mesh file: STL, OBJ, PLY, OFF, 3MF, GLB (and STEP with `pip install kit1000[step]`)."""
    out: Path
    """Folder for the results."""
    clearance_mm: float = 2.5
    """Horizontal gap between part and walls."""
    unit: Literal["mm", "cm", "m", "inch"] | None = None
    """Unit of the file; guessed and reported when absent."""
    fit_mm: float | None = None
    """Scale the part to this longest side; true size when absent."""

    def run(self) -> int:
        """Make the kit, then print its report."""
        from kit1000.data.own_part import kit_for

        for name, value in (("--clearance-mm", self.clearance_mm), ("--fit-mm", self.fit_mm)):
            if value is not None and not 0.05 <= value <= 1000:
                raise InputError(f"{name}: expected 0.05 to 1000, got {value:g}")
        longest = None if self.fit_mm is None else self.fit_mm * 1e-3
        report = kit_for(self.part, self.out, self.clearance_mm * 1e-3, self.unit, longest)
        print(describe_kit(report, self.out))
        return 0


@dataclass(frozen=True)
class Info:
    """Describe a dataset: counts, identity, redraws."""

    data: tyro.conf.Positional[Path]
    """Dataset folder."""

    def run(self) -> int:
        """Print the summary."""
        from kit1000.data.dataset import Geometry

        print(describe(Geometry(self.data).summary))
        return 0


@dataclass(frozen=True)
class Show:
    """Draw parts, kits or assemblies of a dataset into one PNG."""

    data: tyro.conf.Positional[Path]
    """Dataset folder."""
    out: Path = Path("sheet.png")
    """Picture to write."""
    what: Literal["parts", "kits", "assemblies"] = "assemblies"
    """What to draw."""
    count: int = 24
    """How many, spread evenly over the split."""
    split: Literal["train", "val", "test"] = "test"
    """From which split."""
    ids: tuple[str, ...] = ()
    """Just these, in place of a spread."""

    def run(self) -> int:
        """Draw and write."""
        from kit1000.data.dataset import Geometry
        from kit1000.data.files import write_bytes
        from kit1000.data.sheets import contact_sheet_of

        if self.count < 1:
            raise InputError(f"--count: expected 1 or more, got {self.count}")
        write_bytes(self.out, contact_sheet_of(Geometry(self.data), self.what, self.split, self.count, self.ids))
        print(self.out)
        return 0


@dataclass(frozen=True)
class Export:
    """Write assemblies of a dataset for other tools: URDF with open cavities, or STL in millimetres."""

    data: tyro.conf.Positional[Path]
    """Dataset folder."""
    out: Path
    """Folder to write to; one folder (urdf) or file (stl) an assembly."""
    format: Literal["urdf", "stl"] = "urdf"
    """What to write."""
    ids: tuple[str, ...] = ()
    """Assemblies to write; all of them when absent."""

    def run(self) -> int:
        """Export one assembly after another."""
        from kit1000.data.dataset import Geometry
        from kit1000.data.files import write_bytes
        from kit1000.data.meshes import stl_bytes
        from kit1000.data.urdf import write_urdf

        geometry = Geometry(self.data)
        for assembly_id in self.ids or sorted(geometry.assemblies):
            assembly = geometry.assembly(assembly_id)
            if self.format == "urdf":
                write_urdf(assembly, self.out / assembly_id)
            else:
                write_bytes(self.out / f"{assembly_id}.stl", stl_bytes(assembly.mesh))
        print(self.out)
        return 0


Command = (
    Annotated[Generate, tyro.conf.subcommand("generate")]
    | Annotated[MakeKit, tyro.conf.subcommand("kit")]
    | Annotated[Info, tyro.conf.subcommand("info")]
    | Annotated[Show, tyro.conf.subcommand("show")]
    | Annotated[Export, tyro.conf.subcommand("export")]
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if list(arguments) in (["--version"], ["-V"]):
        print(f"kit1000 {__version__}")
        return 0
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # workers and locks go down in order
    command = tyro.cli(Command, prog="kit1000", description=__doc__, args=arguments)  # type: ignore[call-overload]
    try:
        return command.run()
    except Kit1000Error as error:
        print(f"kit1000: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("kit1000: interrupted; run the same command again to continue", file=sys.stderr)
        return INTERRUPTED


def describe(summary: dict) -> str:
    """A dataset's summary as text."""
    counts = [
        f"  {split:6s} {n['parts']:5d} parts and kits, {n['assemblies']:5d} assemblies"
        for split, n in summary["counts"].items()
    ]
    lines = [
        f"{summary['preset']}  {summary['dataset_id']}  (seed {summary['seed']}, data {summary['data_version']}, {summary['licence']})"
    ]
    lines += counts
    for kind, reasons in summary["redraws"].items():
        total = ", ".join(f"{n} {reason}" for reason, n in sorted(reasons.items(), key=lambda item: -item[1]))
        lines.append(f"  redrawn {kind}: {total or 'none'}")
    lines += [f"  refused {source}: {reason}" for source, reason in sorted(summary["refused"].items())]
    return "\n".join(lines)


def describe_kit(report: dict, out: Path) -> str:
    """A kit report as text."""
    size, plate = (" x ".join(f"{side:.1f}" for side in report[key]) for key in ("size_mm", "plate_mm"))
    lines = [
        f"part   {report['part']}: {size} mm ({report['unit_reason']})",
        *(f"       {note}" for note in report["repairs"]),
        f"plate  {plate} mm, cavity {report['depth_mm']:.1f} mm deep, part stands {report['proud_mm']:.1f} mm out",
        f"gap    {report['clearance_smallest_mm']:.3f} to {report['clearance_largest_mm']:.3f} mm"
        f" (asked {report['clearance_asked_mm']:g})",
        f"walls  {report['walls_removed']} too thin to print, opened ({report['walls_removed_mm3']:.0f} mm3);"
        f" undercuts {report['undercut_lost_mm3']:.0f} mm3",
    ]
    if not report["trial"]["passes"]:
        lines.append(f"note   {report['trial']['why']}")
    return "\n".join([*lines, f"files  {out}"])
