"""Export of a dataset: assemblies as URDF or STL, scenes as MJCF or in the BOP format; kits of own parts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.values import Kit, Part

FORMATS = ("urdf", "stl", "mjcf", "bop")


def export(
    data: Path, format: str, out: Path, ids: Sequence[str] = (), split: str | None = None, sensor: str = "ideal"
) -> Path:
    """Write a dataset, or a part of it, in another format; returns the folder.

    Args:
        data: dataset folder.
        format: one of FORMATS.
        out: folder to write to. bop: must not exist. urdf: gets a folder for each assembly. mjcf: gets one for each
            scene. stl: gets a file for each assembly, `ID.stl`, and for each of their parts, `part-ID.stl`, as a
            printer needs them.
        ids: ids of assemblies, or of scenes for bop and mjcf; all of the split when empty.
        split: train, val or test; all of them when None.
        sensor: sensor of the depth images for bop: ideal, d415 or photoneo.

    Raises:
        InputError: an unknown format, split, sensor or id, or a folder that cannot be written.
    """
    # Writers are imported when they are needed: a kit for an own part, which is in this package too, needs few of them.
    if format not in FORMATS:
        raise InputError(f"no export format {format!r}; there are {', '.join(FORMATS)}")
    if format in ("bop", "mjcf"):
        from kit1000.dataset.reader import Dataset
        from kit1000.export.bop import write_bop
        from kit1000.export.mjcf import write_mjcf

        dataset = Dataset(data)
        return write_mjcf(dataset, out, ids, split) if format == "mjcf" else write_bop(dataset, out, ids, split, sensor)
    from kit1000.dataset.geometry import Geometry
    from kit1000.dataset.mesh_files import stl_bytes
    from kit1000.export.urdf import write_urdf
    from kit1000.files import write_own

    geometry = Geometry(data)
    chosen = list(ids) or sorted(i for i, row in geometry.assemblies.items() if split in (None, row["split"]))
    if not chosen:
        raise InputError(f"{geometry.root}: no assemblies in split {split!r}")
    part_ids: set[str] = set()
    for assembly in map(geometry.assembly, chosen):
        if format == "urdf":
            write_urdf(assembly, out / assembly.id)
        else:
            write_own(out / f"{assembly.id}.stl", stl_bytes(assembly.mesh))
            part_ids |= {mount.kit.slot.part_id for mount in assembly.mounts}
    for part_id in sorted(part_ids):
        mesh = standing_mesh(geometry.part(part_id), geometry.kit(part_id))
        write_own(out / f"part-{part_id}.stl", stl_bytes(mesh))
    return out


def standing_mesh(part: Part, kit: Kit) -> Mesh:
    """The part on its insertion face, its lowest point at z = 0: mostly its largest flat face is below."""
    turned = part.mesh.moved(Pose(kit.slot.kit_from_part.wxyz, np.zeros(3)))
    return turned.moved(Pose.from_translation((0.0, 0.0, -turned.bounds[0, 2]))).rounded_float32()
