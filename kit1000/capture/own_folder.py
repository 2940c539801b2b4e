"""A dataset folder of own scenes: all that commands read of a dataset, but ground truth, parts and kits."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from kit1000.capture.options import LICENCE
from kit1000.capture.own_scene import OwnScene
from kit1000.dataset.json_rows import FORMAT
from kit1000.dataset.mcap_io import ObservationWriter
from kit1000.dataset.own_scenes import OWN, PLACES, TABLES
from kit1000.dataset.scene_data import SCENES_PER_SHARD, Observation
from kit1000.errors import InputError
from kit1000.files import json_bytes, new_folder, with_checksum, write_bytes, write_json
from kit1000.perception.sensor_facts import KEY
from kit1000.pictures.scene_preview import scene_picture
from kit1000.queries.pivots import part_pivots
from kit1000.queries.tracks import query_id

TASKS = ("snap", "place")  # whose tracks are named by them and the key of the view
PRESET = DATA_VERSION = "own"
ID_DIGITS = 16
SHAPES = ("parts.json", "kits.json", "assemblies.json")


def write_own_folder(
    folder: Path,
    scenes: Sequence[OwnScene],
    clearance: float | None = None,
    licence: str = LICENCE,
    one_scene: bool = False,
) -> None:
    """Write the folder: it appears when it is complete, or not at all.

    Args:
        folder: must not exist.
        scenes: of one sensor.
        clearance: [m] between parts and the walls of their cavities; None: not known.
        licence: of the images, for the recordings.
        one_scene: whether they show the same bodies in one world, from several places of the camera.

    Raises:
        InputError: the folder exists or cannot be written, or a scene has no part.
    """
    sensor = scenes[0].facts.kind.name
    observations = [_observation(f"test-s{number:04d}", scene, sensor) for number, scene in enumerate(scenes)]
    with new_folder(folder, "scene") as partial:
        files, shards = {}, {}
        for first in range(0, len(observations), SCENES_PER_SHARD):
            name = f"test/{first // SCENES_PER_SHARD:04d}.mcap"
            some = observations[first : first + SCENES_PER_SHARD]
            with ObservationWriter(partial / name, licence) as writer:
                for observation in some:
                    writer.add(observation)
            files[name], shards[name] = writer.sha256, [observation.scene_id for observation in some]
        files |= {name: write_json(partial / name, {}) for name in SHAPES}
        write_bytes(partial / "dataset.json", _summary_bytes(scenes, files, shards, clearance, licence, one_scene))


def folder_id(files: Mapping[str, str | None]) -> str:
    """The id of a folder of own scenes with files of these hashes."""
    return hashlib.sha256(json_bytes(files)).hexdigest()[:ID_DIGITS]


def tracks_of(sensor: str) -> list[str]:
    """The tracks of scenes of a sensor."""
    return [f"{task}-{sensor}" for task in TASKS]


def _observation(scene_id: str, scene: OwnScene, sensor: str) -> Observation:
    pivots = part_pivots(scene.image.view, scene.image.labels)
    if not pivots:
        raise InputError(f"{scene.source}: one body stands on the table, expected a kit and parts: put both into view")
    rows = tuple(
        {
            "id": query_id(scene_id, part, track),
            "track": track,
            "sensor": sensor,
            "part": part,
            "drawn": True,
            "pivot": pivot.tolist(),
            "guess": None,
        }
        for track in tracks_of(sensor)
        for part, pivot in pivots.items()
    )
    seen = Observation(scene_id, {sensor: scene.image.view}, scene.image.labels)
    picture = scene_picture(seen)  # without outlines about the parts: a method is asked about all of them
    return replace(seen, queries=rows, preview=picture)


def _summary_bytes(
    scenes: Sequence[OwnScene],
    files: dict[str, str | None],
    shards: dict[str, list[str]],
    clearance: float | None,
    licence: str,
    one_scene: bool,
) -> bytes:
    """The bytes of dataset.json, with a checksum of its other entries, as generated datasets have it."""
    facts = scenes[0].facts
    config = {"curve_scenes": 0, "frames": 1, "scale": 1.0, "tracks": tracks_of(facts.kind.name)}
    config |= {} if clearance is None else {"clearance": clearance}
    scene_ids = [scene_id for some in shards.values() for scene_id in some]
    outlines = [scene.outline.round(4).tolist() for scene in scenes]
    none = {"assemblies": 0, "parts": 0, "scenes": 0}
    summary = {
        "config": config,
        "counts": {"test": none | {"scenes": len(scenes)}, "train": none, "val": none},
        "data_version": DATA_VERSION,
        "dataset_id": folder_id(files),
        "files": files,
        "format": FORMAT,
        "licence": licence,
        OWN: {"sources": [scene.source for scene in scenes]},
        "preset": PRESET,
        "redraws": {},
        "refused": {},
        "refused_scenes": {},
        "seed": None,
        KEY: {facts.kind.name: facts.as_row()},
        "shards": shards,
        TABLES: dict(zip(scene_ids, outlines, strict=True)),
        **({PLACES: [scene_ids]} if one_scene else {}),
    }
    return json_bytes(with_checksum(summary))
