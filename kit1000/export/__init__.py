"""Datasets for other tools: assemblies as URDF, STL or 3MF, scenes as a dataset in the format of BOP."""

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

ASSEMBLIES: dict[str, tuple[str, Callable[[Assembly, Path], Path]]] = {
    "urdf": ("", write_urdf),
    "stl": (".stl", write_stl),
    "3mf": (".3mf", write_3mf),
}
"""Formats of one assembly: the ending of its file (none: a folder), and what writes it."""
SCENES = {"bop": write_bop}
"""Formats of many scenes together."""
FORMATS = (*ASSEMBLIES, *SCENES)


def export(
    source: Dataset | Geometry | str | Path,
    format: str,
    out: Path,
    ids: Sequence[str] = (),
    split: str | None = None,
    sensor: str = "ideal",
) -> Path:
    """Write a dataset, or some of it, in another format; returns the folder.

    Args:
        source: a dataset or its folder; its geometry is enough for assemblies.
        format: one of FORMATS.
        out: folder to write to. bop: a new one; else an entry for each assembly, named after it.
        ids: assemblies, or scenes for bop; all of the split when empty.
        split: train, val or test; all of them when None.
        sensor: for bop, whose depth images: ideal or d415.

    Raises:
        InputError: an unknown format, split, sensor or id, or a place that cannot be written.
    """
    if format in SCENES:
        return SCENES[format](_opened(source), out, ids, split, sensor)
    if format not in ASSEMBLIES:
        raise InputError(f"no export format {format!r}; there are {', '.join(FORMATS)}")
    geometry = _geometry(source)
    ending, write = ASSEMBLIES[format]
    for assembly_id in ids or _assemblies(geometry, split):
        write(geometry.assembly(assembly_id), out / f"{assembly_id}{ending}")
    return out


def _assemblies(geometry: Geometry, split: str | None) -> list[str]:
    """Ids of the assemblies of a split, or of all."""
    found = sorted(i for i, row in geometry.assemblies.items() if split in (None, row["split"]))
    if not found:
        raise InputError(f"{geometry.root}: no assemblies in split {split!r}")
    return found


def _geometry(source: Dataset | Geometry | str | Path) -> Geometry:
    if isinstance(source, str | Path):
        return Geometry(source)
    return source if isinstance(source, Geometry) else source.geometry


def _opened(source: Dataset | Geometry | str | Path) -> Dataset:
    """The dataset with its recordings."""
    if not isinstance(source, str | Path | Geometry):
        return source
    from kit1000.dataset.reader import Dataset  # not before it is needed: assemblies go without a reader of recordings

    return Dataset(source.root if isinstance(source, Geometry) else source)
