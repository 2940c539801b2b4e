"""Contact sheets of a dataset: what a person looks at before trusting it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kit1000.data.dataset import Geometry
from kit1000.errors import InputError
from kit1000.sim.preview import assembly_tile, kit_tile, part_tile, sheet


def contact_sheet_of(geometry: Geometry, what: str, split: str, count: int, ids: Sequence[str] = ()) -> bytes:
    """A PNG of parts, kits or assemblies: the given ids, or `count` spread evenly over a split."""
    rows = getattr(geometry, what)
    chosen = list(ids) or _spread(sorted(i for i, row in rows.items() if row["split"] == split), count)
    if not chosen:
        raise InputError(f"{geometry.root}: no {what} in split {split!r}")
    return sheet([_tile(geometry, what, item_id) for item_id in chosen], [_label(geometry, what, i) for i in chosen])


def _spread(ids: list[str], count: int) -> list[str]:
    return [ids[i] for i in np.unique(np.linspace(0, len(ids) - 1, count).round().astype(int))] if ids else []


def _tile(geometry: Geometry, what: str, item_id: str) -> np.ndarray:
    if what == "parts":
        return part_tile(geometry.part(item_id))
    if what == "kits":
        return kit_tile(geometry.part(item_id), geometry.kit(item_id))
    assembly = geometry.assembly(item_id)
    return assembly_tile(assembly, {m.kit.id: geometry.part(m.kit.id) for m in assembly.mounts})


def _label(geometry: Geometry, what: str, item_id: str) -> str:
    if what == "assemblies":
        return f"{item_id}  {len(geometry.assemblies[item_id]['mounts'])} kits"
    return f"{item_id}  {geometry.parts[item_id]['family']}"
