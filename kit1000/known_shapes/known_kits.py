"""The shapes of a real scene as their owner has them: a dataset folder, or the two files of a kit.

Either gives an assembly of kits with its slots and goals, and the parts: all that scoring needs besides poses.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.own_scenes import is_labelled, is_own
from kit1000.errors import InputError, MeshRefused, did_you_mean
from kit1000.kits.goals import Design, find_goals
from kit1000.kits.shadows import PartShadows
from kit1000.known_shapes.shapes import KITS, KnownShape
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.parts.family import part_of_mesh
from kit1000.parts.files.read import read_mesh
from kit1000.pose import Pose
from kit1000.values import Assembly, Kit, Mount, Part, SceneShapes, Slot

REPORT = "report.json"  # beside a kit that `kit1000 kit` made
MM = 1e3
OVERLAP = 1e-9  # [m^3] that a seated part may share with its kit: rounding of both files


@dataclass(frozen=True, eq=False)
class KnownKits:
    """An assembly of kits and the parts that belong into it."""

    assembly: Assembly
    parts: tuple[Part, ...]
    """The part of each mount, in their order."""
    source: dict[str, Any]
    """Where the shapes come from, as `read_known_kits` takes it."""

    @property
    def kit_shape(self) -> KnownShape:
        """The kits as one body that stands as designed."""
        return KnownShape.upright(KITS, self.assembly.mesh)

    def part(self, name: str) -> Part:
        """A part by its id."""
        known = {part.id: part for part in self.parts}
        if name not in known:
            raise InputError(f"no part {name!r}; {did_you_mean(name, known)}there are {', '.join(known)}")
        return known[name]

    def shapes_for(self, summary: Mapping[str, Any]) -> SceneShapes:
        """The shapes as a method gets them. summary: the dataset.json of the scenes; with ground truth no goal is told.

        The files of a kit show the part seated, so that its owner need not search for the insertion.
        """
        meshes = {part.id: part.mesh for part in sorted(self.parts, key=_id)}
        if not is_own(summary) or is_labelled(summary):
            return SceneShapes(self.assembly.mesh, meshes)
        slots = {mount.kit.slot.part_id: (mount.assembly_from_kit, mount.kit.slot) for mount in self.assembly.mounts}
        clearances = {name: slot.clearance for name, (_, slot) in slots.items()}
        goals = {name: assembly_from_kit @ slot.goals for name, (assembly_from_kit, slot) in slots.items()}
        return SceneShapes(self.assembly.mesh, meshes, clearances, goals)

    def shape(self, name: str) -> KnownShape:
        """The shape of a body: KITS, or the id of a part."""
        return self.kit_shape if name == KITS else KnownShape.of(name, self.part(name).mesh)


def _id(part: Part) -> str:
    return part.id


def read_known_kits(source: dict[str, Any]) -> KnownKits:
    """The shapes of a source: {"shapes": folder, "assembly": id} or {"kit": file, "part": file, "clearance": [m]}."""
    if "shapes" in source:
        return kits_of_folder(Path(source["shapes"]), source["assembly"])
    return kits_of_files(Path(source["kit"]), Path(source["part"]), source["clearance"])


def kits_of_folder(folder: Path, assembly_id: str | None = None) -> KnownKits:
    """An assembly of a dataset folder, such as one of the preset `print`, or the kit in a folder of `kit1000 kit`.

    assembly_id: None for the only one of the folder.
    """
    if (folder / "kit.stl").is_file() and not (folder / "dataset.json").is_file():
        if assembly_id is not None:
            raise InputError(f"--assembly {assembly_id}: is for a dataset; {folder} holds one kit")
        return kits_of_files(folder / "kit.stl", folder / "part.stl")
    geometry = Geometry(folder)
    known = sorted(geometry.assemblies)
    if assembly_id is None and len(known) != 1:
        raise InputError(f"{folder}: {len(known)} assemblies: choose one by --assembly: {', '.join(known[:8])} ...")
    if assembly_id is not None and assembly_id not in known:
        hint = did_you_mean(assembly_id, known)
        raise InputError(f"{folder}: no assembly {assembly_id!r}; {hint}there are {', '.join(known[:8])} ...")
    assembly = geometry.assembly(assembly_id or known[0])
    parts = tuple(geometry.part(mount.kit.slot.part_id) for mount in assembly.mounts)
    return KnownKits(assembly, parts, {"shapes": str(folder.resolve()), "assembly": assembly.id})


def kits_of_files(kit_path: Path, part_path: Path, clearance: float | None = None) -> KnownKits:
    """One kit and its part from two mesh files in one frame: z up, the part seated, as `kit1000 kit` writes them.

    Args:
        kit_path: mesh file of the plate.
        part_path: mesh file of the part.
        clearance: [m] between part and walls; that of the report beside the kit when None.

    Raises:
        InputError: a file is no solid, the part is not seated in the kit, or no clearance is known.
    """
    plate, seated = _solid_mesh(kit_path), _solid_mesh(part_path)
    clearance = _reported_clearance(kit_path) if clearance is None else clearance
    low, high = plate.bounds
    kit_from_file = Pose.from_translation((-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -high[2]))
    plate, seated = plate.moved(kit_from_file).rounded_float32(), seated.moved(kit_from_file)
    _check_seated(plate, seated, part_path)
    name = part_path.stem if part_path.stem != "part" else part_path.resolve().parent.name
    part = part_of_mesh(name, seated)
    kit_from_part = Pose.from_translation(seated.centroid)
    depth, extent = -float(seated.bounds[0, 2]), plate.extents
    standing = solid_from_mesh(part.mesh.moved(Pose.from_translation((0.0, 0.0, depth)) @ kit_from_part))
    goals, axis = find_goals(Design(part.mesh, part.symmetry, kit_from_part, PartShadows.of(standing, depth)))
    kit = Kit(name, plate, Slot(name, kit_from_part, clearance, depth, goals, axis), extent)
    raised = Pose.from_translation((0.0, 0.0, float(extent[2])))
    assembly = Assembly(name, plate.moved(raised).rounded_float32(), (Mount(kit, raised),))
    source = {"kit": str(kit_path.resolve()), "part": str(part_path.resolve()), "clearance": clearance}
    return KnownKits(assembly, (part,), source)


def _solid_mesh(path: Path) -> Mesh:
    try:
        return read_mesh(path).mesh
    except MeshRefused as refusal:
        raise InputError(f"{path}: {refusal.reason}") from None


def _reported_clearance(kit_path: Path) -> float:
    """[m] the clearance in the report beside a kit."""
    try:
        return float(json.loads((kit_path.parent / REPORT).read_bytes())["clearance_asked_mm"]) / MM
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            f"{kit_path}: no {REPORT} of `kit1000 kit` beside it that tells the clearance: give it by --clearance-mm"
        ) from None


def _check_seated(plate: Mesh, seated: Mesh, path: Path) -> None:
    """Refuse a part that is not in the plate, whose top face is at z = 0."""
    lowest, inside = float(seated.bounds[0, 2]), _is_within(seated, plate)
    shared = float((solid_from_mesh(plate) ^ solid_from_mesh(seated)).volume())
    allowed = OVERLAP + 1e-6 * seated.area
    if lowest >= 0 or lowest < plate.bounds[0, 2] or shared > allowed or not inside:
        what = f"its lowest point is at {lowest * MM:.3g} mm from the kit's top face"
        if shared > allowed:
            what = f"cuts into the kit by {shared * 1e9:.3g} mm3"
        elif not inside:
            what = "lies beside the kit"
        raise InputError(
            f"{path}: {what}: expected the part seated in the frame of the kit, as `kit1000 kit` writes part.stl; "
            "several plates on brackets are given by --shapes"
        )


def _is_within(part: Mesh, plate: Mesh) -> bool:
    """Whether a part is over a plate, as seen from above."""
    low, high = part.bounds[:, :2] - plate.bounds[:, :2]
    return bool((low >= 0).all() and (high <= 0).all())
