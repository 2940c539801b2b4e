"""The job that makes one part and its kit, redrawn until they pass all trials, and its record.

A record is a JSON file in the build folder, written after the meshes that it lists: if it exists and its hashes match,
the job is done. It also holds the reasons of the rejected attempts.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kit1000.dataset.json_rows import kit_row, part_row
from kit1000.dataset.mesh_files import glb_bytes
from kit1000.errors import InputError, Redraw
from kit1000.files import read_json, sha256, write_bytes, write_json
from kit1000.generation.plan import draw_part
from kit1000.generation.presets import Preset
from kit1000.kits.kit import UNIT_PLATE, KitDesign, Plate
from kit1000.kits.kit_trials import PairCheck, accepted_kit
from kit1000.numerics.linear_algebra import length
from kit1000.parts.family import make_part
from kit1000.parts.near_duplicates import shape_measures
from kit1000.values import Part

MAX_ATTEMPTS = 200  # draws of one part before the run fails
BUILD_FOLDER = ".build"  # folder of records while a dataset is generated


@dataclass(frozen=True)
class PartJob:
    """The arguments of a job: a procedural part to make, with its kit."""

    root: Path
    preset: Preset
    seed: int
    part_id: str
    split: str
    redraws: tuple[str, ...] = ()  # reasons of the rejected attempts so far; their number is the next attempt

    def __str__(self) -> str:
        return f"part {self.part_id}"


Record = dict[str, Any]


def make_part_and_kit(job: PartJob) -> Record:
    """Do the job unless its record exists; returns the record."""
    done = finished_record(job.root, "parts", job.part_id)
    if done is not None and len(done["redraws"]) >= len(job.redraws):
        return done
    redraws = list(job.redraws)
    while len(redraws) < MAX_ATTEMPTS:
        draw = draw_part(job.preset, job.seed, job.part_id, job.split, len(redraws))
        try:
            part = make_part(job.part_id, draw.family, draw.drawing, draw.longest)
            design, trial = accepted_kit_of(part, job.preset)
        except Redraw as refusal:
            redraws.append(refusal.reason)
        else:
            record = write_part_and_kit(job.root, part, design, trial) | {"split": job.split, "redraws": redraws}
            return save_record(job.root, "parts", job.part_id, record)
    raise Redraw(f"part {job.part_id}: none of {MAX_ATTEMPTS} draws gave a part that passes ({redraws[-1]})")


def accepted_kit_of(part: Part, preset: Preset) -> tuple[KitDesign, PairCheck]:
    """The kit of a part in a plate of the preset. Raises Redraw if none passes, or for a bulky part."""
    if length(part.mesh.extents) / 2 > preset.max_part_radius:
        raise Redraw("too bulky for the table")
    plate = Plate((preset.plate, preset.plate), UNIT_PLATE.thickness)
    return accepted_kit(part, preset.clearance, plate)


def write_part_and_kit(root: Path, part: Part, design: KitDesign, trial: PairCheck) -> Record:
    """Write the meshes of a part and its kit; returns the record of them."""
    files = write_mesh_file(root, f"parts/{part.id}.glb", glb_bytes({part.id: part.mesh}))
    files |= write_mesh_file(root, f"kits/{part.id}.glb", glb_bytes({part.id: design.kit.mesh}))
    return {
        "id": part.id,
        "files": files,
        "measures": shape_measures(part.mesh).tolist(),
        "part": part_row(part),
        "kit": kit_row(design.kit) | {"report": design.report, "keyedness": trial.keyedness},
    }


def finished_record(root: Path, kind: str, item_id: str) -> Record | None:
    """The record of a finished job; None when it is missing, or when a file of the job is missing or changed."""
    return read_intact(root, _record_path(root, kind, item_id))


def read_intact(root: Path, path: Path) -> Record | None:
    """The contents of a JSON file whose entry `files` lists SHA-256 by name; None unless all files match."""
    try:
        record = read_json(path)
    except InputError:
        return None
    files = record.get("files") if isinstance(record, dict) else None
    matches = isinstance(files, dict) and all(sha256(root / name) == digest for name, digest in files.items())
    return record if matches else None


def save_record(root: Path, kind: str, item_id: str, record: Record) -> Record:
    """Write the record of a finished job and return it."""
    write_json(_record_path(root, kind, item_id), record)
    return record


def write_mesh_file(root: Path, name: str, data: bytes) -> dict[str, str]:
    """Write one mesh file of a job; returns its entry for `files` of the record."""
    return {name: write_bytes(root / name, data)}


def _record_path(root: Path, kind: str, item_id: str) -> Path:
    return root / BUILD_FOLDER / kind / f"{item_id}.json"
