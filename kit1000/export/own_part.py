"""Kits for a user's own parts at true size: mesh files are read, kits designed, and written as files for a slicer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.dataset.json_rows import pose_row
from kit1000.dataset.mesh_files import glb_bytes, stl_bytes
from kit1000.errors import InputError, Kit1000Error, MeshRefused, Redraw, internal_error
from kit1000.files import check_output, clear_partial, write_bytes, write_json
from kit1000.kits.cavity import SAGITTA
from kit1000.kits.kit import CLEARANCE, KitDesign
from kit1000.kits.kit_trials import NOT_SEATED, Attempt, attempts
from kit1000.kits.printable_mesh import SIMPLIFY_TOLERANCE, closed_on_grid
from kit1000.kits.seating import BISECTION_STEP
from kit1000.mesh import Mesh, defect_float32, mesh_from_solid, solid_from_mesh
from kit1000.parallel import local_engine, usable_cores
from kit1000.parts.family import part_of_mesh
from kit1000.parts.files.part_mesh import Choice, SeveralBodies
from kit1000.parts.files.read import MeshReading, read_mesh
from kit1000.values import Part

COLOURS = {"kit": (224, 219, 210), "part": (238, 122, 40)}  # sRGB, those of the pictures
REPORT = "report.json"  # written last: if it exists, the other files are complete and of the same part
PREVIEW = "preview.png"
BEGUN = ".begun"  # beside the files while they are written: a run that is killed leaves it


class InexactKit(Kit1000Error):
    """A kit that fails its own measurement; it is not written."""


@dataclass(frozen=True)
class KitOptions:
    """How the kits of mesh files are made."""

    clearance: float = CLEARANCE
    """Horizontal gap between part and cavity walls. [m]"""
    unit: str | None = None
    """Unit of the files: mm, cm, m or inch; guessed if None."""
    longest: float | None = None
    """Longest side to which the part is scaled; true size if None. [m]"""
    bodies: Choice | None = None
    """Which body of several is the part, as in `read_mesh`."""
    preview: bool = True
    """Whether to draw preview.png."""


def make_kit_from_file(path: Path, out: Path, options: KitOptions = KitOptions()) -> dict[str, Any]:
    """Make the kit of a mesh file and write it to a folder; returns the report.

    Args:
        path: mesh file of the part.
        out: folder, new or of an earlier run; gets kit.stl, part.stl, seated.glb, preview.png and report.json.
        options: how it is made.

    Raises:
        InputError: the file is no usable part, no kit can be made, or the folder cannot be written.
        InexactKit: the clearance of the kit is too small, or the part does not seat in it.
    """
    check_output(out, REPORT, BEGUN)
    if path.resolve().parent == out.resolve():
        raise InputError("--out: is the folder of the part, which would be replaced")
    try:
        reading = read_mesh(path, options.unit, options.bodies)
    except SeveralBodies as refusal:
        others = "" if options.bodies == "union" else "union (they touch or overlap) or "
        raise InputError(f"{path}: {refusal.reason}; choose --bodies {others}largest, or a file of each") from None
    except MeshRefused as refusal:
        raise InputError(f"{path}: {refusal.reason}") from None
    files, report = make_kit(reading, str(path), options)
    clear_partial(out, *files, REPORT)
    write_bytes(out / BEGUN, b"")
    for name in (REPORT, PREVIEW):  # those of an earlier run would be of another kit
        (out / name).unlink(missing_ok=True)
    for name, data in files.items():
        write_bytes(out / name, data)
    write_json(out / REPORT, report)
    (out / BEGUN).unlink()
    return report


def make_kits(
    paths: Sequence[Path], out: Path, options: KitOptions = KitOptions(), workers: int | None = None
) -> Iterator[tuple[str, dict[str, Any] | str]]:
    """Make the kits of many files in folders of `out` named after them, on all cores; the largest file first.

    Yields the name of each folder with the report, or the reason why there is no kit, as it is done; `report.json` of
    `out` has all of them and is written last. A file without a kit does not stop the others.

    Raises InputError if the folder cannot be written.
    """
    check_output(out, REPORT, BEGUN)
    write_bytes(out / BEGUN, b"")
    (out / REPORT).unlink(missing_ok=True)
    named = list(zip(folder_names(paths), paths, strict=True))
    named.sort(key=lambda pair: pair[1].stat().st_size if pair[1].is_file() else 0, reverse=True)
    reports: dict[str, dict[str, Any] | str] = {}
    with local_engine(min(workers or usable_cores(), len(named))) as run:
        for name, report in run(partial(_kit_or_reason, out, options), named):
            reports[name] = report
            yield name, report
    write_json(out / REPORT, dict(sorted(reports.items())))
    (out / BEGUN).unlink()


def _kit_or_reason(out: Path, options: KitOptions, named: tuple[str, Path]) -> tuple[str, dict[str, Any] | str]:
    """The name of a folder of `out`, and the report or why there is no kit. named: that folder, and the mesh file."""
    name, path = named
    try:
        return name, make_kit_from_file(path, out / name, options)
    except (InputError, InexactKit) as refusal:
        return name, str(refusal)
    except Exception as error:  # one file may trigger an unforeseen case: it is reported and the others get kits
        return name, str(internal_error(str(path), error))


def folder_names(paths: Sequence[Path]) -> list[str]:
    """Names of folders for files: without their endings, and numbered if they would be equal."""
    names: list[str] = []
    for path in paths:
        name, number = path.stem, 1
        while name in names:
            number += 1
            name = f"{path.stem}-{number}"
        names.append(name)
    return names


def make_kit(reading: MeshReading, place: str, options: KitOptions) -> tuple[dict[str, bytes], dict[str, Any]]:
    """The files of the kit of a part by name, and its report. `place` begins every message.

    Raises as `make_kit_from_file` does.
    """
    scale = 1.0 if options.longest is None else options.longest / float(reading.mesh.extents.max())
    part = part_of_mesh(reading.path.stem, reading.mesh, options.longest)
    side = float(part.mesh.extents.max())
    if side < options.clearance:
        raise InputError(
            f"{place}: {side * 1e3:.3g} mm long, less than the clearance of {options.clearance * 1e3:g} mm; "
            "choose a smaller --clearance-mm, or another --unit"
        )
    attempt = _best_attempt(part, options.clearance, place)
    design = attempt.design
    assert design is not None
    report = {
        "part": reading.path.name,
        "unit": reading.unit,
        "unit_reason": reading.unit_reason,
        "coordinate_step_mm": reading.step * scale * 1e3,
        "repairs": list(reading.notes),
        "scale": scale,
        "size_mm": np.round(part.mesh.extents * 1e3, 3).tolist(),
        "volume_mm3": part.mesh.volume * 1e9,
        "plate_mm": (design.kit.extent * 1e3).tolist(),
        "kit_from_part": pose_row(design.kit.slot.kit_from_part),
        "trial": _trial_report(attempt),
    }
    return kit_files(part, design, place, options.preview), report | design.report


def _best_attempt(part: Part, clearance: float, place: str) -> Attempt:
    """The kit on the first face that passes all trials, as in a dataset, else on the first that has an exact kit.

    Trials are only reported, as not every user's part can pass them. Raises InputError if there is no kit, and
    InexactKit if none is exact.
    """
    faults: list[Kit1000Error] = []
    failing: Attempt | None = None
    reason = ""
    try:
        for attempt in attempts(part, clearance, None):
            reason = reason or attempt.refusal or ""
            if attempt.design is None:
                continue
            fault = _fault_of(attempt.design, attempt.refusal, place)
            if fault is not None:
                faults.append(fault)
            elif attempt.refusal is None:
                return attempt
            else:
                failing = failing or attempt
    except Redraw as refusal:
        reason = refusal.reason
    if failing is None:
        raise next(iter(faults), InputError(f"{place}: no kit: {reason}"))
    return failing


def _fault_of(design: KitDesign, refusal: str | None, place: str) -> Kit1000Error | None:
    """Why a kit must not be written: less than the requested clearance, or a part that does not seat in it."""
    slot, smallest = design.kit.slot, design.measured_clearance.smallest
    if slot.depth / 3 <= BISECTION_STEP:
        return InputError(
            f"{place}: no kit: {design.face.height * 1e3:.3g} mm high where it lies, too flat for a cavity to hold it; "
            f"expected more than {BISECTION_STEP * 5e3:g} mm, see --fit-mm"
        )
    if smallest < slot.clearance - SAGITTA:
        return InexactKit(
            f"{place}: the kit came out with a clearance of {smallest * 1e3:.3f} mm, "
            f"expected {slot.clearance * 1e3:g} mm; nothing is written, try another --clearance-mm"
        )
    if refusal == NOT_SEATED:
        return InexactKit(f"{place}: the part {NOT_SEATED} of its kit; nothing is written, try another --clearance-mm")
    return None


def _trial_report(attempt: Attempt) -> dict[str, Any]:
    """The result of the trials of a kit."""
    report: dict[str, Any] = {"passes": attempt.refusal is None, "why": attempt.refusal or ""}
    if attempt.trial is None:
        return report
    keyed = None if attempt.trial.keyedness is None else float(np.degrees(attempt.trial.keyedness))
    why = "fits in another pose too" if attempt.trial.has_loose_fit else ""
    return report | {"why": why, "keyedness_deg": keyed}


def kit_files(part: Part, design: KitDesign, place: str, preview: bool = True) -> dict[str, bytes]:
    """The files of a kit and its part, by name.

    Args:
        part: the part, in its own frame.
        design: its kit.
        place: what messages call the part.
        preview: whether a picture is among the files.
    """
    kit = _closed_in_files(design.kit.mesh, f"{place}: the kit")
    seated = _closed_in_files(part.mesh.moved(design.kit.slot.kit_from_part), f"{place}: the seated part")
    files = {
        "kit.stl": stl_bytes(kit),
        "part.stl": stl_bytes(seated),
        "seated.glb": glb_bytes({"kit": kit, "part": seated}, COLOURS),
    }
    if preview:
        from kit1000.pictures.previews import kit_preview  # only here: importing it compiles the renderer

        files[PREVIEW] = kit_preview(part, design.kit)
    return files


def _closed_in_files(mesh: Mesh, name: str) -> Mesh:
    """The mesh, with vertices moved by microns if it would open once files round them and loaders merge them."""
    if _file_defect(mesh) is None:
        return mesh
    grid = 2.0 ** (np.ceil(np.log2(np.abs(mesh.vertices).max() * 1e3)) - 23) * 1e-3  # exact in float32 millimetres
    closed, fault = closed_on_grid(mesh, grid, _file_defect)
    if fault is not None:
        simple = mesh_from_solid(solid_from_mesh(mesh).as_original().simplify(SIMPLIFY_TOLERANCE))
        closed, fault = closed_on_grid(simple, grid, _file_defect)
    if fault is not None:
        raise InexactKit(f"{name} is not closed once rounded to float32: {fault}; nothing is written")
    return closed


def _file_defect(mesh: Mesh) -> str | None:
    """The defect of a mesh as read from a GLB, in metres, or an STL, in millimetres."""
    return defect_float32(mesh) or defect_float32(mesh.scaled(1e3))
