"""The formats of exports, and the function that writes a dataset, or a part of it, in one of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kit1000.dataset.geometry import Geometry
from kit1000.errors import InputError
from kit1000.export.bop import write_bop
from kit1000.export.stl import write_stl
from kit1000.export.threemf import write_3mf
from kit1000.export.urdf import write_urdf
from kit1000.values import Assembly

if TYPE_CHECKING:
    from kit1000.dataset.reader import Dataset

ASSEMBLY_FORMATS: dict[str, tuple[str, Callable[[Assembly, Path], Path]]] = {
    "urdf": ("", write_urdf),
    "stl": (".stl", write_stl),
    "3mf": (".3mf", write_3mf),
}
"""Formats of assemblies: the file name ending (empty for a folder), and the function that writes one."""
SCENE_FORMATS = {"bop": write_bop}
"""Formats of scenes: the function that writes many of them."""
FORMATS = (*ASSEMBLY_FORMATS, *SCENE_FORMATS)


def export(
    source: Dataset | Geometry | str | Path,
    format: str,
    out: Path,
    ids: Sequence[str] = (),
    split: str | None = None,
    sensor: str = "ideal",
) -> Path:
    """Write a dataset, or a part of it, in another format; returns the folder.

    Args:
        source: a dataset or its folder; for assemblies also its geometry.
        format: one of FORMATS.
        out: folder to write to. bop: must not exist; else it gets a file or folder for each assembly, named by its id.
        ids: ids of assemblies, or of scenes for bop; all of the split when empty.
        split: train, val or test; all of them when None.
        sensor: sensor of the depth images for bop: ideal, d415 or photoneo.

    Raises:
        InputError: an unknown format, split, sensor or id, or a folder that cannot be written.
    """
    if format in SCENE_FORMATS:
        return SCENE_FORMATS[format](_open_dataset(source), out, ids, split, sensor)
    if format not in ASSEMBLY_FORMATS:
        raise InputError(f"no export format {format!r}; there are {', '.join(FORMATS)}")
    geometry = _geometry(source)
    ending, write = ASSEMBLY_FORMATS[format]
    for assembly_id in ids or _assemblies(geometry, split):
        write(geometry.assembly(assembly_id), out / f"{assembly_id}{ending}")
    return out


def _assemblies(geometry: Geometry, split: str | None) -> list[str]:
    """Ids of the assemblies of a split, or of all."""
    assembly_ids = sorted(i for i, row in geometry.assemblies.items() if split in (None, row["split"]))
    if not assembly_ids:
        raise InputError(f"{geometry.root}: no assemblies in split {split!r}")
    return assembly_ids


def _geometry(source: Dataset | Geometry | str | Path) -> Geometry:
    if isinstance(source, str | Path):
        return Geometry(source)
    return source if isinstance(source, Geometry) else source.geometry


def _open_dataset(source: Dataset | Geometry | str | Path) -> Dataset:
    """The dataset with its recordings."""
    if not isinstance(source, str | Path | Geometry):
        return source
    from kit1000.dataset.reader import Dataset  # only here: assemblies need no reader of recordings

    return Dataset(source.root if isinstance(source, Geometry) else source)
