"""Reading a dataset: splits of scenes, what was seen of each, what is asked and, only when asked for, the truth.

Everything is read when first used. Without `truth=True` no file of truth, table or mesh is opened, whatever the split.
A dataset, split, scene or query may be sent to another process; open files stay behind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.mcap_io import ObservationFile, TruthFile
from kit1000.dataset.schema import SceneTruth
from kit1000.dataset.tables import Row, pose_of
from kit1000.errors import InputError, did_you_mean
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim import cameras
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.sim.sensors import sense
from kit1000.tracks import CURVES, TRACKS, has_curves
from kit1000.values import Body, LabelledDepth, Query, Scene, Truth, View

OPEN_FILES = 128  # kept open at once: all shards of the largest split, with their truth
IMAGES_KEPT = 4  # depth images kept in memory with their masks: the queries of a scene share theirs


def _every(row: Row) -> bool:
    return row["track"] != CURVES


def _drawn(row: Row) -> bool:
    return row["drawn"] and row["track"] != CURVES


def _curves(row: Row) -> bool:
    return row["track"] == CURVES


WANTED: dict[str, tuple[str, Callable[[Row], bool]]] = {
    "train": ("train", _every),
    "val": ("val", _every),
    "test": ("test", _drawn),
    "test-all": ("test", _every),
    "curves": ("test", _curves),
}
"""By the name of a split: the folder of its shards, and which of the queries there it asks."""


class Dataset:
    """A finished dataset on disk."""

    def __init__(self, root: str | Path) -> None:
        """Open a dataset folder. Raises InputError when it is none, or is not finished."""
        self.root = Path(root)
        self.geometry = Geometry(root)
        self._files = lru_cache(OPEN_FILES)(self._open)
        self._looks = lru_cache(IMAGES_KEPT)(self._read_labelled_depth)

    def __reduce__(self) -> tuple[type[Dataset], tuple[Path]]:
        return Dataset, (self.root,)

    @property
    def summary(self) -> dict[str, Any]:
        """What dataset.json says."""
        return self.geometry.summary

    @property
    def id(self) -> str:
        """Names this dataset and no other."""
        return self.summary["dataset_id"]

    def split(self, name: str, truth: bool = False) -> Split:
        """The scenes and queries of train, val, test (one drawn target a track), test-all or curves.

        With `truth` the poses, goals, parts and kits may be read too: to train, to score, or by a method that says so.
        """
        if name not in WANTED:
            raise InputError(f"no split {name!r}; {did_you_mean(name, WANTED)}there are {', '.join(WANTED)}")
        return Split(self, name, truth)

    def recorded_scene(self, scene_id: str) -> RecordedScene:
        """A scene of any split with everything asked about it, and with the truth where this folder has it."""
        folder = scene_id.partition("-")[0]
        shard = self.shards(folder).get(scene_id)
        if shard is None:
            known = [i for held in self.summary.get("shards", {}).values() for i in held]
            raise InputError(
                f"{self.root}: no scene {scene_id!r} among {len(known)}; {did_you_mean(scene_id, known)}".rstrip("; ")
            )
        truth = (self.root / f"{shard}.truth.mcap").is_file()
        return self.split("test-all" if folder == "test" else folder, truth).scene(scene_id)

    def truth_of(self, query: Query) -> Truth:
        """The ground truth about a query of this dataset; raises InputError where the folder is without it."""
        folder = query.scene_id.partition("-")[0]
        split = CURVES if query.track == CURVES else {"test": "test-all"}.get(folder, folder)
        return self.split(split, truth=True).scene(query.scene_id).truth_of(query.id)

    def shards(self, folder: str) -> dict[str, str]:
        """The shard of every scene in the folder of a split, in order: test-s0007 is in test/0000."""
        shards = sorted(self.summary.get("shards", {}).items())
        named = {scene_id: shard for shard, scene_ids in shards for scene_id in scene_ids}
        return {i: name.removesuffix(".mcap") for i, name in named.items() if name.startswith(f"{folder}/")}

    def observation_file(self, shard: str, camera_set: str | None = None) -> ObservationFile:
        """What was seen of the scenes of a shard, by the primary camera or by a further set of cameras."""
        return self._files(ObservationFile, f"{shard}.mcap" if camera_set is None else f"{shard}.{camera_set}.mcap")

    def truth_file(self, shard: str) -> TruthFile:
        """The truth about the scenes of a shard."""
        return self._files(TruthFile, f"{shard}.truth.mcap")

    def labelled_depth(self, shard: str, scene_id: str, sensor: str) -> LabelledDepth:
        """A depth image of the primary camera with its masks; the last few are remembered."""
        return self._looks(shard, scene_id, sensor)

    def _read_labelled_depth(self, shard: str, scene_id: str, sensor: str) -> LabelledDepth:
        file = self.observation_file(shard)
        labels = file.labels(scene_id)
        if labels is None:
            raise InputError(f"{file.path}: scene {scene_id} has no masks")
        return LabelledDepth(file.view(scene_id, sensor), labels)

    def _open(self, kind: Callable[[Path], Any], name: str) -> Any:
        if not (self.root / name).is_file():
            why = " (withheld from this folder)" if kind is TruthFile and "withheld" in self.summary else ""
            raise InputError(f"{self.root}: no file {name}{why}")
        return kind(self.root / name)


class Split:
    """Some scenes of a dataset and what is asked about them."""

    def __init__(self, dataset: Dataset, name: str, truth: bool) -> None:
        self.dataset = dataset
        self.name = name
        self.truth = truth

    @cached_property
    def shards(self) -> dict[str, str]:
        """The shard of every scene, in order."""
        shards = self.dataset.shards(WANTED[self.name][0])
        if not shards:
            raise InputError(f"{self.dataset.root}: split {self.name} has no scenes")
        if self.name != "curves":
            return shards
        count = self.dataset.summary["config"]["curve_scenes"]
        if count == 0:
            raise InputError(f"{self.dataset.root}: made without curves; a dataset whose answers are withheld has none")
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
        """All queries, or those of a track: scene after scene, always in the same order."""
        known = (CURVES,) if self.name == "curves" else tuple(TRACKS)
        if track is not None and track not in known:
            raise InputError(f"no track {track!r} in split {self.name}; there are {', '.join(known)}")
        return (query for scene in self for query in scene.queries if track in (None, query.track))


class RecordedScene:
    """A recorded scene: what was seen, what is asked, and the truth if the split was opened with it."""

    def __init__(self, split: Split, scene_id: str) -> None:
        self.split = split
        self.id = scene_id
        self.shard = split.shards[scene_id]

    def __reduce__(self) -> tuple[type[RecordedScene], tuple[Split, str]]:
        return RecordedScene, (self.split, self.id)

    @cached_property
    def queries(self) -> tuple[Query, ...]:
        """What the split asks about this scene. Images are read when a query is first looked at."""
        return tuple(map(self._query, self._asked.values()))

    def view(self, key: str = "ideal") -> View:
        """A depth image: ideal or d415 of the primary camera, three/0/ideal ... of a further set."""
        if "/" not in key:
            return self.labelled_depth(key).view
        return self._dataset.observation_file(self.shard, key.partition("/")[0]).view(self.id, key)

    @property
    def sensors(self) -> list[str]:
        """Which depth images there are of the primary camera."""
        return list(self._dataset.observation_file(self.shard).view_keys(self.id))

    @property
    def labels(self) -> np.ndarray:
        """(H, W) uint8 masks of the primary camera, as `kit1000.values.LabelledDepth` has them."""
        return self.labelled_depth().labels

    def labelled_depth(self, sensor: str = "ideal") -> LabelledDepth:
        """The depth image of a sensor with its masks."""
        return self._dataset.labelled_depth(self.shard, self.id, sensor)

    @cached_property
    def truth(self) -> SceneTruth:
        """What is so in the scene, as recorded, with its images and models."""
        return self._truth_file.truth(self.id)

    @cached_property
    def scene(self) -> Scene:
        """What stands where."""
        row = self._told
        parts = (Body(part["part_id"], pose_of(part["world_from_part"])) for part in row["parts"])
        return Scene(self.id, (Body(row["assembly_id"], pose_of(row["world_from_assembly"])), *parts))

    @cached_property
    def truths(self) -> dict[str, Truth]:
        """What a scorer knows, by query id, of the queries of this split."""
        told = self._told
        return {query_id: self._truth_of(query_id, told) for query_id in self._asked}

    def truth_of(self, query_id: str) -> Truth:
        """What a scorer knows of one of the queries of this split."""
        told = self._told
        if query_id not in self._asked:
            hint = did_you_mean(query_id, self._asked)
            raise InputError(f"no query {query_id!r} in {self.id} of split {self.split.name}; {hint}see .queries")
        return self._truth_of(query_id, told)

    def bodies(self) -> list[tuple[Mesh, Pose]]:
        """Meshes with their `world_from_body`, for `kit1000.sim.render.render`: the table, the assembly, the parts."""
        geometry, (assembly, *parts) = self._dataset.geometry, self.scene.bodies
        standing = [(geometry.part(body.id).mesh, body.world_from_body) for body in parts]
        return [(table(), Pose.identity()), (geometry.assembly(assembly.id).mesh, assembly.world_from_body), *standing]

    def render(self, camera_set: str, sensor: str = "ideal", seed: int = 0) -> dict[str, View]:
        """The scene as another set of cameras sees it, by camera: `primary`, `three` or `top`, with any sensor.

        `seed` is that of the sensor's noise. Needs the truth: meshes and poses are those of the scene.
        """
        primary, bodies = self.view("ideal").world_from_camera, self.bodies()
        views = {}
        for key, (camera, pose) in cameras.camera_set(camera_set, primary).items():
            exact = View(camera, pose, render(camera, pose, bodies).depth)
            views[key or camera_set] = sense(sensor, exact, stream(seed, "noise", self.id, key, sensor))
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
            raise InputError(f"{self.id}: the truth was not opened; say dataset.split({self.split.name!r}, truth=True)")
        return self._dataset.truth_file(self.shard)

    @cached_property
    def _asked(self) -> dict[str, Row]:
        """The rows of the queries that the split asks, by id."""
        _, wanted = WANTED[self.split.name]
        rows = self._dataset.observation_file(self.shard).queries(self.id)
        return {row["id"]: row for row in rows if wanted(row)}

    @cached_property
    def _told(self) -> Row:
        """The numbers of the truth; all that poses and scores are made of."""
        return self._truth_file.row(self.id)

    @cached_property
    def _world_from_kits(self) -> list[Pose]:
        """By part."""
        return [pose_of(part["world_from_kit"]) for part in self._told["parts"]]

    def _truth_of(self, query_id: str, told: Row) -> Truth:
        geometry = self._dataset.geometry
        row = told["queries"][query_id]
        part = told["parts"][row["part"]]
        world_from_part = self.scene.bodies[1 + row["part"]].world_from_body
        return Truth(
            query_id=query_id,
            assembly_id=told["assembly_id"],
            part_id=part["part_id"],
            family=part["family"],
            rest_mode=part["rest_mode"],
            kits=len(geometry.assemblies[told["assembly_id"]]["mounts"]),
            visible=part["visible"],
            anchor=world_from_part.xyz,
            world_from_part=world_from_part,
            world_from_kit=self._world_from_kits[row["part"]],
            slot=geometry.slot(part["part_id"]),
            goal_drawn=pose_of(row["goal_drawn"]),
        )
