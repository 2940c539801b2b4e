"""Can what we write be printed? Gives kits and assemblies of a dataset to PrusaSlicer: `make slicer`.

Assemblies are exported as STL, kits are made of the dataset's part files by `kit1000 kit`. The slicer has to
call each manifold, one body and of the right size, and to slice it. With --bop, BOP's own toolkit reads an export. The
exit status is 1 when a check fails.
"""

from __future__ import annotations

import argparse
import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bench.outside.foreign import Report, dataset_of, kit1000, run, tail
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.json_rows import pose_of
from kit1000.files import read_json

BED = 1000  # [mm] side and height: larger than any assembly
KITS = 4
SIZE_TOLERANCE = 0.01  # [mm]
INSIDE = 2.0  # [mm] that points of a depth image may lie outside the box of their model
INFO = re.compile(r"^(\w+) = +(\S+)$", re.MULTILINE)
COARSE = ("--layer-height", "0.3", "--first-layer-height", "0.3", "--fill-density", "5%")  # sliced in seconds


def info_fault(slicer: str, file: Path, size: np.ndarray) -> str | None:
    """What the slicer finds wrong in a file that should have a size (3,) [mm], or None."""
    status, text = run([slicer, "--info", file])
    found = dict(INFO.findall(text))
    if status or "manifold" not in found:
        return f"exit status {status}: {tail(text)}"
    if (found["manifold"], found["number_of_parts"]) != ("yes", "1"):
        return f"manifold = {found['manifold']}, number_of_parts = {found['number_of_parts']}, expected yes and 1"
    repaired = {name: count for name, count in found.items() if name.endswith(("_fixed", "_removed", "_reversed"))}
    if repaired:
        return f"the slicer repairs it: {repaired}"
    sizes = np.array([float(found[f"size_{axis}"]) for axis in "xyz"])
    if np.abs(sizes - size).max() > SIZE_TOLERANCE:
        return f"size {sizes} mm, expected {size.round(3)} mm"
    return None


def slice_fault(slicer: str, file: Path, out: Path) -> str | None:
    """Why the slicer cannot slice a file, or None."""
    out.unlink(missing_ok=True)
    bed = ("--bed-shape", f"0x0,{BED}x0,{BED}x{BED},0x{BED}", "--max-print-height", str(BED))
    place = ("--dont-arrange", "--center", f"{BED / 2:g},{BED / 2:g}")
    status, text = run([slicer, "--export-gcode", file, "--output", out, *bed, *place, *COARSE])
    if status or not out.is_file():
        return f"exit status {status}: {tail(text)}"
    return None if ";LAYER_CHANGE" in out.read_text(encoding="utf-8") else "the sliced file has no layers"


def printed(geometry: Geometry, scratch: Path) -> Iterator[tuple[Path, np.ndarray]]:
    """Files for a printer, with the sizes (3,) [mm] that they should have."""
    kit1000("export", geometry.root, "--format", "stl", "--out", scratch / "stl")
    for name in sorted(geometry.assemblies):
        yield scratch / "stl" / f"{name}.stl", 1e3 * geometry.assembly(name).mesh.extents
    names = sorted(geometry.parts)
    for name in names[:: -(-len(names) // KITS)]:
        kit1000("kit", geometry.root / "parts" / f"{name}.glb", "--unit", "m", "--out", scratch / name)
        report = read_json(scratch / name / "report.json")
        seated = pose_of(report["kit_from_part"]).apply(geometry.part(name).mesh.vertices)
        yield scratch / name / "part.stl", 1e3 * np.ptp(seated, axis=0)
        yield scratch / name / "kit.stl", np.array(report["plate_mm"])


def bop_faults(checkout: Path, dataset: Path, scratch: Path) -> Iterator[tuple[str, str | None]]:
    """For each image of an export, read by BOP's toolkit: is every object where the depth image has it?"""
    sys.path.insert(0, str(checkout))
    inout = importlib.import_module("bop_toolkit_lib.inout")
    kit1000("export", dataset, "--format", "bop", "--split", "test", "--out", scratch / "bop")
    models: dict[int, np.ndarray] = {}
    for folder in sorted((scratch / "bop/test").iterdir()):
        camera = inout.load_scene_camera(str(folder / "scene_camera.json"))[0]
        objects = inout.load_scene_gt(str(folder / "scene_gt.json"))[0]
        depth = inout.load_depth(str(folder / "depth/000000.png")) * camera["depth_scale"]
        for i, item in enumerate(objects):
            number = item["obj_id"]
            if number not in models:
                models[number] = inout.load_ply(str(scratch / f"bop/models/obj_{number:06d}.ply"))["pts"]
            mask = inout.load_im(str(folder / f"mask_visib/000000_{i:06d}.png")) > 0
            v, u = np.nonzero(mask & (depth > 0))
            rays = np.linalg.inv(camera["cam_K"]) @ np.stack([u, v, np.ones(len(u))])
            points = (rays * depth[v, u] - item["cam_t_m2c"].reshape(3, 1)).T @ item["cam_R_m2c"]
            box = models[number]
            outside = np.maximum(box.min(0) - points, points - box.max(0)).max(initial=0)
            fault = f"points {outside:.1f} mm outside the model" if outside > INSIDE else None
            yield f"bop/{folder.name}: object {number}, {len(u)} points", fault


def main() -> int:
    """Check what is printed of a dataset; returns 1 when a check fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slicer", default="prusa-slicer", help="the program")
    parser.add_argument("--out", type=Path, required=True, help="folder for a tiny dataset where --data is none")
    parser.add_argument("--data", type=Path, help="a dataset; else a tiny one is generated in --out")
    parser.add_argument("--bop", type=Path, help="checkout of BOP's toolkit")
    options = parser.parse_args()
    dataset, report = dataset_of(options.data, options.out), Report()
    with TemporaryDirectory() as folder:
        scratch = Path(folder)
        for file, size in printed(Geometry(dataset), scratch):
            what = file.relative_to(scratch)
            report.line(f"{what}: manifold, one body, right size", info_fault(options.slicer, file, size))
            report.line(f"{what}: sliced", slice_fault(options.slicer, file, scratch / "sliced.gcode"))
        for what, fault in bop_faults(options.bop, dataset, scratch) if options.bop else ():
            report.line(what, fault)
    return 1 if report.failed else 0


if __name__ == "__main__":
    sys.exit(main())
