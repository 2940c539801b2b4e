"""The commands about datasets: generate, info, show, verify, export and check."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from kit1000.cli.capture import need_truth
from kit1000.cli.command_line import check_least
from kit1000.cli.options import Folder, OptionalId, OptionalInt, OptionalName, OptionalPath, Unit, optional
from kit1000.cli.summaries import summary_text
from kit1000.errors import InputError
from kit1000.queries.tracks import Sensor

if TYPE_CHECKING:
    from kit1000.generation.plan import Sources
    from kit1000.generation.presets import Preset


@dataclass(frozen=True)
class Generate:
    """Generate a dataset. Run the same command again to continue after an interruption."""

    preset: Annotated[Positional[str], arg(metavar="PRESET")]
    """tiny, small, kit1000, paper, real-like, study, print or completion."""
    out: Path
    """Dataset folder to write; with --engine ray all nodes must share it."""
    seed: OptionalInt = None
    """Seed of all random draws. Default: that of the preset."""
    workers: OptionalInt = None
    """Number of processes. Default: one per core. The bytes do not depend on it."""
    parts: OptionalPath = None
    """Folder, file or .txt list of meshes to use instead of procedural parts."""
    unit: Unit = None
    """Unit of the meshes of --parts. Default: guessed and reported."""
    engine: Literal["local", "ray"] = "local"
    """Engine that runs the jobs: processes of this machine, or a Ray cluster."""
    address: Annotated[str | None, optional(str, "HOST:PORT")] = None
    """Address of the Ray cluster (`auto` finds a local one). Default: a new local cluster."""
    withhold: OptionalPath = None
    """Second folder, for the full dataset; --out then lacks the ground truth of the test split."""

    def run(self) -> int:
        """Generate the dataset and print its summary."""
        from kit1000.generation.presets import preset

        chosen = preset(self.preset)
        check_least(workers=(self.workers, 1), seed=(self.seed, 0))
        if self.unit is not None and self.parts is None:
            raise InputError("--unit: needs --parts, whose meshes have this unit")

        if self.withhold is None:
            summary = self._generate(chosen, self.out)
        else:
            summary = self._publish(chosen, self.out, self.withhold)
        print(summary_text(summary))
        return 0

    def _generate(self, chosen: Preset, out: Path, seed: int | None = None) -> dict[str, Any]:
        """Generate the full dataset in a folder; returns its summary."""
        from kit1000.generation.build import generate
        from kit1000.parallel import ray_engine

        if self.address is not None and self.engine != "ray":
            raise InputError("--address: is that of a Ray cluster and needs --engine ray")
        engine = ray_engine(self.address, self.workers) if self.engine == "ray" else None
        return generate(chosen, out, self.seed if seed is None else seed, self.workers, self._sources(out), engine)

    def _publish(self, chosen: Preset, out: Path, full: Path) -> dict[str, Any]:
        """Generate the full dataset in one folder and its public part in --out; returns the summary of the latter."""
        from kit1000.generation.withhold import check_separate, publish, secret_seed, withheld_preset

        check_separate(out, full)
        self._generate(withheld_preset(chosen), full, secret_seed(full, self.seed))
        return publish(full, out)

    def _sources(self, dataset: Path) -> Sources | None:
        """The mesh files of --parts, without those that this command itself writes."""
        from kit1000.generation.plan import Sources
        from kit1000.parts.files.read import STEP_SUFFIXES, mesh_files

        if self.parts is None:
            return None
        own_folders = {dataset.resolve(), self.out.resolve()}
        files = [file for file in mesh_files(self.parts) if own_folders.isdisjoint(file.resolve().parents)]
        if not files:
            raise InputError(f"{self.parts}: no mesh files but those in --out {dataset}")
        step = sum(file.suffix.lower() in STEP_SUFFIXES for file in files)
        if self.unit is not None and step:
            print(f"--unit {self.unit}: not used for {step} STEP files, which state their own unit", file=sys.stderr)
        return Sources.of(files, self.unit)


@dataclass(frozen=True)
class Info:
    """Print the summary of a dataset: id, counts, redraws."""

    data: Folder
    """Dataset folder."""

    def run(self) -> int:
        """Print the summary."""
        from kit1000.dataset.geometry import Geometry

        print(summary_text(Geometry(self.data).summary))
        return 0


@dataclass(frozen=True)
class Show:
    """Draw parts, kits or assemblies of a dataset, or one of its scenes, as a PNG."""

    data: Folder
    """Dataset folder."""
    out: Path = Path("sheet.png")
    """PNG file to write."""
    what: Literal["parts", "kits", "assemblies"] = "assemblies"
    """Kind of items to draw."""
    count: int = 24
    """Number of items, evenly spaced over the split."""
    split: Literal["train", "val", "test"] = "test"
    """Split of the items."""
    ids: tuple[str, ...] = ()
    """Ids of the items to draw instead of evenly spaced ones."""
    scene: OptionalId = None
    """Id of a scene to draw instead of items: its depth, masks, meshes and goals."""

    def run(self) -> int:
        """Draw the picture and print its path."""
        from kit1000.dataset.geometry import Geometry
        from kit1000.dataset.reader import Dataset
        from kit1000.files import check_output_file, write_own
        from kit1000.pictures.dataset_sheets import geometry_sheet, scene_sheet

        check_least(count=(self.count, 1))
        if self.out.suffix.lower() not in (".png", ""):
            raise InputError(f"--out {self.out}: a picture is a PNG file: name a file .png")
        check_output_file(self.out)
        if self.scene is None:
            need_truth(self.data, "show without --scene")
            write_own(self.out, geometry_sheet(Geometry(self.data), self.what, self.split, self.count, self.ids))
        else:
            write_own(self.out, scene_sheet(Dataset(self.data), self.scene))
        print(self.out)
        return 0


@dataclass(frozen=True)
class Verify:
    """Check every file of a dataset, and generate a sample of its scenes again to compare."""

    data: Folder
    """Dataset folder."""
    sample: int = 4
    """Number of scenes to generate again from the plan."""

    def run(self) -> int:
        """Check and print the faults; returns 1 when there are any."""
        from kit1000.generation.verify import verify

        check_least(sample=(self.sample, 0))
        report = verify(self.data, self.sample)
        for line in report.faults:
            print(line)
        rebuilt = ", ".join(report.rebuilt) or "none"
        print(f"{report.files} files checked, {len(report.rebuilt)} scenes generated again ({rebuilt})")
        print(*(f"note: {note}" for note in report.notes), sep="\n", end="\n" if report.notes else "")
        print(f"faults: {len(report.faults) or 'none'}")
        return 1 if report.faults else 0


@dataclass(frozen=True)
class Export:
    """Write assemblies as URDF with open cavities or STL in mm; or scenes as MJCF, BOP or MCAP."""

    data: Folder
    """Dataset folder."""
    out: Path
    """Folder to write to."""
    format: Literal["bop", "mjcf", "urdf", "stl", "mcap"] = "urdf"
    """Format to write; mcap is a recording of each scene for 3D viewers."""
    ids: tuple[str, ...] = ()
    """Ids of the assemblies, or of the scenes for bop, mjcf and mcap. Default: all; mcap needs ids."""
    split: Literal["train", "val", "test"] | None = None
    """Split to export. Default: all of them."""
    sensor: Sensor = "ideal"
    """Sensor of the depth images, for bop."""
    truth: bool = False
    """Add models, goals and seated parts; for mcap."""
    predictions: OptionalPath = None
    """Predictions file whose motions are shown, coloured by their errors; for mcap with --truth."""
    track: OptionalName = None
    """Track of the queries whose pivots and guesses are shown, for mcap. Default: the first one of the scene."""

    def run(self) -> int:
        """Export, and print the folder."""
        from kit1000.export import export

        if self.format == "mcap":
            self._write_recordings()
        elif self.truth or self.predictions is not None or self.track is not None:
            raise InputError("--truth, --predictions and --track: need --format mcap")
        else:
            need_truth(self.data, "export")
            export(self.data, self.format, self.out, self.ids, self.split, self.sensor)
        print(self.out)
        return 0

    def _write_recordings(self) -> None:
        """Write a recording of each scene of --ids into the folder."""
        from kit1000.dataset.reader import Dataset
        from kit1000.export.recording import write_scene_recording
        from kit1000.files import check_output_file

        if not self.ids:
            raise InputError("--ids: --format mcap needs the ids of the scenes, such as test-s0003")
        if self.truth:
            need_truth(self.data, "export --truth")
        dataset, paths = Dataset(self.data), [self.out / f"{scene_id}.mcap" for scene_id in self.ids]
        for path in paths:
            check_output_file(path)
        for scene_id, path in zip(self.ids, paths, strict=True):
            write_scene_recording(dataset, scene_id, path, self.truth, self.predictions, self.track)


@dataclass(frozen=True)
class Check:
    """List every fault of a submission, with line, value, expected value and repair."""

    submission: Annotated[Positional[Path], arg(metavar="SUBMISSION")]
    """Folder with manifest.toml and predictions.csv, or one predictions file."""
    data: OptionalPath = None
    """Dataset of the predictions. Default: only the format is checked."""
    split: Literal["test", "test-all", "val", "train"] = "test"
    """Split whose queries need predictions."""
    json: bool = False
    """Print the report as JSON."""

    def run(self) -> int:
        """Check and print the report; returns 1 when there are errors."""
        from kit1000.files import json_bytes
        from kit1000.submission import check

        report = check(self.submission, self.data, self.split)
        print(json_bytes(report.as_json()).decode() if self.json else report, end="" if self.json else "\n")
        return 0 if report.good else 1
