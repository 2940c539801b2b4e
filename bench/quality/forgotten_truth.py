"""Own scenes made of generated ones: one noisy view in millimetres and its masks, everything else forgotten.

So a program that takes a user's own depth images can be measured against a truth that it cannot see.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_closing, binary_opening, label

from kit1000.capture.own_folder import tracks_of
from kit1000.dataset.mcap_io import ObservationWriter
from kit1000.dataset.reader import RecordedScene
from kit1000.dataset.schema import Observation
from kit1000.dataset.tables import FORMAT
from kit1000.files import with_checksum, write_json
from kit1000.pictures.png_files import png_bytes
from kit1000.pictures.scene_preview import scene_picture
from kit1000.sim.sensors import DEPTH_GRID
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View

SENSOR = "d415"
UNIT = 1e-3  # [m] of the depths of most recordings
LOWEST = 4e-3  # [m] above the table, of a pixel that shows a body
SMALLEST = 150  # [px] of a body


def forgotten_image(recorded: RecordedScene, unit: float = UNIT, masks: str = "given") -> LabelledDepth:
    """The noisy image of a scene as a camera hands it out, rounded to a unit [m].

    masks: given, or from depth: everything above the table, each piece by the name of the body that it shows most of.
    """
    image = recorded.labelled_depth(SENSOR)
    steps = np.float32(unit / DEPTH_GRID)
    depth = np.rint(np.rint(image.view.depth / np.float32(unit)) * steps) * np.float32(DEPTH_GRID)
    view = View(image.view.camera, image.view.world_from_camera, depth)
    labels = image.labels if masks == "given" else _masks_from_depth(view, image.labels)
    return LabelledDepth(view, labels)


def _masks_from_depth(view: View, labels: np.ndarray) -> np.ndarray:
    """(H, W) uint8 masks of what stands above z = 0, with the fattened edges of the sensor."""
    heights = view.world_from_camera.apply(view.camera.unproject(view.depth))[..., 2]
    above = (view.depth > 0) & (heights > LOWEST)
    pieces, count = label(binary_closing(binary_opening(above, iterations=1), iterations=2))  # type: ignore[misc]
    found = np.zeros_like(labels)
    for piece in range(1, count + 1):
        inside = pieces == piece
        names = labels[inside]
        if inside.sum() >= SMALLEST and (names > 0).any():
            found[inside] = np.bincount(names[names > 0]).argmax()
    return np.where(above, found, 0).astype(np.uint8)


def write_forgotten(folder: Path, scenes: Mapping[str, LabelledDepth], clearance: float) -> Path:
    """A folder of own scenes without truth, as an import writes it: images by scene id, such as test-s0000.

    clearance: [m] of the kits.
    """
    with ObservationWriter(folder / "test" / "0000.mcap") as writer:
        for scene_id, image in scenes.items():
            seen = Observation(scene_id, {SENSOR: image.view}, image.labels, _queries(scene_id, image.labels))
            writer.add(Observation(scene_id, seen.views, seen.labels, seen.queries, png_bytes(scene_picture(seen))))
    files = {f"{name}.json": write_json(folder / f"{name}.json", {}) for name in ("parts", "kits", "assemblies")}
    files["test/0000.mcap"] = writer.sha256 or ""
    config = {"clearance": clearance, "scale": 1.0, "curve_scenes": 0, "frames": 1, "tracks": tracks_of(SENSOR)}
    summary = {"format": FORMAT, "dataset_id": "0123456789abcdef", "data_version": "1.0.0", "config": config}
    summary |= {"shards": {"test/0000.mcap": list(scenes)}, "files": files, "preset": "own"}
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
