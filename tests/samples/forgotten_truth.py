"""Folders of own scenes without truth, as an import writes them, made of known images."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kit1000.capture.own_folder import tracks_of
from kit1000.dataset.json_rows import FORMAT
from kit1000.dataset.mcap_io import ObservationWriter
from kit1000.dataset.scene_data import Observation
from kit1000.files import with_checksum, write_json
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pictures.scene_preview import scene_picture
from kit1000.values import FIRST_PART_LABEL, LabelledDepth

SENSOR = "d415"


def write_forgotten(folder: Path, scenes: Mapping[str, LabelledDepth], clearance: float) -> Path:
    """A folder of own scenes without truth, as an import writes it: images by scene id, such as test-s0000.

    clearance: [m] of the kits.
    """
    with ObservationWriter(folder / "test" / "0000.mcap") as writer:
        for scene_id, image in scenes.items():
            seen = Observation(scene_id, {SENSOR: image.view}, image.labels, _queries(scene_id, image.labels))
            writer.add(Observation(scene_id, seen.views, seen.labels, seen.queries, scene_picture(seen)))
    files = {f"{name}.json": write_json(folder / f"{name}.json", {}) for name in ("parts", "kits", "assemblies")}
    files["test/0000.mcap"] = writer.sha256 or ""
    config = {"clearance": clearance, "scale": 1.0, "curve_scenes": 0, "frames": 1, "tracks": tracks_of(SENSOR)}
    summary = {"format": FORMAT, "dataset_id": "0123456789abcdef", "data_version": "1.0.0", "config": config}
    summary |= {"shards": {"test/0000.mcap": list(scenes)}, "files": files, "preset": "own"}
    summary["sensors"] = {SENSOR: SensorFacts(fattening_px=0.0).as_row()}  # noise, but sharp edges
    write_json(folder / "dataset.json", with_checksum(summary))
    return folder


def _queries(scene_id: str, labels: np.ndarray) -> tuple[dict, ...]:
    parts = [int(i) - FIRST_PART_LABEL for i in np.unique(labels) if i >= FIRST_PART_LABEL]
    common = {"sensor": SENSOR, "drawn": True, "pivot": [0.0, 0.0, 0.0], "guess": None}
    return tuple(
        {"id": f"{scene_id}-p{part}-{track}", "track": track, "part": part} | common
        for part in parts
        for track in tracks_of(SENSOR)
    )
