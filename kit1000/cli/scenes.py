"""The commands that act in scenes: predict, run, edit and study."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from kit1000.cli.capture import OwnImages, default_folder, need_truth
from kit1000.cli.command_line import check_least
from kit1000.cli.labels import known_kits
from kit1000.cli.options import Folder, OptionalId, OptionalInt, OptionalName, OptionalPath, optional
from kit1000.dataset.own_scenes import OWN
from kit1000.editor import SNAP
from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.queries.tracks import Sensor

if TYPE_CHECKING:
    from kit1000.dataset.reader import Dataset
    from kit1000.known_shapes.known_kits import KnownKits

KNOWN = "registration-known"  # snaps where shapes are given


def find_own_modules() -> None:
    """Let `module:Object` name modules of the current folder too, as `python -m` does."""
    if (here := os.getcwd()) not in sys.path:
        sys.path.append(here)


@dataclass(frozen=True)
class Predict:
    """Run a method on the queries of a dataset; the same command again resumes an interrupted run."""

    name: Annotated[Positional[str], arg(metavar="METHOD")]
    """A method by its name, such as registration-completed, or module:Object or FILE.py:Object of your own."""
    data: Path
    """Dataset folder."""
    out: Path
    """Submission folder; predictions are added to a submission of the same method and dataset."""
    split: tuple[str, ...] = ("test",)
    """Splits to predict: one or several of test, curves, val, test-all, train."""
    tracks: tuple[str, ...] = ()
    """Tracks to predict for. Default: all tracks of the method."""
    workers: OptionalInt = None
    """Number of processes. Default: one per core. The predictions do not depend on it."""
    limit: OptionalInt = None
    """Number of queries, from the first on. Default: all."""
    seed: int = 0
    """Seed of all draws of the method."""
    masks: Literal["given", "predicted"] = "given"
    """Masks that the method reads: those of the dataset, or those that segmentation finds in the depth image."""
    weights: tuple[Path, ...] = ()
    """Folders of training runs whose best weights replace the published ones."""
    shapes: OptionalPath = None
    """Folder with the shapes in the images, for a method that reads them: of `kit1000 kit`, or a dataset.
    Default: those of the dataset."""
    assembly: OptionalId = None
    """Id of the assembly in --shapes. Default: the only one."""

    def run(self) -> int:
        """Predict by a method of the library or of the user."""
        from kit1000.prediction.catalog import TABLES

        return self.run_from(TABLES)

    def run_from(self, tables: tuple[str, ...]) -> int:
        """Predict by a method of some tables or of the user, then print what was written."""
        from kit1000.prediction.predict import RunConfig, predict_and_describe

        check_least(workers=(self.workers, 1), limit=(self.limit, 1), seed=(self.seed, 0))
        find_own_modules()
        tracks = self.tracks or None
        config = RunConfig.of(
            self.name,
            self.masks,
            self.split,
            tracks,
            self.seed,
            self.limit,
            tables,
            self.weights,
            self.shapes,
            self.assembly,
        )
        print(predict_and_describe(config, self.data, self.out, self.workers))
        return 0


@dataclass(frozen=True)
class Run:
    """Let a simulated robot pick parts and insert them as predicted; print the outcome of each part."""

    data: Folder
    """Dataset folder, with ground truth."""
    predictions: Path
    """Submission folder or predictions file; predictions of one track."""
    scene: OptionalId = None
    """Id of one scene, such as test-s0003. Default: every scene with a prediction."""
    track: OptionalName = None
    """Track whose predictions the robot carries out; needed if the file has several tracks."""
    out: OptionalPath = None
    """Folder for outcomes.json and a trace of each scene."""
    seed: int = 0
    """Seed of the path planner."""

    def run(self) -> int:
        """Run the robot and print the outcomes; returns 1 when a part is not seated."""
        need_truth(self.data, "run")
        from kit1000.planner.runs import format_runs, run_predictions

        runs = run_predictions(self.data, self.predictions, self.scene, self.track, self.out, self.seed)
        print(format_runs(runs))
        return 0 if all(part.outcome == "seated" for run in runs for part in run.parts) else 1


@dataclass(frozen=True)
class Edit(OwnImages):
    """Open a page in which you drag the parts of a scene onto their cavities; prints its address. Ctrl-C ends it."""

    data: Folder
    """Dataset folder; or an own depth image or recording, which is imported first into a folder beside it."""
    scene: OptionalId = None
    """Id of the scene, such as test-s0003. Default: the only one."""
    shapes: OptionalPath = None
    """Folder with the shapes in the image: of `kit1000 kit`, or a dataset. They are found in the image, and shown."""
    assembly: OptionalId = None
    """Id of the assembly in --shapes. Default: the only one."""
    kit: Annotated[int | Path, arg(metavar="N | FILE")] = 1
    """Which body of an own image is the kit: 1 is the largest; or its mesh file, kit.stl of `kit1000 kit`."""
    part: OptionalPath = None
    """Mesh file of the part of --kit FILE, seated in its frame: part.stl of `kit1000 kit`."""
    out: OptionalPath = None
    """Submission folder for the confirmed parts and the log; the same command again continues. Default: edits. For an
    image: folder of the scene; the edits go into a folder beside it."""
    sensor: Annotated[Sensor | None, optional(Sensor)] = None
    """Sensor of the depth image; for an own image photoneo means a scanner. Default: ideal if the scene has it."""
    snap: Annotated[str | None, optional(str, "METHOD")] = None
    """Method that proposes fits: one of the catalog, module:Object of your own, or none. Default: registration; in own
    scenes with networks for the noise of the camera; of known shapes registration-known."""
    interface: Literal["scene", "hand", "hand-bare"] = "scene"
    """Thing that you move: parts, or the robot's suction cup, one part at a time; bare: by gizmo. Cups never snap."""
    port: OptionalInt = None
    """Port of the page. Default: a free one."""
    truth: bool = False
    """Show the true shapes; the page and every line of the log state it."""
    base_from_camera: OptionalPath = None
    """JSON file with the camera's pose in the base of your robot, for moves.json. Default: that of dataset.json."""

    def run(self) -> int:
        """Serve the page until Ctrl-C."""
        try:
            from kit1000.editor.serve import Options
            from kit1000.editor.serve import run as serve
        except ModuleNotFoundError as error:
            if error.name != "viser":
                raise
            raise InputError("edit: needs viser: pip install 'kit1000[edit]'") from None
        from kit1000.dataset.reader import Dataset

        find_own_modules()
        kits = self._kits()
        data, out = self._folders(kits)
        dataset = Dataset(data)
        scene, sensor = _chosen_scene(dataset, self.scene, self.sensor)
        shapes = None if kits is None else kits.shapes_for(dataset.summary)
        method = KNOWN if shapes else _default_method(dataset, scene, sensor) if self.interface == "scene" else "none"
        chosen = (data, scene, out, sensor, self.snap or method)
        serve(Options(*chosen, self.port, self.truth, self.interface, self.base_from_camera, shapes))
        return 0

    def _kits(self) -> KnownKits | None:
        """The kits whose shapes the user gives; None without any."""
        kit = self.kit if isinstance(self.kit, Path) else None
        if self.shapes is None and kit is None:
            if self.part is not None:
                raise InputError("--part: needs --kit FILE, the kit in whose frame it is seated")
            return None
        from kit1000.prediction.making import method_of

        if self.snap and (self.snap == "none" or method_of(self.snap).reads != "shapes"):
            raise InputError(f"--snap {self.snap}: reads no shapes; leave it out, or --shapes and --kit FILE")
        return known_kits(self.shapes, self.assembly, kit, self.part, self.clearance_mm)

    def _folders(self, kits: KnownKits | None) -> tuple[Path, Path]:
        """The folders of the dataset and of the edits, after the import of an image; kits may state its clearance."""
        folder = self.data.is_dir() and not any(self.data.glob("*.mcap"))  # no bag of ROS
        if folder or not (self.data.exists() or self.data.suffix):
            given = self.own_options() + (["--kit"] if isinstance(self.kit, int) and self.kit != 1 else [])
            if given:
                raise InputError(f"{given[0]}: is for own depth images; {self.data} is a folder of scenes")
            return self.data, self.out or Path("edits")
        from kit1000.capture.importing import import_scenes

        if self.sensor == "ideal":
            raise InputError("--sensor ideal: no camera is; expected d415 or photoneo of an own image")
        scanner = self.sensor == "photoneo" and not self.device
        own = replace(self, device=self.sensor) if scanner else self
        stated = {mount.kit.slot.clearance for mount in kits.assembly.mounts} if kits else set()
        if self.clearance_mm is None and len(stated) == 1:
            own = replace(own, clearance_mm=1e3 * stated.pop())
        folder = self.out or default_folder(self.data)
        if _was_imported(folder, self.data):
            print(f"{folder}: imported before; delete it to import {self.data} again")
            return folder, folder.with_name(f"{folder.name}-edits")
        body = self.kit if isinstance(self.kit, int) else 1
        size = None if kits is None else tuple(kits.assembly.mesh.extents.tolist())
        for line in import_scenes(own.asked((self.data,), folder, body, kit_size=size)):
            print(line)
        return folder, folder.with_name(f"{folder.name}-edits")


def _was_imported(folder: Path, source: Path) -> bool:
    """Whether a folder holds the scene of an image or a recording; raises InputError if that has changed since."""
    summary = folder / "dataset.json"
    if not (summary.is_file() and source.exists()):
        return False
    own = read_json(summary).get(OWN)
    sources = own.get("sources", []) if isinstance(own, dict) else []
    beginnings = f"{source} ", f"{source}, ", f"{source}{os.sep}"  # before a topic, a frame, and a file of a bag
    known = len(sources) == 1 and f"{sources[0]} ".startswith(beginnings)
    if known and source.stat().st_mtime >= summary.stat().st_mtime:
        raise InputError(f"{folder}: holds the scene of an earlier {source}: delete it, or choose another --out")
    return known


def _chosen_scene(dataset: Dataset, scene: str | None, sensor: str | None) -> tuple[str, str]:
    """Id and sensor of the scene to edit: the only one, and the first sensor that it has."""
    ids = [scene_id for shard in dataset.summary.get("shards", {}).values() for scene_id in shard]
    if scene is None and len(ids) != 1:
        raise InputError(
            f"{dataset.root}: has {len(ids)} scenes; choose one with --scene, such as {ids[0] if ids else 'none'}"
        )
    chosen = scene or ids[0]
    return chosen, sensor or next(iter(dataset.recorded_scene(chosen, truth=False).sensors), "ideal")


def _default_method(dataset: Dataset, scene: str, sensor: str) -> str:
    """The default method: for an own camera the one with networks for its noise, if torch is installed."""
    from kit1000.capture.mask_networks import networks_available
    from kit1000.perception.sensor_facts import sensor_of

    own = not sensor_of(dataset.summary, sensor, scene).simulated_table
    return "registration-completed" if own and networks_available() else SNAP


@dataclass(frozen=True)
class Study:
    """Plan a user study, run the sitting of a participant, or report."""

    data: Folder
    """Dataset folder, with ground truth; the preset study is made for this."""
    out: Path = Path("study")
    """Folder of the study; the same command again continues."""
    people: OptionalInt = None
    """Number of participants, a multiple of 4. Default: 12. Without other options: plan, and print all orders."""
    conditions: tuple[str, ...] = ()
    """Conditions: two of scene-snap, scene, hand, hand-bare. Default: scene-snap and hand."""
    sensor: Annotated[Sensor | None, optional(Sensor)] = None
    """Sensor of the depth images. Default: ideal."""
    snap: Annotated[str | None, optional(str, "METHOD")] = None
    """Method of the condition that snaps. Default: registration."""
    seed: OptionalInt = None
    """Seed of tasks and orders. Default: 0."""
    participant: OptionalInt = None
    """Number of the participant whose sitting begins or continues now, from 1; prints the address of the page."""
    port: OptionalInt = None
    """Port of the participant's page. Default: a free one."""
    report: bool = False
    """Write trials.csv, analysis.json and report.md about the participants."""

    def run(self) -> int:
        """Plan, serve or report; prints orders, an address or the path of a report."""
        need_truth(self.data, "study")
        from kit1000.study.command import run

        find_own_modules()
        run(**vars(self))
        return 0
