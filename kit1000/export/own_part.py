"""A kit for a user's own part at true size: reads a mesh file, designs the kit, writes files for a slicer, a report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kit1000.dataset.mesh_files import glb_bytes, stl_bytes
from kit1000.dataset.tables import pose_row
from kit1000.errors import InputError, Kit1000Error, MeshRefused, Redraw, internal_error
from kit1000.export.kit_folder import REPORT, check_kit_folder, check_reports, write_kit_folder
from kit1000.files import check_writable, write_json
from kit1000.kits.acceptance import NOT_SEATED
from kit1000.kits.choice import Attempt, attempts
from kit1000.kits.kit import CLEARANCE, KitDesign
from kit1000.kits.printable_mesh import SIMPLIFY_TOLERANCE, closed_on_grid
from kit1000.kits.seating import BISECTION_STEP
from kit1000.kits.sweep import SAGITTA
from kit1000.mesh import Mesh, defect_float32, mesh_from_solid, solid_from_mesh
from kit1000.parallel import local_engine, usable_cores
from kit1000.parts.family import part_of_mesh
from kit1000.parts.files.sources import MeshReading, Refusal, read_bodies, read_mesh
from kit1000.parts.files.united_bodies import Choice, SeveralBodies
from kit1000.values import Part

COLOURS = {"kit": (224, 219, 210), "part": (238, 122, 40)}  # sRGB, those of the pictures
OTHER_CHOICES = {  # what to do about several bodies, by the choice that was refused
    None: "choose --bodies union (they touch or overlap), largest, or each (a kit for every one)",
    "union": "choose --bodies largest, or each (a kit for every one)",
}
PREVIEW = "preview.png"
KIT_FILES = ("kit.stl", "part.stl", "seated.glb", PREVIEW)


class InexactKit(Kit1000Error):
    """A kit that fails its own measurement; it is not written."""


def make_kit_from_file(
    path: Path,
    out: Path,
    clearance: float = CLEARANCE,
    unit: str | None = None,
    longest: float | None = None,
    choice: Choice | None = None,
    preview: bool = True,
) -> dict[str, Any]:
    """Make the kit of a mesh file and write it to a folder; returns the report.

    Args:
        path: mesh file of the part.
        out: folder; gets kit.stl, part.stl, seated.glb, preview.png and report.json.
        clearance: [m] horizontal gap between part and cavity walls.
        unit: unit of the file: mm, cm, m or inch; guessed when None.
        longest: [m] scale the part to this longest side; true size when None.
        choice: which body of several is the part, as in `read_mesh`.
        preview: whether to draw preview.png.

    Raises:
        InputError: the file is no usable part, no kit can be made, or the folder cannot be written.
        InexactKit: the clearance of the kit is too small, or the part does not seat in it.
    """
    check_writable(out)
    try:
        reading = read_mesh(path, unit, choice)
    except SeveralBodies as refusal:
        raise InputError(f"{path}: {refusal.reason}; {OTHER_CHOICES[choice]}") from None
    except MeshRefused as refusal:
        raise InputError(f"{path}: {refusal.reason}") from None
    return _make_kit(reading, str(path), out, clearance, longest, preview)


def make_kits_from_file(
    path: Path,
    out: Path,
    clearance: float = CLEARANCE,
    unit: str | None = None,
    longest: float | None = None,
    preview: bool = True,
) -> dict[str, dict[str, Any] | str]:
    """Make the kit of each body of a mesh file, in folders 01, 02, ... of `out`, the largest body first.

    Returns by folder the report, or why there is no kit and no folder; `report.json` of `out` holds the same, and is
    written last. Arguments and errors that concern the whole file are those of `make_kit_from_file`.
    """
    check_writable(out)
    try:
        readings = read_bodies(path, unit)
    except MeshRefused as refusal:
        raise InputError(f"{path}: {refusal.reason}") from None
    check_reports(out)
    with suppress(OSError):  # of an earlier run
        (out / REPORT).unlink()
    reports: dict[str, dict[str, Any] | str] = {}
    for number, reading in enumerate(readings, 1):
        name = f"{number:02d}"
        place = f"{path}: body {number} of {len(readings)}"
        try:
            if isinstance(reading, Refusal):
                raise InputError(f"{place}: {reading.reason}")
            reports[name] = _make_kit(reading, place, out / name, clearance, longest, preview)
        except (InputError, InexactKit) as refusal:
            reports[name] = str(refusal)
    write_json(out / REPORT, reports)
    return reports


@dataclass(frozen=True)
class KitJob:
    """One of several files to make kits for."""

    path: Path
    out: Path
    clearance: float = CLEARANCE
    unit: str | None = None
    longest: float | None = None
    choice: Literal["union", "largest", "each"] | None = None
    preview: bool = True

    def __str__(self) -> str:
        return str(self.path)

    def run(self) -> dict[str, dict[str, Any] | str]:
        """Make the kit, or those of each body: by folder the report, or why there is no kit."""
        options = (self.path, self.out, self.clearance, self.unit, self.longest)
        try:
            if self.choice == "each":
                reports = make_kits_from_file(*options, self.preview)
                return {f"{self.out.name}/{name}": report for name, report in reports.items()}
            return {self.out.name: make_kit_from_file(*options, self.choice, self.preview)}
        except (InputError, InexactKit) as refusal:
            return {self.out.name: str(refusal)}
        except Exception as error:  # one file may trigger an unforeseen case: it is reported and the others get kits
            return {self.out.name: str(internal_error(str(self.path), error))}


def make_kits_from_files(
    paths: Sequence[Path], out: Path, workers: int | None = None, **options: Any
) -> Iterator[dict[str, dict[str, Any] | str]]:
    """Make the kits of many files in folders of `out` named after them, on all cores; the largest file first.

    Yields for each file, as it is done, the reports by folder as `make_kits_from_file` returns them. `report.json` of
    `out` holds all of them, and is written last. options: fields of `KitJob`.
    """
    check_writable(out)
    check_reports(out)
    with suppress(OSError):  # of an earlier run
        (out / REPORT).unlink()
    jobs = [KitJob(path, out / name, **options) for path, name in zip(paths, folder_names(paths), strict=True)]
    jobs.sort(key=lambda job: job.path.stat().st_size if job.path.is_file() else 0, reverse=True)
    reports: dict[str, dict[str, Any] | str] = {}
    with local_engine(min(workers or usable_cores(), len(jobs))) as run:
        for done in run(KitJob.run, jobs):
            reports |= done
            yield done
    write_json(out / REPORT, dict(sorted(reports.items())))


def folder_names(paths: Sequence[Path]) -> list[str]:
    """Names of folders for files: without their endings, and numbered where they would be equal."""
    names: list[str] = []
    for path in paths:
        name, number = path.stem, 1
        while name in names:
            number += 1
            name = f"{path.stem}-{number}"
        names.append(name)
    return names


def _make_kit(
    reading: MeshReading, place: str, out: Path, clearance: float, longest: float | None, preview: bool
) -> dict[str, Any]:
    """Make the kit of a part and write it to a folder; returns the report. `place` begins every message."""
    check_kit_folder(out, KIT_FILES if preview else KIT_FILES[:-1], reading.path)
    part, scale = _part(reading, longest)
    side = float(part.mesh.extents.max())
    if side < clearance:
        raise InputError(
            f"{place}: {side * 1e3:.3g} mm long, less than the clearance of {clearance * 1e3:g} mm; "
            "choose a smaller --clearance-mm, or another --unit"
        )
    design, trial = _best_kit(part, clearance, place)
    report = _report(reading, part, scale, design, trial)
    return write_kit_folder(out, kit_files(part, design, place, preview), report)


def _best_kit(part: Part, clearance: float, place: str) -> tuple[KitDesign, dict[str, Any]]:
    """The kit on the first face that passes all trials, as in a dataset, else on the first that has an exact kit.

    Returns it with the report of its trials, which are only reported, as not every user's part can pass them. Raises
    InputError when there is no kit, and InexactKit when none is exact.
    """
    tried: list[Attempt] = []
    faults: list[Kit1000Error] = []
    reason = ""
    try:
        for attempt in attempts(part, clearance, None):
            tried.append(attempt)
            passing = attempt.design if attempt.refusal is None else None
            if passing is not None and _fault_of(passing, None, place) is None:
                return passing, _trial_report(attempt)
    except Redraw as refusal:
        reason = refusal.reason
    for attempt in (attempt.postponed() if attempt.postponed else attempt for attempt in tried):
        if attempt.design is None:
            reason = reason or attempt.refusal or ""
            continue
        fault = _fault_of(attempt.design, attempt.refusal, place)
        if fault is None:
            return attempt.design, _trial_report(attempt)
        faults.append(fault)
    raise next(iter(faults), InputError(f"{place}: no kit: {reason}"))


def _fault_of(design: KitDesign, refusal: str | None, place: str) -> Kit1000Error | None:
    """What keeps a kit from being written: less than the requested clearance, or a part that does not seat in it."""
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


def _part(reading: MeshReading, longest: float | None) -> tuple[Part, float]:
    scale = 1.0 if longest is None else longest / float(reading.mesh.extents.max())
    return part_of_mesh(reading.path.stem, reading.mesh, longest), scale


def _report(reading: MeshReading, part: Part, scale: float, design: KitDesign, trial: dict[str, Any]) -> dict[str, Any]:
    return {
        "part": reading.path.name,
        "unit": reading.unit,
        "unit_reason": reading.unit_reason,
        "repairs": list(reading.notes),
        "scale": scale,
        "size_mm": np.round(part.mesh.extents * 1e3, 3).tolist(),
        "volume_mm3": part.mesh.volume * 1e9,
        "plate_mm": (design.kit.extent * 1e3).tolist(),
        "kit_from_part": pose_row(design.kit.slot.kit_from_part),
        "trial": trial,
    } | design.report


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
    """The mesh, with vertices moved by microns where it would open when files round them and loaders merge them."""
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
