"""Small sample contents of `dataset.json`, for tests of the data card and the Croissant description."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.dataset.json_rows import FORMAT, pose_row
from kit1000.dataset.scene_data import SceneTruth
from kit1000.generation.statistics import add_up, part_statistics, scene_statistics
from kit1000.pose import Pose

SYMMETRY = {"name": "C2", "rotations": [], "axis": None}


def truth(scene_id: str = "test-s0000", tilts: tuple[float, ...] = (0.0, 45.0), off: float = 0.02) -> SceneTruth:
    """A scene with a part for each tilt [deg], and queries with guesses that are wrong by `off` [m]."""
    rows = tuple(
        {
            "part_id": f"test-{i:04d}",
            "family": "tee",
            "mount": i,
            "rest_mode": ("upright", "tumbled")[i % 2],
            "world_from_part": pose_row(Pose.identity()),
            "world_from_kit": pose_row(Pose.from_rotvec([0.0, np.radians(tilt), 0.0]) @ Pose.from_rotvec([0, 0, 1.0])),
            "pixels": 800 * (i + 1),
            "visible": 1.0,
            "slot_angle": 0.5,
            "slot_visible": 0.5,
            "unseen": None if i == 0 else "slot seen at a grazing angle",
        }
        for i, tilt in enumerate(tilts)
    )
    draw = {"goal": 0, "turn": 0.0, "offset": [off, 0.0, 0.0], "rotvec": [0.0, 0.1, 0.0]}
    asked = {f"{scene_id}-p0-snap-tilt": draw, f"{scene_id}-p0-place-paper": None}
    asked[f"{scene_id.replace('test-', 'curves-')}-p0-pos3-rot1"] = draw
    queries = {i: {"part": 0, "goal_drawn": pose_row(Pose.identity()), "draw": row} for i, row in asked.items()}
    return SceneTruth(scene_id, "test-0000", Pose.identity(), rows, queries, np.zeros((1, 1), np.uint16))


def tables() -> dict[str, dict[str, Any]]:
    """Rows of the tables, with the entries that the descriptions use."""
    ids = [f"{split}-{i:04d}" for split in ("train", "val", "test") for i in range(2)]
    part = {"family": "tee", "mass": 0.05, "volume": 2e-5, "symmetry": SYMMETRY}
    kit = {"clearance": 0.0025, "depth": 0.0184, "keyedness": 0.4}
    return {
        "parts": {i: part | {"split": i.partition("-")[0]} for i in ids},
        "kits": {i: kit | {"split": i.partition("-")[0], "part_id": i} for i in ids},
        "assemblies": {i: {"split": i.partition("-")[0], "target": i} for i in ids},
    }


def summary(folder: Path | None = None) -> dict[str, Any]:
    """The summary of a full dataset; its tables are written to `folder` if given."""
    files = {name: hashlib.sha256(name.encode()).hexdigest() for name in _names()}
    for name, rows in tables().items():
        data = json.dumps(rows).encode()
        files[f"{name}.json"] = hashlib.sha256(data).hexdigest()
        if folder is not None:
            (folder / f"{name}.json").write_bytes(data)
    figures = [
        scene_statistics([truth(), truth("test-s0001")]),
        part_statistics(*(tables()[k].values() for k in PAIRS)),
    ]
    return {
        "format": FORMAT,
        "data_version": "1.0.0",
        "dataset_id": "0123456789abcdef",
        "licence": "CC-BY-4.0",
        "preset": "tiny",
        "seed": 7,
        "config": {"longest": [0.035, 0.05], "clearance": 0.0025, "kits": [2, 5], "tilt_deg": [10.0, 45.0]},
        "held_out_families": ["gear", "tee"],
        "counts": {split: {"parts": 2, "assemblies": 2, "scenes": 2} for split in ("train", "val", "test")},
        "redraws": {"parts": {"loose fit": 3, "near-duplicate": 11}, "assemblies": {}, "scenes": {"parts touch": 2}},
        "refused": {},
        "refused_scenes": {"val-s0001": "out of view"},
        "statistics": {"train": {}, "val": {}, "test": add_up(figures)},
        "shards": {f"{split}/0000.mcap": [f"{split}-s0000", f"{split}-s0001"] for split in ("train", "val", "test")},
        "files": files,
    }


PAIRS = ("parts", "kits")


def withheld(folder: Path | None = None) -> dict[str, Any]:
    """The summary of the public part of a dataset with a withheld test split."""
    whole = summary(folder)
    secret = ("plan.json", "test/0000.truth.mcap")
    files = {i: h for i, h in whole["files"].items() if i not in secret and "/test-" not in i}
    return whole | {
        "seed": None,
        "refused_scenes": {},
        "statistics": {split: whole["statistics"][split] for split in ("train", "val")},
        "withheld": {"split": "test", "salted_sha256": "0" * 64},
        "files": files,
    }


def _names() -> list[str]:
    meshes = [f"{kind}/{split}-0000.glb" for kind in ("parts", "kits", "assemblies") for split in ("train", "test")]
    shards = [f"{split}/0000{end}" for split in ("train", "val", "test") for end in (".mcap", ".truth.mcap")]
    return ["plan.json", "test/0000.three.mcap", *meshes, *shards]
