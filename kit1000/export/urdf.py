"""Export of an assembly as a URDF: one rigid link, a visual mesh, and a collision mesh for every convex piece.

Physics engines take the convex hull of each collision mesh, so kits are divided into convex prisms that leave the
cavities open; brackets and ribs are convex already. Every element is on its own line, because some parsers read lines
into a short buffer. Lengths are metres, mass kilograms; file names are relative to the URDF.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from kit1000.files import new_folder
from kit1000.kits.brackets import support_meshes
from kit1000.kits.convex_pieces import convex_prisms
from kit1000.mesh import Mesh, inertia
from kit1000.parts.family import DENSITY
from kit1000.pose import Pose
from kit1000.values import Assembly

URDF = "assembly.urdf"
VISUAL = "assembly.obj"


def write_urdf(assembly: Assembly, folder: Path) -> Path:
    """Write `assembly.urdf` and its meshes into a new folder; returns the path of the URDF.

    The folder appears when it is complete. Raises InputError when it exists or cannot be written.
    """
    with new_folder(folder, "URDF") as partial:
        _write_files(assembly, partial)
    return folder / URDF


def roll_pitch_yaw(pose: Pose) -> np.ndarray:
    """The rotation as in URDF, (3,) [rad]: angles about the fixed axes x, then y, then z."""
    m = pose.rotation_matrix()
    level = np.hypot(m[0, 0], m[1, 0])
    pitch = np.arctan2(-m[2, 0], level)
    if level < 1e-9:  # x points up or down: roll and yaw are about the same axis, so yaw is set to zero
        return np.array([np.arctan2(-m[1, 2], m[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(m[2, 1], m[2, 2]), pitch, np.arctan2(m[1, 0], m[0, 0])])


def _write_files(assembly: Assembly, folder: Path) -> None:
    (folder / VISUAL).write_text(obj_text(assembly.mesh), encoding="ascii")
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(assembly.id)}>", '<link name="assembly">']
    lines += [*_inertial(assembly.mesh), *_shape("visual", Pose.identity(), VISUAL)]
    for name, pose, piece in _pieces(assembly):
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(obj_text(piece), encoding="ascii")
        lines += _shape("collision", pose, name)
    lines += ["</link>", "</robot>"]
    (folder / URDF).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _pieces(assembly: Assembly) -> Iterator[tuple[str, Pose, Mesh]]:
    """File name, assembly_from_piece and mesh of every convex piece; prisms are in the frames of their kits."""
    for k, mount in enumerate(assembly.mounts):
        for i, prism in enumerate(convex_prisms(mount.kit)):
            yield f"kit{k}/piece{i:03d}.obj", mount.assembly_from_kit, prism
    for i, piece in enumerate(support_meshes(assembly.mounts)):
        yield f"stand/piece{i:03d}.obj", Pose.identity(), piece


def _inertial(mesh: Mesh) -> list[str]:
    mass = float(DENSITY * mesh.volume)
    tensor = inertia(mesh, mass)
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    entries = " ".join(f'i{"xyz"[i]}{"xyz"[j]}="{float(tensor[i, j])!r}"' for i, j in pairs)
    return [
        "<inertial>",
        f'<origin xyz="{numbers(mesh.centroid)}" rpy="0 0 0"/>',
        f'<mass value="{mass!r}"/>',
        f"<inertia {entries}/>",
        "</inertial>",
    ]


def _shape(element: str, pose: Pose, file_name: str) -> list[str]:
    return [
        f"<{element}>",
        f'<origin xyz="{numbers(pose.xyz)}" rpy="{numbers(roll_pitch_yaw(pose))}"/>',
        "<geometry>",
        f'<mesh filename="{file_name}"/>',
        "</geometry>",
        f"</{element}>",
    ]


def obj_text(mesh: Mesh) -> str:
    """A mesh as OBJ text, its coordinates in full precision."""
    rows = [f"v {numbers(vertex)}" for vertex in mesh.vertices]
    rows += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    return "\n".join(rows) + "\n"


def numbers(values: np.ndarray) -> str:
    """Numbers in full precision, separated by spaces."""
    return " ".join(map(repr, values.tolist()))
