"""Folders of labelled scenes joined into one, as contributions become the real split.

Scenes are numbered anew, in the order of the folders, so that ids are unique; what came before keeps its numbers when
it is named first. A recording has one licence, so scenes of two folders never share one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kit1000.capture.own_folder import PRESET, folder_id
from kit1000.dataset.json_rows import Row
from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter, TruthFile, TruthWriter
from kit1000.dataset.own_scenes import JOINED, LABELS, OWN, PLACES, TABLES, groups_of_places
from kit1000.dataset.reader import Dataset
from kit1000.dataset.scene_data import SCENES_PER_SHARD, Observation, SceneTruth
from kit1000.errors import InputError, shown
from kit1000.files import json_bytes, new_folder, read_json, sha256, with_checksum, write_bytes, write_json
from kit1000.labelling.label_records import LabelRecord, read_record, record_path, write_record
from kit1000.labelling.labelled_folder import SPLIT
from kit1000.perception.sensor_facts import KEY, SCENE_KEY

SHAPES = ("parts", "kits", "assemblies")
SAME = ("format", "data_version")
SAME_CONFIG = ("tracks", "scale", "frames")
NOT_STATED = "not stated"


@dataclass(frozen=True, eq=False)
class _Scene:
    """A labelled scene, and where it comes from."""

    root: Path
    shard: str
    record: LabelRecord
    origin: Row
    """{"dataset_id", "scene_id", "licence", "confirmed_by"} of the folder that was labelled."""
    source: str
    sensors: Row
    outline: Any

    @property
    def key(self) -> tuple[str, str]:
        return self.origin["dataset_id"], self.origin["scene_id"]


def join_folders(folders: Sequence[Path], out: Path) -> list[str]:
    """Join folders into a new one; returns a line for each of them.

    Raises InputError, and writes nothing, where a folder is not wholly labelled or damaged, is of another version or
    asks other tracks than the first, or where a scene or the name of a shape comes twice.
    """
    if not folders:
        raise InputError("DIR: expected folders of labelled scenes")
    datasets = [Dataset(folder) for folder in folders]
    for dataset in datasets:
        _check(dataset, datasets[0])
    scenes = [list(_scenes(dataset)) for dataset in datasets]
    _check_unique([scene for some in scenes for scene in some])
    tables, meshes = _shapes(datasets)
    with new_folder(out, "joined scenes") as partial:
        files = {f"{name}.json": write_json(partial / f"{name}.json", rows) for name, rows in tables.items()}
        files |= {name: write_bytes(partial / name, data) for name, data in meshes.items()}
        shards, named = _write_scenes(partial, scenes, files)
        write_bytes(partial / "dataset.json", _summary_bytes(datasets, named, files, shards, tables))
    return [_line(dataset.root, some) for dataset, some in zip(datasets, scenes, strict=True)]


def _check(dataset: Dataset, first: Dataset) -> None:
    """Raise InputError if a folder is no part of a split with the first one, or is damaged."""
    root, summary = dataset.root, dataset.summary
    if "plan.json" in summary.get("files", {}) or (root / "plan.json").is_file():
        raise InputError(f"{root}: a generated dataset, expected scenes of a camera")
    for stated, known, names in (
        (summary, first.summary, SAME),
        (summary.get("config", {}), first.summary.get("config", {}), SAME_CONFIG),
    ):
        for name in names:
            if stated.get(name) != known.get(name):
                ours, theirs = shown(str(stated.get(name))), shown(str(known.get(name)))
                raise InputError(f"{root}: {name} {ours}, {first.root} has {theirs}: they are no one split")
    if not dataset.shards(SPLIT):
        raise InputError(f"{root}: no scenes in split {SPLIT}")
    without = [i for i, shard in dataset.shards(SPLIT).items() if not _has_truth(root / f"{shard}.truth.mcap", i)]
    if without:
        raise InputError(f"{root}: no ground truth of {', '.join(without[:4])}: kit1000 label {root}, then confirm")
    if with_checksum(summary) != dict(summary):
        raise InputError(f"{root}: dataset.json: changed since it was written; kit1000 verify {root} lists all")
    for name, digest in summary.get("files", {}).items():
        if sha256(root / name) != digest:
            raise InputError(f"{root}: {name}: missing or changed; kit1000 verify {root} lists all")


def _has_truth(path: Path, scene_id: str) -> bool:
    return path.is_file() and scene_id in TruthFile(path).scene_ids


def _scenes(dataset: Dataset) -> Iterator[_Scene]:
    """The scenes of a folder, in order. Raises InputError if the labels of one are not confirmed any more."""
    summary, own = dataset.summary, dataset.summary.get(OWN, {})
    shards = dataset.shards(SPLIT)
    sources = dict(zip(shards, own.get("sources", ()), strict=False))
    for scene_id, shard in shards.items():
        if not record_path(dataset.root, scene_id).is_file():
            raise InputError(f"{dataset.root}: no {LABELS}/{scene_id}.json, which says who confirmed the labels")
        record = read_record(dataset.root, scene_id)
        if not record.confirmed:
            raise InputError(f"{dataset.root}: {scene_id} was labelled again and is not confirmed: --confirm it")
        origin = own.get(JOINED, {}).get(scene_id) or {
            "dataset_id": dataset.id,
            "scene_id": scene_id,
            "licence": ObservationFile(dataset.root / f"{shard}.mcap").record.get("licence", NOT_STATED),
            "confirmed_by": sorted({body.confirmed_by or "" for body in record.bodies}),
        }
        sensors = summary.get(SCENE_KEY, {}).get(scene_id) or summary.get(KEY, {})
        outline = summary.get(TABLES, {}).get(scene_id)
        yield _Scene(dataset.root, shard, record, origin, sources.get(scene_id, NOT_STATED), sensors, outline)


def _check_unique(scenes: Sequence[_Scene]) -> None:
    seen: dict[tuple[str, str], Path] = {}
    for scene in scenes:
        if scene.key in seen:
            raise InputError(f"{scene.root}: its scene {scene.record.scene_id} is already in {seen[scene.key]}")
        seen[scene.key] = scene.root


def _shapes(datasets: Sequence[Dataset]) -> tuple[dict[str, dict[str, Row]], dict[str, bytes]]:
    """The tables of all folders together, and their mesh files by name."""
    tables: dict[str, dict[str, Row]] = {name: {} for name in SHAPES}
    meshes: dict[str, bytes] = {}
    for dataset in datasets:
        for kind in SHAPES:
            for item_id, row in read_json(dataset.root / f"{kind}.json").items():
                name = f"{kind}/{item_id}.glb"
                data = _bytes(dataset.root / name)
                if tables[kind].setdefault(item_id, row) != row or meshes.setdefault(name, data) != data:
                    raise InputError(f"{dataset.root}: its {name} differs from one of that name in another folder")
    return tables, meshes


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error


def _write_scenes(
    partial: Path, scenes: Sequence[Sequence[_Scene]], files: dict[str, str]
) -> tuple[dict[str, list[str]], dict[str, _Scene]]:
    """Write recordings and labels, and add their hashes to `files`; returns shards, and the scenes by their new ids."""
    shards: dict[str, list[str]] = {}
    named: dict[str, _Scene] = {}
    for batch in _batches(scenes):
        name = f"{SPLIT}/{len(shards):04d}"
        licence = batch[0].origin["licence"]
        seen = ObservationWriter(partial / f"{name}.mcap", licence)
        known = TruthWriter(partial / f"{name}.truth.mcap", licence)
        ids = [f"{SPLIT}-s{len(named) + i:04d}" for i in range(len(batch))]
        with known, seen:
            for scene_id, scene in zip(ids, batch, strict=True):
                observation, truth = _renamed(scene, scene_id)
                seen.add(observation)
                known.add(truth)
        for scene_id, scene in zip(ids, batch, strict=True):
            files |= _write_labels(partial, scene, scene_id)
        for writer in (seen, known):
            assert writer.sha256 is not None, "a shard has a scene"
            files[writer.path.relative_to(partial).as_posix()] = writer.sha256
        shards[f"{name}.mcap"] = ids
        named |= dict(zip(ids, batch, strict=True))
    return shards, named


def _batches(scenes: Sequence[Sequence[_Scene]]) -> Iterator[list[_Scene]]:
    """The scenes of each recording: of one folder and one licence."""
    for some in scenes:
        batch: list[_Scene] = []
        for scene in some:
            if batch and (len(batch) == SCENES_PER_SHARD or scene.origin["licence"] != batch[0].origin["licence"]):
                yield batch
                batch = []
            batch.append(scene)
        yield batch


def _renamed(scene: _Scene, scene_id: str) -> tuple[Observation, SceneTruth]:
    """The recorded scene under another id."""
    old = scene.record.scene_id
    observation = ObservationFile(scene.root / f"{scene.shard}.mcap").observation(old)
    truth = TruthFile(scene.root / f"{scene.shard}.truth.mcap").truth(old)

    def new(query: str) -> str:
        return scene_id + query.removeprefix(old)

    queries = tuple({**row, "id": new(row["id"])} for row in observation.queries)
    truths = {new(query): row for query, row in truth.queries.items()}
    return replace(observation, scene_id=scene_id, queries=queries), replace(truth, scene_id=scene_id, queries=truths)


def _write_labels(partial: Path, scene: _Scene, scene_id: str) -> dict[str, str]:
    """Write the labels of a scene and its picture; returns the hashes by file name."""
    picture = record_path(scene.root, scene.record.scene_id).with_suffix(".png")
    path = write_record(partial, replace(scene.record, scene_id=scene_id))
    files = {f"{LABELS}/{path.name}": sha256(path) or ""}
    if picture.is_file():
        name = f"{LABELS}/{scene_id}.png"
        files[name] = write_bytes(partial / name, _bytes(picture))
    return files


def _summary_bytes(
    datasets: Sequence[Dataset],
    named: Mapping[str, _Scene],
    files: Mapping[str, str],
    shards: Mapping[str, list[str]],
    tables: Mapping[str, Mapping[str, Row]],
) -> bytes:
    """The bytes of dataset.json: what all folders state, and of each scene what only its folder states."""
    first = datasets[0].summary
    none = {"assemblies": 0, "parts": 0, "scenes": 0}
    counts = {"scenes": len(named)} | {name: len(tables[name]) for name in ("parts", "assemblies")}
    config = {key: value for key, value in first.get("config", {}).items() if key != "clearance"}
    clearances = {row["clearance"] for row in tables["kits"].values()}
    licences = sorted({scene.origin["licence"] for scene in named.values()})
    new_ids = {(scene.root, scene.record.scene_id): scene_id for scene_id, scene in named.items()}
    groups = [(dataset.root, group) for dataset in datasets for group in groups_of_places(dataset.summary)]
    places = [[new_ids[root, scene_id] for scene_id in group] for root, group in groups]
    summary = {
        **{key: first.get(key) for key in SAME},
        "config": config | ({"clearance": clearances.pop()} if len(clearances) == 1 else {}),
        "counts": {SPLIT: counts, "train": none, "val": none},
        "dataset_id": folder_id(files),
        "files": dict(files),
        "licence": "; ".join(licences),
        OWN: {
            "sources": [scene.source for scene in named.values()],
            JOINED: {scene_id: scene.origin for scene_id, scene in named.items()},
        },
        "preset": PRESET,
        **{key: {} for key in ("redraws", "refused", "refused_scenes")},
        "seed": None,
        KEY: next((scene.sensors for scene in named.values() if scene.sensors), {}),
        SCENE_KEY: {scene_id: scene.sensors for scene_id, scene in named.items() if scene.sensors},
        "shards": dict(shards),
        **({PLACES: places} if places else {}),
        TABLES: {scene_id: scene.outline for scene_id, scene in named.items() if scene.outline is not None},
    }
    return json_bytes(with_checksum(summary))


def _line(root: Path, scenes: Sequence[_Scene]) -> str:
    licences = ", ".join(sorted({shown(scene.origin["licence"]) for scene in scenes}))
    people = ", ".join(sorted({shown(name) for scene in scenes for name in scene.origin["confirmed_by"]}))
    return f"{root}: {len(scenes)} scenes, licence {licences}, confirmed by {people}"
