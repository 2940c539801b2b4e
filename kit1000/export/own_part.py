"""A kit for a user's own part at true size: reads a mesh file, designs the kit, writes files for a slicer, a report."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.dataset.mesh_files import glb_bytes, stl_bytes
from kit1000.dataset.tables import pose_row
from kit1000.errors import InputError, MeshRefused, Redraw
from kit1000.files import check_writable, clear_partial, write_bytes, write_json
from kit1000.kits.acceptance import check_pair
from kit1000.kits.kit import CLEARANCE, KitDesign, design_kit
from kit1000.parts.family import part_of_mesh
from kit1000.parts.files.sources import MeshReading, read_mesh
from kit1000.values import Part

COLOURS = {"kit": (224, 219, 210), "part": (238, 122, 40)}  # sRGB, those of the pictures
REPORT = "report.json"  # written last: when it exists, the other files are complete and of the same part


def make_kit_from_file(
    path: Path, out: Path, clearance: float = CLEARANCE, unit: str | None = None, longest: float | None = None
) -> dict[str, Any]:
    """Make the kit of a mesh file and write it to a folder; returns the report.

    Args:
        path: mesh file of the part.
        out: folder; gets kit.stl, part.stl, seated.glb, preview.png and report.json.
        clearance: [m] horizontal gap between part and cavity walls.
        unit: unit of the file: mm, cm, m or inch; guessed when None.
        longest: [m] scale the part to this longest side; true size when None.

    Raises:
        InputError: the file is no usable part, no kit can be made, or the folder cannot be written.
    """
    check_writable(out)
    try:
        reading = read_mesh(path, unit)
    except MeshRefused as refusal:
        raise InputError(f"{path}: {refusal.reason}") from None
    part, scale = _part(path, reading, longest)
    try:
        design = design_kit(part, clearance, plate=None)
    except Redraw as refusal:
        raise InputError(f"{path}: no kit: {refusal.reason}") from None
    report = _report(path, reading, part, scale, design)
    files = _files(part, design)
    clear_partial(out, *files, REPORT)
    with suppress(OSError):  # of an earlier run; the next write reports any error
        (out / REPORT).unlink()
    for name, data in files.items():
        write_bytes(out / name, data)
    write_json(out / REPORT, report)
    return report


def _part(path: Path, reading: MeshReading, longest: float | None) -> tuple[Part, float]:
    scale = 1.0 if longest is None else longest / float(reading.mesh.extents.max())
    return part_of_mesh(path.stem, reading.mesh, longest), scale


def _report(path: Path, reading: MeshReading, part: Part, scale: float, design: KitDesign) -> dict[str, Any]:
    return {
        "part": path.name,
        "unit": reading.unit,
        "unit_reason": reading.unit_reason,
        "repairs": list(reading.notes),
        "scale": scale,
        "size_mm": np.round(part.mesh.extents * 1e3, 3).tolist(),
        "volume_mm3": part.mesh.volume * 1e9,
        "plate_mm": (design.kit.extent * 1e3).tolist(),
        "kit_from_part": pose_row(design.kit.slot.kit_from_part),
        "trial": _trial_report(part, design),
    } | design.report


def _trial_report(part: Part, design: KitDesign) -> dict[str, Any]:
    """The result of the seating trials. It is only reported, as not every user's part can pass them."""
    try:
        trial = check_pair(part, design.kit)
    except Redraw as refusal:
        return {"passes": False, "why": refusal.reason}
    keyed = None if trial.keyedness is None else float(np.degrees(trial.keyedness))
    return {
        "passes": not trial.has_loose_fit,
        "why": "fits in another pose too" if trial.has_loose_fit else "",
        "keyedness_deg": keyed,
    }


def _files(part: Part, design: KitDesign) -> dict[str, bytes]:
    from kit1000.pictures.previews import kit_preview  # only here: importing it compiles the renderer

    seated = part.mesh.moved(design.kit.slot.kit_from_part)
    bodies = {"kit": design.kit.mesh, "part": seated}
    return {
        "kit.stl": stl_bytes(design.kit.mesh),
        "part.stl": stl_bytes(seated),
        "seated.glb": glb_bytes(bodies, COLOURS),
        "preview.png": kit_preview(part, design.kit),
    }
