"""One row per query: the measured quantities and the properties of the query, as arrays and as a CSV file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from benchmark import quantities
from kit1000.errors import InternalError
from kit1000.files import write_own


@dataclass(frozen=True, eq=False)
class PerQuery:
    """Arrays (n,), read-only, a row per query. NaN: not measured, as positions of a method that predicts rotations."""

    query_id: np.ndarray
    """str"""
    track: np.ndarray
    """str; `curves` for the queries of the robustness curves."""
    scene_id: np.ndarray
    """str"""
    assembly_id: np.ndarray
    """str"""
    part_id: np.ndarray
    """str"""
    covered: np.ndarray
    """bool: whether there is a prediction; without one, the zero motion is measured."""
    quantities: Mapping[str, np.ndarray]
    """Values by key of `quantities.per_query()`: float in the unit of the key, or bool for a rate."""
    exact_test: np.ndarray
    """bool: whether the exact seating test ran."""
    exact_disagreement: np.ndarray
    """bool: whether its result differs from that of the fast test."""
    confidence: np.ndarray
    """0 to 1; 0 without a prediction."""
    rest_mode: np.ndarray
    """str: upright or tumbled."""
    tilt_deg: np.ndarray
    """Angle between the axis of the slot, z of the kit, and z of the world."""
    kits: np.ndarray
    """int: number of kits in the assembly."""
    crowded: np.ndarray
    """bool: whether the parts of the scene are pushed together."""
    held_out: np.ndarray
    """bool: whether the part's family is in no training scene."""
    visible: np.ndarray
    """Share of the part's silhouette that is visible to the camera."""
    noise_px: np.ndarray
    """[px] RMS noise of the disparity of the image; 0 of ideal depth, NaN where it is not known."""
    symmetry: np.ndarray
    """str: one goal, several goals, or free axis; that of the part in its slot."""

    def __post_init__(self) -> None:
        keys = [quantity.key for quantity in quantities.per_query()]
        if wrong := {*keys} ^ {*self.quantities}:
            raise InternalError(f"rows per query: quantities missing or too many: {', '.join(sorted(wrong))}")
        object.__setattr__(self, "quantities", MappingProxyType({key: self.quantities[key] for key in keys}))
        for column in self.columns().values():
            column.setflags(write=False)

    def __len__(self) -> int:
        return len(self.query_id)

    def __getitem__(self, index: np.ndarray | slice) -> PerQuery:
        """Some of the rows, by indices, a mask or a slice."""
        return PerQuery.of_columns({name: column[index] for name, column in self.columns().items()})

    @staticmethod
    def of_columns(columns: Mapping[str, np.ndarray]) -> PerQuery:
        """The rows of columns by name, as `columns` gives them."""
        measured = {quantity.key: columns[quantity.key] for quantity in quantities.per_query()}
        rest = {field.name: columns[field.name] for field in fields(PerQuery) if field.name != "quantities"}
        return PerQuery(**rest, quantities=measured)

    def columns(self) -> dict[str, np.ndarray]:
        """All arrays by name, in order, the quantities in place."""
        columns: dict[str, np.ndarray] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            columns |= value if field.name == "quantities" else {field.name: value}
        return columns

    def of_track(self, track: str) -> PerQuery:
        """The rows of a track."""
        return self[self.track == track]

    @property
    def clusterings(self) -> tuple[np.ndarray, np.ndarray]:
        """Queries about one assembly are resampled together, and so are queries about one part."""
        return self.assembly_id, self.part_id

    @property
    def tracks(self) -> tuple[str, ...]:
        """The tracks that have rows, in the order of their first rows."""
        names, first = np.unique(self.track, return_index=True)
        return tuple(names[np.argsort(first)].tolist())


def write_per_query(path: Path, rows: PerQuery) -> None:
    """Write the rows as a CSV file: a header, then a line per query; values that were not measured are empty."""
    columns = rows.columns()
    lines = [",".join(columns), *map(",".join, zip(*map(_cells, columns.values()), strict=True))]
    write_own(path, ("\n".join(lines) + "\n").encode())


def _cells(column: np.ndarray) -> Sequence[str]:
    """A column as text, a cell per row."""
    if column.dtype.kind == "b":
        return ["true" if value else "false" for value in column.tolist()]
    return [_cell(value) for value in column.tolist()]


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{round(value, 9):.9g}"
    return str(value)
