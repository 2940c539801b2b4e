"""One row a query: what was measured of each answer, and what the query is like; as arrays and as a CSV file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.files import write_bytes


@dataclass(frozen=True, eq=False)
class PerQuery:
    """Arrays (n,), read-only; a row a query. NaN: not measured, as positions of a method that predicts rotations."""

    query_id: np.ndarray
    """str"""
    track: np.ndarray
    """str; `curves` for the queries of the robustness curves."""
    scene_id: np.ndarray
    """str"""
    assembly_id: np.ndarray
    """str: queries about one assembly are resampled together."""
    covered: np.ndarray
    """bool: whether there is an answer; without one, no motion is what is measured."""
    position_mm: np.ndarray
    """Of the part's centroid, to the goal that judges: the one of least MSSD."""
    rotation_deg: np.ndarray
    """To the same goal."""
    mssd_mm: np.ndarray
    """Most that any point of the part misses, to the same goal."""
    position_plain_mm: np.ndarray
    """To the goal that the guess was drawn around."""
    rotation_plain_deg: np.ndarray
    seated: np.ndarray
    """bool; False where it is not measured: in curves, and for a method that predicts rotations."""
    seated_strict: np.ndarray
    """bool"""
    penetration_mm: np.ndarray
    judged: np.ndarray
    """bool: whether the exact judge was asked."""
    differs: np.ndarray
    """bool: whether its verdict is another than that of the fast test."""
    confidence: np.ndarray
    """0 to 1; 0 without an answer."""
    seconds: np.ndarray
    """NaN where it is not told."""
    rest_mode: np.ndarray
    """str: upright or tumbled."""
    tilt_deg: np.ndarray
    """Of the slot: its axis, z of the kit, against z of the world."""
    kits: np.ndarray
    """int: how many the assembly has."""
    held_out: np.ndarray
    """bool: whether the part's family is in no training scene."""
    visible: np.ndarray
    """Share of the part's silhouette that the camera sees."""
    symmetry: np.ndarray
    """str: one goal, several goals, or free axis; that of the part in its slot."""
    loose: np.ndarray
    """bool: whether the slot also takes the part in a pose that is no goal."""

    def __post_init__(self) -> None:
        for field in fields(self):
            array = np.asarray(getattr(self, field.name))
            array.setflags(write=False)
            object.__setattr__(self, field.name, array)

    def __len__(self) -> int:
        return len(self.query_id)

    def __getitem__(self, index: np.ndarray | slice) -> PerQuery:
        """Some of the rows, by indices, a mask or a slice."""
        return PerQuery(**{name: column[index] for name, column in self.columns().items()})

    def columns(self) -> dict[str, np.ndarray]:
        """The arrays by name, in order."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def of_track(self, track: str) -> PerQuery:
        """The rows of a track."""
        return self[self.track == track]

    @property
    def tracks(self) -> tuple[str, ...]:
        """The tracks that have rows, in the order in which they first come."""
        names, first = np.unique(self.track, return_index=True)
        return tuple(names[np.argsort(first)].tolist())


def write_per_query(path: Path, rows: PerQuery) -> None:
    """Write the rows as a CSV file: a header, then a line a query; what was not measured is left empty."""
    columns = rows.columns()
    lines = [",".join(columns), *map(",".join, zip(*map(_written, columns.values()), strict=True))]
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _written(column: np.ndarray) -> Sequence[str]:
    """A column as text, a cell a row."""
    if column.dtype.kind == "b":
        return ["true" if value else "false" for value in column.tolist()]
    return [_cell(value) for value in column.tolist()]


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{round(value, 9):.9g}"
    return str(value)
