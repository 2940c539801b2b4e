"""Reading a dataset: splits of scenes with their depth images, queries and, on request, ground truth.

Everything is read on first use. Without `truth=True` no truth file, table or mesh is opened, whatever the split.
Datasets, splits, scenes and queries can be pickled and sent to another process, which opens the files again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.json_rows import Row, pose_of
from kit1000.dataset.mcap_io import ObservationFile, TruthFile
from kit1000.dataset.scene_data import SceneTruth
from kit1000.errors import InputError, did_you_mean
from kit1000.files import read_json
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.queries.tracks import CURVES, TRACKS, has_curves
from kit1000.rng import stream
from kit1000.sim import cameras
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.sim.sensors import sense
from kit1000.values import Body, LabelledDepth, Query, Scene, SceneShapes, Truth, View

MAX_OPEN_FILES = 128  # open at once: all shards of the largest split, with their truth
WITHHELD_FILE = "withheld.json"  # in the full folder of a withheld dataset: salt, commitment, id of the public one
WITHOUT_TRUTH = "scenes without ground truth, as those of an own camera, cannot be scored, run or verified"
CACHED_IMAGES = 8  # depth images with masks in memory: the queries of a scene share them, from several places too


def _not_curve(row: Row) -> bool:
    return row["track"] != CURVES


SPLIT_QUERIES: dict[str, tuple[str, Callable[[Row], bool]]] = {
    "train": ("train", _not_curve),
    "val": ("val", _not_curve),
    "test": ("test", lambda row: row["drawn"] and _not_curve(row)),
    "test-all": ("test", _not_curve),
    "curves": ("test", lambda row: not _not_curve(row)),
}
"""Folder of the shards of each split, and whether a query of that folder belongs to the split."""


class Dataset:
    """A finished dataset on disk."""

    def __init__(self, root: str | Path) -> None:
        """Open a dataset folder. Raises InputError when it is no dataset, or an unfinished one."""
        self.root = Path(root).absolute()  # it stays the same in a worker, and after a change of the working folder
        self.geometry = Geometry(self.root)
        self._files = lru_cache(MAX_OPEN_FILES)(self._open)
        self.labelled_depth = lru_cache(CACHED_IMAGES)(self._labelled_depth)

    def __reduce__(self) -> tuple[type[Dataset], tuple[Path]]:
        return Dataset, (self.root,)

    @property
    def summary(self) -> dict[str, Any]:
        """The contents of dataset.json."""
        return self.geometry.summary

    @property
    def id(self) -> str:
        """The id of the dataset, a hash of its plan."""
        return self.summary["dataset_id"]

    @property
    def public_id(self) -> str | None:
        """The id of the public dataset whose withheld ground truth is in this folder; None if none is withheld."""
        path = self.root / WITHHELD_FILE
        return read_json(path)["dataset_id"] if path.is_file() else None

    def split(self, name: str, truth: bool = False) -> Split:
        """The scenes and queries of a split.

        Args:
            name: train, val, test (one query for each scene and track), test-all (all queries) or curves.
            truth: whether ground truth may be read: to train, to score, or by a method with true geometry.
        """
        if name not in SPLIT_QUERIES:
            raise InputError(
                f"no split {name!r}; {did_you_mean(name, SPLIT_QUERIES)}there are {', '.join(SPLIT_QUERIES)}"
            )
        return Split(self, name, truth)

    def recorded_scene(self, scene_id: str, truth: bool | None = None) -> RecordedScene:
        """A scene of any split with all its queries, with its truth or without; None: where this folder has it."""
        folder = scene_id.partition("-")[0]
        shard = self.shards(folder).get(scene_id)
        if shard is None:
            known = [i for scene_ids in self.summary.get("shards", {}).values() for i in scene_ids]
            raise InputError(
                f"{self.root}: no scene {scene_id!r} among {len(known)}; {did_you_mean(scene_id, known)}".rstrip("; ")
            )
        if truth is None:
            truth = (self.root / f"{shard}.truth.mcap").is_file()
        return self.split("test-all" if folder == "test" else folder, truth).scene(scene_id)

    def truth_of(self, query: Query) -> Truth:
        """The ground truth about a query of this dataset; raises InputError if the folder is without it."""
        folder = query.scene_id.partition("-")[0]
        split = CURVES if query.track == CURVES else {"test": "test-all"}.get(folder, folder)
        return self.split(split, truth=True).scene(query.scene_id).truth_of(query.id)

    def shards(self, folder: str) -> dict[str, str]:
        """The shard of every scene in the folder of a split, by scene id, in order: test-s0007 is in test/0000."""
        shards = sorted(self.summary.get("shards", {}).items())
        named = {scene_id: shard for shard, scene_ids in shards for scene_id in scene_ids}
        return {i: name.removesuffix(".mcap") for i, name in named.items() if name.startswith(f"{folder}/")}

    def observation_file(self, shard: str, camera_set: str | None = None) -> ObservationFile:
        """The observations of a shard, by the primary camera or by an extra camera set."""
        return self._files(ObservationFile, f"{shard}.mcap" if camera_set is None else f"{shard}.{camera_set}.mcap")

    def truth_file(self, shard: str) -> TruthFile:
        """The ground truth of a shard."""
        return self._files(TruthFile, f"{shard}.truth.mcap")

    def _why_no_truth(self) -> str:
        """Why a file with truth may be missing, for a message."""
        if "withheld" in self.summary:
            return " (withheld from this folder)"
        own = not any(self.root.glob("*/*.truth.mcap"))
        return f": {WITHOUT_TRUTH}" if own else ""

    def _labelled_depth(self, shard: str, scene_id: str, sensor: str) -> LabelledDepth:
        """A depth image of the primary camera with its masks."""
        file = self.observation_file(shard)
        labels = file.labels(scene_id)
        if labels is None:
            raise InputError(f"{file.path}: scene {scene_id} has no masks")
        return LabelledDepth(file.view(scene_id, sensor), labels)

    def _open(self, kind: Callable[[Path], Any], name: str) -> Any:
        if not (self.root / name).is_file():
            raise InputError(f"{self.root}: no file {name}{self._why_no_truth() if kind is TruthFile else ''}")
        return kind(self.root / name)


class Split:
    """The scenes and queries of a split; iterating yields its scenes."""

    def __init__(self, dataset: Dataset, name: str, truth: bool) -> None:
        self.dataset = dataset
        self.name = name
        self.truth = truth

    @cached_property
    def shards(self) -> dict[str, str]:
        """The shard of every scene, in order."""
        shards = self.dataset.shards(SPLIT_QUERIES[self.name][0])
        if not shards:
            raise InputError(f"{self.dataset.root}: split {self.name} has no scenes")
        if self.name != "curves":
            return shards
        count = self.dataset.summary["config"]["curve_scenes"]
        if count == 0:
            raise InputError(f"{self.dataset.root}: made without curves; a dataset with withheld truth has none")
        return {i: shard for i, shard in shards.items() if has_curves(i, count)}

    @property
    def scene_ids(self) -> list[str]:
        """Ids of the scenes, in order."""
        return list(self.shards)

    def __len__(self) -> int:
        return len(self.shards)

    def __iter__(self) -> Iterator[RecordedScene]:
        return map(self.scene, self.shards)

    def scene(self, scene_id: str) -> RecordedScene:
        """A scene by its id."""
        if scene_id not in self.shards:
            hint = did_you_mean(scene_id, self.shards)
            raise InputError(f"no scene {scene_id!r} among the {len(self)} of split {self.name}; {hint}see .scene_ids")
        return RecordedScene(self, scene_id)

    def queries(self, track: str | None = None) -> Iterator[Query]:
        """All queries, or those of a track, scene by scene, always in the same order."""
        known = (CURVES,) if self.name == "curves" else tuple(TRACKS)
        if track is not None and track not in known:
            raise InputError(f"no track {track!r} in split {self.name}; there are {', '.join(known)}")
        return (query for scene in self for query in scene.queries if track in (None, query.track))


class RecordedScene:
    """A recorded scene: depth images, masks, queries, and ground truth if the split was opened with it."""

    def __init__(self, split: Split, scene_id: str) -> None:
        self.split = split
        self.id = scene_id
        self.shard = split.shards[scene_id]

    def __reduce__(self) -> tuple[type[RecordedScene], tuple[Split, str]]:
        return RecordedScene, (self.split, self.id)

    @cached_property
    def queries(self) -> tuple[Query, ...]:
        """The queries of the split about this scene. Images are read when first used."""
        return tuple(map(self._query, self._query_rows.values()))

    def view(self, key: str | None = None) -> View:
        """A depth image: ideal, d415 or photoneo of the primary camera, three/0/ideal ... of an extra camera set; None:
        the first of `sensors`."""
        if key is None or "/" not in key:
            return self.labelled_depth(key).view
        return self._dataset.observation_file(self.shard, key.partition("/")[0]).view(self.id, key)

    @property
    def sensors(self) -> list[str]:
        """Sensors of the depth images of the primary camera: ideal first, where the scene has it."""
        return list(self._dataset.observation_file(self.shard).view_keys(self.id))

    @property
    def labels(self) -> np.ndarray:
        """(H, W) uint8 masks of the primary camera, see `kit1000.values.LabelledDepth`."""
        return self.labelled_depth().labels

    def labelled_depth(self, sensor: str | None = None) -> LabelledDepth:
        """The depth image of a sensor with its masks; None: of the first of `sensors`."""
        return self._dataset.labelled_depth(self.shard, self.id, sensor or next(iter(self.sensors), "ideal"))

    @cached_property
    def truth(self) -> SceneTruth:
        """The ground truth of the scene as recorded, with its images and models."""
        return self._truth_file.truth(self.id)

    @cached_property
    def scene(self) -> Scene:
        """The bodies of the scene with their poses."""
        row = self._truth_row
        parts = (Body(part["part_id"], pose_of(part["world_from_part"])) for part in row["parts"])
        return Scene(self.id, (Body(row["assembly_id"], pose_of(row["world_from_assembly"])), *parts))

    @property
    def shapes(self) -> SceneShapes:
        """The shapes of the scene without their poses. They are named by the ground truth."""
        assembly, *parts = (body.id for body in self.scene.bodies)
        geometry = self._dataset.geometry
        meshes = {part_id: geometry.part(part_id).mesh for part_id in sorted(parts)}
        return SceneShapes(geometry.assembly(assembly).mesh, meshes)

    @cached_property
    def truths(self) -> dict[str, Truth]:
        """The ground truth of the split's queries about this scene, by query id."""
        truth_row = self._truth_row
        return {query_id: self._truth_of(query_id, truth_row) for query_id in self._query_rows}

    def truth_of(self, query_id: str) -> Truth:
        """The ground truth of one of the split's queries."""
        truth_row = self._truth_row
        if query_id not in self._query_rows:
            hint = did_you_mean(query_id, self._query_rows)
            raise InputError(f"no query {query_id!r} in {self.id} of split {self.split.name}; {hint}see .queries")
        return self._truth_of(query_id, truth_row)

    def bodies(self) -> list[tuple[Mesh, Pose]]:
        """Meshes with their `world_from_body`, for `kit1000.sim.render.render`: the table, the assembly, the parts."""
        geometry, (assembly, *parts) = self._dataset.geometry, self.scene.bodies
        placed_parts = [(geometry.part(body.id).mesh, body.world_from_body) for body in parts]
        placed_assembly = (geometry.assembly(assembly.id).mesh, assembly.world_from_body)
        return [(table(), Pose.identity()), placed_assembly, *placed_parts]

    def render(self, camera_set: str, sensor: str = "ideal", seed: int = 0) -> dict[str, View]:
        """The scene rendered from another camera set, by camera. Needs the truth.

        Args:
            camera_set: primary, three or top.
            sensor: any of `kit1000.sim.sensors.SENSORS`.
            seed: of the sensor's noise.
        """
        bodies, primary = self.bodies(), self.view().world_from_camera
        config, views = self._dataset.summary["config"], {}
        for key, (camera, pose) in cameras.camera_set(camera_set, primary, config["scale"]).items():
            exact = View(camera, pose, render(camera, pose, bodies).depth)
            views[key or camera_set] = sense(
                sensor, exact, stream(seed, "noise", self.id, key, sensor), config["frames"]
            )
        return views

    @property
    def _dataset(self) -> Dataset:
        return self.split.dataset

    def _query(self, row: Row) -> Query:
        return Query(
            id=row["id"],
            scene_id=self.id,
            track=row["track"],
            sensor=row["sensor"],
            part=row["part"],
            drawn=row["drawn"],
            pivot=np.array(row["pivot"]),
            guess=row["guess"] and pose_of(row["guess"]),
            read_image=partial(self.labelled_depth, row["sensor"]),
        )

    @property
    def _truth_file(self) -> TruthFile:
        if not self.split.truth:
            raise InputError(f"{self.id}: the truth was not opened; use dataset.split({self.split.name!r}, truth=True)")
        return self._dataset.truth_file(self.shard)

    @cached_property
    def _query_rows(self) -> dict[str, Row]:
        """The rows of the split's queries, by id."""
        _, includes = SPLIT_QUERIES[self.split.name]
        rows = self._dataset.observation_file(self.shard).queries(self.id)
        return {row["id"]: row for row in rows if includes(row)}

    @cached_property
    def _truth_row(self) -> Row:
        """The truth as one row, without images and models."""
        return self._truth_file.row(self.id)

    def _truth_of(self, query_id: str, truth_row: Row) -> Truth:
        geometry = self._dataset.geometry
        row, sensor = truth_row["queries"][query_id], self._query_rows[query_id]["sensor"]
        part = truth_row["parts"][row["part"]]
        world_from_part = self.scene.bodies[1 + row["part"]].world_from_body
        return Truth(
            query_id=query_id,
            assembly_id=truth_row["assembly_id"],
            part_id=part["part_id"],
            family=part["family"],
            rest_mode=part["rest_mode"],
            kits=len(geometry.assemblies[truth_row["assembly_id"]]["mounts"]),
            visible=part["visible"],
            anchor=world_from_part.xyz,
            world_from_part=world_from_part,
            world_from_kit=pose_of(part["world_from_kit"]),
            slot=geometry.slot(part["part_id"]),
            goal_drawn=pose_of(row["goal_drawn"]),
            crowded=truth_row["crowded"],
            noise_px=truth_row.get("noise_px", {}).get(sensor, 0.0 if sensor == "ideal" else float("nan")),
        )
