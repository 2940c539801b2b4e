"""Conversion of parts, kits and assemblies to rows of the dataset's JSON tables, and back.

A row holds everything except the mesh, which is in a GLB file. SI units, quaternions wxyz, floats in full precision: a
value read back equals the value written.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.symmetry import Symmetry
from kit1000.values import Assembly, FreeAxis, Kit, Mount, Part, Slot

FORMAT = "kit1000/2"  # of the dataset folder and its recordings

Row = dict[str, Any]


def check_format(found: Any, what: str) -> None:
    """Raise InputError for a file `what` in another format than FORMAT, such as one of an older version."""
    if found != FORMAT:
        raise InputError(
            f"{what} has format {found!r}, this version reads {FORMAT!r}; generate or download the dataset again, "
            "or install the version of kit1000 that made it"
        )


def part_row(part: Part) -> Row:
    """The row of a part."""
    axis = part.symmetry.axis
    return {
        "family": part.family,
        "dimensions": dict(part.dimensions),
        "mass": part.mass,
        "volume": part.mesh.volume,
        "extents": part.mesh.extents.tolist(),
        "symmetry": {
            "name": part.symmetry.name,
            "rotations": part.symmetry.rotations.tolist(),
            "axis": None if axis is None else axis.tolist(),
        },
    }


def part_of(part_id: str, row: Row, mesh: Mesh) -> Part:
    """The part of a row and its mesh."""
    axis = row["symmetry"]["axis"]
    symmetry = Symmetry(np.array(row["symmetry"]["rotations"]), None if axis is None else np.array(axis))
    return Part(part_id, row["family"], mesh, symmetry, row["dimensions"], row["mass"])


def kit_row(kit: Kit) -> Row:
    """The row of a kit and its slot."""
    slot, axis = kit.slot, kit.slot.free_axis
    return {
        "part_id": slot.part_id,
        "kit_from_part": pose_row(slot.kit_from_part),
        "clearance": slot.clearance,
        "depth": slot.depth,
        "goals": [pose_row(goal) for goal in slot.goals],
        "free_axis": axis and {"point": axis.point.tolist(), "direction": axis.direction.tolist()},
        "extent": kit.extent.tolist(),
    }


def kit_of(kit_id: str, row: Row, mesh: Mesh) -> Kit:
    """The kit of a row and its mesh."""
    return Kit(kit_id, mesh, slot_of(row), np.array(row["extent"]))


def slot_of(row: Row) -> Slot:
    """The slot of a kit's row."""
    axis = row["free_axis"] and FreeAxis(np.array(row["free_axis"]["point"]), np.array(row["free_axis"]["direction"]))
    goals = Pose.stack([pose_of(goal) for goal in row["goals"]])
    return Slot(row["part_id"], pose_of(row["kit_from_part"]), row["clearance"], row["depth"], goals, axis)


def assembly_row(assembly: Assembly) -> Row:
    """The row of an assembly: its kits with their poses."""
    mounts = [{"kit_id": m.kit.id, "assembly_from_kit": pose_row(m.assembly_from_kit)} for m in assembly.mounts]
    return {"mounts": mounts}


def assembly_of(assembly_id: str, row: Row, mesh: Mesh, kit: Callable[[str], Kit]) -> Assembly:
    """The assembly of a row and its mesh; `kit` returns a kit by id."""
    mounts = tuple(Mount(kit(m["kit_id"]), pose_of(m["assembly_from_kit"])) for m in row["mounts"])
    return Assembly(assembly_id, mesh, mounts)


def pose_row(pose: Pose) -> Row:
    """An unbatched pose as a row."""
    return {"wxyz": pose.wxyz.tolist(), "xyz": pose.xyz.tolist()}


def pose_of(row: Row) -> Pose:
    """The pose of a row."""
    return Pose(np.array(row["wxyz"]), np.array(row["xyz"]))
