"""The job that makes one part and its kit, redrawn until they pass all trials, and its record.

A record is a JSON file in the build folder, written after the meshes that it lists: if it exists and its hashes match,
the job is done. It also holds the reasons of the rejected attempts.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kit1000.dataset.mesh_files import glb_bytes
from kit1000.dataset.tables import kit_row, part_row
from kit1000.errors import InputError, MeshRefused, Redraw, internal_error
from kit1000.files import read_json, sha256, write_bytes, write_json
from kit1000.generation.plan import draw_longest, draw_part
from kit1000.generation.presets import Preset
from kit1000.kits.acceptance import PairCheck
from kit1000.kits.choice import accepted_kit
from kit1000.kits.kit import UNIT_PLATE, KitDesign, Plate
from kit1000.kits.printable_mesh import GRID, closed_on_grid
from kit1000.mesh import Mesh, defect_float32
from kit1000.numerics.linear_algebra import length
from kit1000.parts.family import make_part, part_of_mesh
from kit1000.parts.files.read import read_mesh
from kit1000.parts.near_duplicates import shape_measures
from kit1000.values import Part

MAX_ATTEMPTS = 200  # draws of one part before the run fails
BUILD_FOLDER = ".build"  # folder of records while a dataset is generated


@dataclass(frozen=True)
class PartJob:
    """The arguments of a job: a part to make, with its kit."""

    root: Path
    preset: Preset
    seed: int
    part_id: str
    split: str
    sources: tuple[tuple[str, Path], ...] = ()
    """Names and paths of mesh files, tried in order; a procedural part is drawn when empty."""
    unit: str | None = None
    redraws: tuple[str, ...] = ()
    """Reasons of the rejected attempts so far; their number is the next attempt."""

    def __str__(self) -> str:
        return f"part {self.part_id}"


Record = dict[str, Any]


def make_part_and_kit(job: PartJob) -> Record:
    """Do the job unless its record exists; returns the record."""
    done = finished_record(job.root, "parts", job.part_id)
    if done is not None and len(done["redraws"]) >= len(job.redraws) and not _has_more_files(job, done):
        return done
    return save_record(job.root, "parts", job.part_id, _from_files(job) if job.sources else _from_draws(job))


def _has_more_files(job: PartJob, done: Record) -> bool:
    """Whether a job names files that its refused record has not tried."""
    return "refused" in done and len(job.sources) > len(done["redraws"])


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


def _from_draws(job: PartJob) -> Record:
    redraws = list(job.redraws)
    while len(redraws) < MAX_ATTEMPTS:
        draw = draw_part(job.preset, job.seed, job.part_id, job.split, len(redraws))
        try:
            part = make_part(job.part_id, draw.family, draw.drawing, draw.longest)
            return _record(job, part, *_accepted_kit(job, part), redraws)
        except Redraw as refusal:
            redraws.append(refusal.reason)
    raise Redraw(f"part {job.part_id}: none of {MAX_ATTEMPTS} draws gave a part that passes ({redraws[-1]})")


def _from_files(job: PartJob) -> Record:
    """The record of the first file that can be a part; a record with `refused` when there is none."""
    redraws = list(job.redraws)
    while len(redraws) < len(job.sources):
        name, path = job.sources[len(redraws)]
        try:
            part, design, trial = _part_and_kit_of_file(job, path)
        except (MeshRefused, Redraw) as refusal:
            redraws.append(refusal.reason)
        except Exception as error:  # a user's mesh may trigger an unforeseen case: it is reported and the run continues
            redraws.append(str(internal_error("no kit", error)))
        else:
            return _record(job, part, design, trial, redraws) | {"source": name, "tried": _names(job, redraws)}
    tried = _names(job, redraws)
    return {"id": job.part_id, "split": job.split, "files": {}, "redraws": redraws, "refused": True, "tried": tried}


def _names(job: PartJob, redraws: Sequence[str]) -> list[str]:
    """The names of the files that were refused, in their order."""
    return [name for name, _ in job.sources[: len(redraws)]]


def _part_and_kit_of_file(job: PartJob, path: Path) -> tuple[Part, KitDesign, PairCheck]:
    """The part of a mesh file with its kit, at the size drawn or, where that is refused, at the preset's largest.

    In a larger part the clearance is smaller beside it, and a plate is higher. Raises MeshRefused when the file is no
    solid, and Redraw with the reason at the size drawn.
    """
    mesh = read_mesh(path, job.unit).mesh
    try:
        part = part_of_size(job, mesh, draw_longest(job.preset, job.seed, job.part_id))
        return part, *_accepted_kit(job, part)
    except Redraw as refusal:
        with suppress(Redraw):
            part = part_of_size(job, mesh, job.preset.longest[1])
            return part, *_accepted_kit(job, part)
        raise refusal from None


def _accepted_kit(job: PartJob, part: Part) -> tuple[KitDesign, PairCheck]:
    """The kit of a part in a plate of the preset. Raises Redraw when none passes, or for a bulky part."""
    if length(part.mesh.extents) / 2 > job.preset.max_part_radius:
        raise Redraw("too bulky for the table")
    plate = Plate((job.preset.plate, job.preset.plate), UNIT_PLATE.thickness)
    return accepted_kit(part, job.preset.clearance, plate)


def part_of_size(job: PartJob, mesh: Mesh, longest: float) -> Part:
    """The part of a mesh scaled to a longest side [m], closed as files hold it. Raises MeshRefused when it opens."""
    part = part_of_mesh(job.part_id, mesh, longest)
    if defect_float32(part.mesh) is None:
        return part
    closed, fault = closed_on_grid(part.mesh, GRID)
    if fault is not None:
        raise MeshRefused(f"opens when files round it to float32: {fault}")
    return replace(part, mesh=closed)


def _record(job: PartJob, part: Part, design: KitDesign, trial: PairCheck, redraws: list[str]) -> Record:
    files = write_mesh_file(job.root, f"parts/{part.id}.glb", glb_bytes({part.id: part.mesh}))
    files |= write_mesh_file(job.root, f"kits/{part.id}.glb", glb_bytes({part.id: design.kit.mesh}))
    return {
        "id": part.id,
        "split": job.split,
        "files": files,
        "redraws": redraws,
        "measures": shape_measures(part.mesh).tolist(),
        "part": part_row(part),
        "kit": kit_row(design.kit) | {"report": design.report, "keyedness": trial.keyedness},
    }
