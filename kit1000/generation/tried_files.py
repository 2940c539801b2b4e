"""Mesh files of a user as parts of a dataset: each file is tried, then the accepted ones are dealt to the splits."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.dataset.mesh_files import glb_bytes, read_glb
from kit1000.errors import MeshRefused, Redraw, internal_error, shown
from kit1000.generation.parts_and_kits import (
    Record,
    accepted_kit_of,
    finished_record,
    save_record,
    write_mesh_file,
    write_part_and_kit,
)
from kit1000.generation.plan import Sources, draw_longest, file_order
from kit1000.generation.presets import Preset
from kit1000.kits.printable_mesh import GRID, closed_on_grid
from kit1000.mesh import Mesh, defect_float32
from kit1000.parts.family import part_of_mesh
from kit1000.parts.files.read import read_mesh
from kit1000.parts.near_duplicates import near_duplicate_of
from kit1000.queries.tracks import SPLITS
from kit1000.values import Part

Run = Callable[[list["FileJob"]], dict[str, Record]]
"""Runs jobs and returns their records by id."""


@dataclass(frozen=True)
class FileJob:
    """The arguments of a job: a mesh file to make a part and its kit of."""

    root: Path
    preset: Preset
    seed: int
    name: str
    path: Path
    unit: str | None

    def __str__(self) -> str:
        return f"file {shown(self.name)}"

    @property
    def id(self) -> str:
        """A name for its files, whatever characters the name of the mesh file has."""
        return hashlib.sha256(self.name.encode("utf-8", "surrogateescape")).hexdigest()[:16]


@dataclass(frozen=True)
class TriedFiles:
    """The outcome of trying mesh files."""

    accepted: dict[str, Record]  # records of the files that can be parts, by name, in the drawn order
    refused: dict[str, str]  # reasons by name
    untried: int  # number of files that were not needed


def try_files(root: Path, preset: Preset, seed: int, sources: Sources, run: Run) -> TriedFiles:
    """Try mesh files in the drawn order until there are enough parts; near-duplicates of accepted parts are refused."""
    order = file_order(seed, sources)
    needed = sum(preset.count(split) for split in SPLITS)
    accepted: dict[str, Record] = {}
    refused: dict[str, str] = {}
    tried = 0
    while len(accepted) < needed and tried < len(order):
        names = order[tried : tried + needed - len(accepted)]
        tried += len(names)
        jobs = [FileJob(root, preset, seed, name, sources.files[name], sources.unit) for name in names]
        records = run(sorted(jobs, key=_bytes_to_read, reverse=True))  # costly ones first: no core idles at the end
        for job in jobs:
            record = records[job.id]
            reason = record.get("refused") or _near_duplicate(record, accepted)
            if reason is None:
                accepted[job.name] = record
            else:
                refused[job.name] = reason
    return TriedFiles(accepted, refused, len(order) - tried)


def try_file(job: FileJob) -> Record:
    """Do the job unless its record exists; returns the record, with `refused` if the file cannot be a part."""
    done = finished_record(job.root, "files", job.id)
    if done is not None:
        return done
    try:
        record = _part_and_kit(job)
    except (MeshRefused, Redraw) as refusal:
        record = {"id": job.id, "files": {}, "refused": refusal.reason}
    except Exception as error:  # a user's mesh may trigger an unforeseen case: it is reported and the run continues
        record = {"id": job.id, "files": {}, "refused": str(internal_error("no kit", error))}
    return save_record(job.root, "files", job.id, record)


def deal_files(root: Path, plan: dict[str, Any], accepted: dict[str, Record]) -> dict[str, Record]:
    """Give accepted files the ids of the plan's parts; returns the records of parts and kits, by id."""
    records = {}
    for part_id, row in plan["parts"].items():
        tried = accepted[row["source"]]
        files: dict[str, str] = {}
        for kind in ("parts", "kits"):
            mesh = read_glb(root / f"{kind}/{tried['id']}.glb")[tried["id"]]
            files |= write_mesh_file(root, f"{kind}/{part_id}.glb", glb_bytes({part_id: mesh}))
        own = {"id": part_id, "split": row["split"], "source": row["source"], "redraws": [], "files": files}
        record = tried | own | {"kit": tried["kit"] | {"part_id": part_id}}
        records[part_id] = save_record(root, "parts", part_id, record)
    return records


def _part_and_kit(job: FileJob) -> Record:
    """The record of the part of a file at the size drawn or, if that is refused, at the preset's largest.

    In a larger part the clearance is smaller beside it, and a plate is higher. Raises MeshRefused if the file is no
    solid, and Redraw with the reason at the size drawn.
    """
    mesh = read_mesh(job.path, job.unit).mesh
    try:
        part = part_of_size(job.id, mesh, draw_longest(job.preset, job.seed, job.name))
        return write_part_and_kit(job.root, part, *accepted_kit_of(part, job.preset))
    except Redraw as refusal:
        with suppress(Redraw):
            part = part_of_size(job.id, mesh, job.preset.longest[1])
            return write_part_and_kit(job.root, part, *accepted_kit_of(part, job.preset))
        raise refusal from None


def part_of_size(part_id: str, mesh: Mesh, longest: float) -> Part:
    """The part of a mesh scaled to a longest side [m], closed as files hold it. Raises MeshRefused if it opens."""
    part = part_of_mesh(part_id, mesh, longest)
    if defect_float32(part.mesh) is None:
        return part
    closed, fault = closed_on_grid(part.mesh, GRID)
    if fault is not None:
        raise MeshRefused(f"opens when files round it to float32: {fault}")
    return replace(part, mesh=closed)


def _near_duplicate(record: Record, accepted: dict[str, Record]) -> str | None:
    """Why a part is too much like an accepted one; None if it is not."""
    measures = np.array([other["measures"] for other in accepted.values()]).reshape(-1, 5)
    twin = near_duplicate_of(np.array(record["measures"]), measures)
    return None if twin is None else f"near-duplicate of {list(accepted)[twin]}"


def _bytes_to_read(job: FileJob) -> int:
    """The size of a file, from which its cost follows; 0 if there is none."""
    return job.path.stat().st_size if job.path.is_file() else 0
