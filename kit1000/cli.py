"""The command `kit1000`: each subcommand is a typed dataclass whose fields are its options.

Results go to stdout, progress to stderr. Exit 0 good, 1 the answer is no, 2 wrong usage or bad input with one line,
3 a fault of the package, 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from kit1000 import __version__
from kit1000.errors import InputError
from kit1000.usage import run

if TYPE_CHECKING:
    from kit1000.generation.plan import Sources
    from kit1000.generation.presets import Preset

LISTED = 20  # refused files in a description
ABOUT = """KIT1000: parts, kits that fit them, angled assemblies of kits, and scenes to learn assembly from.

`kit1000 COMMAND --help` says more about a command, `kit1000 --version` which version this is.

Results go to stdout, progress to stderr. Exit status: 0 good, 1 the answer is no,
2 wrong usage or bad input, 3 a fault of kit1000 itself, 130 interrupted."""

Whole = Annotated[int | None, tyro.conf.arg(metavar="N")]
Number = Annotated[float | None, tyro.conf.arg(metavar="X")]
Optional = Annotated[Path | None, tyro.conf.arg(metavar="PATH")]
Unit = Annotated[Literal["mm", "cm", "m", "inch"] | None, tyro.conf.arg(metavar="{mm,cm,m,inch}")]
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Folder = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATA")]


@dataclass(frozen=True)
class Generate:
    """Build a dataset; run the same command again to continue one that was interrupted."""

    preset: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="PRESET")]
    """tiny, small, kit1000, paper, real-like or study."""
    out: Annotated[str, tyro.conf.arg(metavar="PATH")]
    """Folder to build in; with --engine ray also an address such as s3://bucket/folder."""
    seed: Whole = None
    """Root of all draws; the preset's own when absent."""
    workers: Whole = None
    """Processes; one per core when absent. Any number gives the same bytes."""
    parts: Optional = None
    """Folder, file or .txt list of meshes to use in place of procedural parts."""
    unit: Unit = None
    """Unit of those meshes; guessed and reported when absent."""
    engine: Literal["local", "ray"] = "local"
    """What spreads the work: processes of this machine, or Ray."""
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None
    """Ray cluster to work on (`auto` finds the one of this machine); a new local one when absent."""
    withhold: Optional = None
    """Second folder: the whole dataset is built there, and --out gets all but the answers of the test split."""

    def run(self) -> int:
        """Build, then say what came out."""
        from kit1000.generation.presets import preset

        chosen = preset(self.preset)
        if self.workers is not None and self.workers < 1:
            raise InputError(f"--workers: expected 1 or more, got {self.workers}")
        if self.seed is not None and self.seed < 0:
            raise InputError(f"--seed: expected 0 or more, got {self.seed}")
        if self.unit is not None and self.parts is None:
            raise InputError("--unit: says how to read the meshes of --parts, which is absent")
        from kit1000.files import folder

        out = folder(self.out)
        summary = self._built(chosen, out) if self.withhold is None else self._published(chosen, out, self.withhold)
        print(describe(summary))
        return 0

    def _built(self, chosen: Preset, out: Path, seed: int | None = None) -> dict[str, Any]:
        """The dataset in a folder, whole."""
        from kit1000.engines import engine as engine_of
        from kit1000.generation.build import generate

        engine = engine_of(self.engine, self.workers, self.address)
        return generate(chosen, out, self.seed if seed is None else seed, self.workers, self._sources(out), engine)

    def _published(self, chosen: Preset, out: Path, whole: Path) -> dict[str, Any]:
        """The dataset in a second folder, and what may be seen of it in --out."""
        from kit1000.generation.withhold import check_separate, publish, secret_seed

        check_separate(out, whole)
        self._built(replace(chosen, curve_scenes=0), whole, secret_seed(whole, self.seed))
        return publish(whole, out)

    def _sources(self, built: Path) -> Sources | None:
        """The mesh files asked for, without those that this command itself writes."""
        from kit1000.generation.plan import Sources
        from kit1000.parts.files.sources import mesh_files

        if self.parts is None:
            return None
        ours = {built.resolve(), Path(self.out).resolve()}
        files = [file for file in mesh_files(self.parts) if ours.isdisjoint(file.resolve().parents)]
        if not files:
            raise InputError(f"{self.parts}: no mesh files but those in --out {built}")
        return Sources.of(files, self.unit)


@dataclass(frozen=True)
class MakeKit:
    """A kit for your own part, true size: kit.stl and part.stl for a slicer, seated.glb, report.json, preview.png."""

    part: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PART")]
    """Mesh file: STL, OBJ, PLY, OFF, 3MF, GLB (and STEP with `pip install kit1000[step]`)."""
    out: Path
    """Folder for the results."""
    clearance_mm: float = 2.5
    """Horizontal gap between part and walls."""
    unit: Unit = None
    """Unit of the file; guessed and reported when absent."""
    fit_mm: Number = None
    """Scale the part to this longest side; true size when absent."""

    def run(self) -> int:
        """Make the kit, then print its report."""
        from kit1000.export.own_part import kit_for

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

    data: Folder
    """Dataset folder."""

    def run(self) -> int:
        """Print the summary."""
        from kit1000.dataset.geometry import Geometry

        print(describe(Geometry(self.data).summary))
        return 0


@dataclass(frozen=True)
class Show:
    """Draw parts, kits or assemblies of a dataset, or one of its scenes, into one PNG."""

    data: Folder
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
    scene: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """A scene to draw in place of a sheet: depth, masks, meshes and goals."""

    def run(self) -> int:
        """Draw and write."""
        from kit1000.dataset.geometry import Geometry
        from kit1000.dataset.reader import Dataset
        from kit1000.files import write_bytes
        from kit1000.pictures.dataset_sheets import contact_sheet_of, scene_sheet

        if self.count < 1:
            raise InputError(f"--count: expected 1 or more, got {self.count}")
        if self.scene is not None:
            write_bytes(self.out, scene_sheet(Dataset(self.data), self.scene))
            print(self.out)
            return 0
        write_bytes(self.out, contact_sheet_of(Geometry(self.data), self.what, self.split, self.count, self.ids))
        print(self.out)
        return 0


@dataclass(frozen=True)
class Verify:
    """Check every file of a dataset, and build a sample of its scenes again to compare."""

    data: Folder
    """Dataset folder."""
    sample: int = 4
    """Scenes to build again from the plan."""

    def run(self) -> int:
        """Check, then say what was found; 1 when something is wrong."""
        from kit1000.generation.verify import verify

        if self.sample < 0:
            raise InputError(f"--sample: expected 0 or more, got {self.sample}")
        found = verify(self.data, self.sample)
        for line in found.faults:
            print(line)
        rebuilt = ", ".join(found.rebuilt) or "none"
        print(f"{found.files} files checked, {len(found.rebuilt)} scenes built again ({rebuilt})")
        print(*(f"note: {note}" for note in found.notes), sep="\n", end="\n" if found.notes else "")
        print(f"faults: {len(found.faults)}" if found.faults else "all is as it was made")
        return 1 if found.faults else 0


@dataclass(frozen=True)
class Export:
    """Write assemblies for other tools (URDF with open cavities, STL or 3MF in millimetres), or scenes as BOP."""

    data: Folder
    """Dataset folder."""
    out: Path
    """Folder to write to."""
    format: Literal["bop", "urdf", "stl", "3mf"] = "urdf"
    """What to write."""
    ids: tuple[str, ...] = ()
    """Assemblies, or for BOP scenes, to write; all of them when absent."""
    split: Literal["train", "val", "test"] | None = None
    """Just this split; all of them when absent."""
    sensor: Literal["ideal", "d415"] = "ideal"
    """Whose depth images BOP gets."""

    def run(self) -> int:
        """Export one after another."""
        from kit1000.export import export

        export(self.data, self.format, self.out, self.ids, self.split, self.sensor)
        print(self.out)
        return 0


@dataclass(frozen=True)
class Insertions:
    """Let a simulated hand put parts into their slots, and compare what physics says with the seating test."""

    data: Folder
    """Dataset folder."""
    out: Path
    """Folder for insertions.json and the convex pieces of the parts, which serve again."""
    sample: int = 16
    """Slots tried in a true pose and in eight wrong ones."""
    more: int = 32
    """Slots tried in a true pose alone."""
    seed: int = 0
    """Of the sample and of the errors."""

    def run(self) -> int:
        """Try, then print the tables."""
        from kit1000.insertion_study import described, study

        print(described(study(self.data, self.out, self.sample, self.more, self.seed)))
        return 0


@dataclass(frozen=True)
class Check:
    """List every fault of a submission, with line, column, value, what is expected and how to mend it."""

    submission: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SUBMISSION")]
    """Folder with manifest.toml and predictions.csv, or one predictions file."""
    data: Optional = None
    """Dataset that is answered; the form alone is checked when absent."""
    split: Literal["test", "test-all", "val", "train"] = "test"
    """Whose queries are to be answered."""
    json: Flag = False
    """Print the report as JSON."""

    def run(self) -> int:
        """Check, then print the faults; 1 when there are errors."""
        from kit1000.files import json_bytes
        from kit1000.submission import check

        report = check(self.submission, self.data, self.split)
        print(json_bytes(report.as_json()).decode() if self.json else report, end="" if self.json else "\n")
        return 0 if report.good else 1


COMMANDS = {
    "generate": Generate,
    "kit": MakeKit,
    "info": Info,
    "show": Show,
    "verify": Verify,
    "export": Export,
    "check": Check,
    "insertions": Insertions,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments in (["--version"], ["-V"]):
        print(f"kit1000 {__version__}")
        return 0
    return run("kit1000", COMMANDS, ABOUT, arguments)


def describe(summary: dict) -> str:
    """A dataset's summary as text."""
    seed = "withheld" if summary["seed"] is None else summary["seed"]
    lines = [
        f"{summary['preset']}  {summary['dataset_id']}"
        f"  (seed {seed}, data {summary['data_version']}, {summary['licence']})"
    ]
    for split in ("train", "val", "test"):
        n = summary["counts"][split]
        lines.append(
            f"  {split:6s} {n['parts']:5d} parts and kits, {n['assemblies']:5d} assemblies, {n['scenes']:5d} scenes"
        )
    for kind, reasons in sorted(summary["redraws"].items()):
        ranked = sorted(reasons.items(), key=lambda item: (-item[1], item[0]))
        lines.append(f"  redrawn {kind}: {', '.join(f'{n}x {reason}' for reason, n in ranked) or 'none'}")
    refused = sorted((summary["refused"] | summary["refused_scenes"]).items())
    refused = [f"  refused {name}: {reason}" for name, reason in refused]
    lines += refused[:LISTED]
    if len(refused) > LISTED:
        lines.append(f"  refused {len(refused) - LISTED} more: dataset.json lists them")
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
        lines.append(f"note   the cavity alone does not force the pose: the part {report['trial']['why']}")
    return "\n".join([*lines, f"files  {out}"])
