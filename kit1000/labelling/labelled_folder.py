"""Ground truth written into the folder of own scenes, which can then be scored like a generated test split.

The recording keeps its images; its masks and queries are those of the labelled parts. Meshes and tables of the shapes
are added, the truth file holds every scene whose labels are confirmed, and `dataset.json` is written last.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kit1000.capture.own_folder import tracks_of
from kit1000.dataset.json_rows import Row, assembly_row, kit_row, part_row
from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter, TruthFile, TruthWriter
from kit1000.dataset.mesh_files import glb_bytes
from kit1000.dataset.reader import Dataset
from kit1000.dataset.scene_data import LICENCE, Observation, SceneTruth
from kit1000.errors import InputError
from kit1000.files import json_bytes, locked, read_json, with_checksum, write_bytes, write_json
from kit1000.known_shapes.known_kits import KnownKits, read_known_kits
from kit1000.labelling.label_records import LabelRecord
from kit1000.labelling.scene_truth import labelled_scene
from kit1000.mesh import Mesh

SPLIT = "test"
ORIGIN = "own"  # value of `source` in the rows of shapes that a user gave


def write_truth(root: Path, records: Mapping[str, LabelRecord]) -> list[str]:
    """Write the truth of confirmed scenes, by scene id; returns the scenes of the folder that are without truth.

    Raises InputError if a body is not confirmed, or where two shapes of one name differ.
    """
    dataset = Dataset(root)
    shards = dataset.shards(SPLIT)
    tracks = dataset.summary["config"].get("tracks") or tracks_of("d415")  # folders that no import wrote may name none
    shapes = {scene_id: read_known_kits(record.source) for scene_id, record in records.items()}
    made: dict[str, tuple[Observation, SceneTruth]] = {}
    for scene_id, record in records.items():
        if scene_id not in shards:
            raise InputError(f"{root}: no scene {scene_id!r} among {len(shards)} of split {SPLIT}")
        observation = ObservationFile(root / f"{shards[scene_id]}.mcap").observation(scene_id)
        made[scene_id] = labelled_scene(observation, record, shapes[scene_id], tracks)
    with locked(root):
        files, tables = _shape_files(root, list(shapes.values()))
        for name, data in files.items():
            write_bytes(root / name, data)
        written = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
        written |= {f"{name}.json": write_json(root / f"{name}.json", rows) for name, rows in tables.items()}
        without: list[str] = []
        for shard in sorted({shards[scene_id] for scene_id in records}):
            hashes, missing = _write_shard(root, shard, made, dataset.summary.get("licence", LICENCE))
            written, without = written | hashes, without + missing
        without += [i for i, shard in shards.items() if not (root / f"{shard}.truth.mcap").is_file()]
        _write_summary(root, dataset.summary, written, tables)
    return sorted(set(without))


def _write_shard(
    root: Path, shard: str, made: Mapping[str, tuple[Observation, SceneTruth]], licence: str
) -> tuple[dict[str, str], list[str]]:
    """Write both recordings of a shard anew; returns the SHA-256 of each, and the scenes without truth."""
    seen_path, truth_path = root / f"{shard}.mcap", root / f"{shard}.truth.mcap"
    recorded = ObservationFile(seen_path)
    known = TruthFile(truth_path) if truth_path.is_file() else None
    had = () if known is None else known.scene_ids
    observations = [made[i][0] if i in made else recorded.observation(i) for i in recorded.scene_ids]
    truths = [made[i][1] if i in made else known.truth(i) for i in recorded.scene_ids if i in made or i in had]  # type: ignore[union-attr]
    hashes = {}
    with TruthWriter(truth_path, licence) as truth_writer:
        for truth in truths:
            truth_writer.add(truth)
    with ObservationWriter(seen_path, licence) as writer:
        for observation in observations:
            writer.add(observation)
    for path, one in ((seen_path, writer), (truth_path, truth_writer)):
        assert one.sha256 is not None, "a shard has a scene"
        hashes[path.relative_to(root).as_posix()] = one.sha256
    return hashes, sorted(set(recorded.scene_ids) - set(made) - set(had))


def _shape_files(root: Path, shapes: list[KnownKits]) -> tuple[dict[str, bytes], dict[str, dict[str, Row]]]:
    """The mesh files of shapes by name, and the tables with their rows added."""
    tables = {name: dict(read_json(root / f"{name}.json")) for name in ("parts", "kits", "assemblies")}
    files: dict[str, bytes] = {}

    def add(kind: str, item_id: str, row: Row, mesh: Mesh) -> None:
        name, data = f"{kind}/{item_id}.glb", glb_bytes({item_id: mesh})
        full = row | {"split": SPLIT, "source": ORIGIN}
        other = files.get(name) or ((root / name).read_bytes() if item_id in tables[kind] else data)
        if other != data:
            raise InputError(f"{root}: another shape is named {item_id!r} there: rename the file of one of the two")
        files[name], tables[kind][item_id] = data, full

    for kits in shapes:
        add("assemblies", kits.assembly.id, assembly_row(kits.assembly), kits.assembly.mesh)
        for mount, part in zip(kits.assembly.mounts, kits.parts, strict=True):
            add("parts", part.id, part_row(part) | {"redraws": []}, part.mesh)
            add("kits", mount.kit.id, kit_row(mount.kit), mount.kit.mesh)
    return files, tables


def _write_summary(
    root: Path, summary: Mapping[str, Any], written: Mapping[str, str], tables: Mapping[str, Mapping[str, Row]]
) -> None:
    """Write `dataset.json` with the new files and counts, and its checksum anew where it has one."""
    counts = {key: dict(value) for key, value in summary.get("counts", {}).items()}
    counts[SPLIT] = counts.get(SPLIT, {}) | {name: len(tables[name]) for name in ("parts", "assemblies")}
    plain = {key: value for key, value in summary.items() if key != "checksum"}
    clearances = {row["clearance"] for row in tables["kits"].values()}
    if len(clearances) == 1:  # which generated datasets tell too
        plain["config"] = {"clearance": clearances.pop()} | summary["config"]
    plain |= {"counts": counts, "files": dict(summary.get("files", {})) | dict(written)}
    write_bytes(root / "dataset.json", json_bytes(with_checksum(plain) if "checksum" in summary else plain))
