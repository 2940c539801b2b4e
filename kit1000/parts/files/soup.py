"""Triangles as a file holds them, before any repair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.errors import MeshRefused


@dataclass(frozen=True, eq=False)
class Cut:
    """An object of a slicer whose negative volumes are subtracted from the volumes before them, as the slicer does."""

    runs: tuple[np.ndarray, ...]
    """(m, 3) int64 faces of parts and of negative volumes by turns, parts first."""

    @property
    def part_faces(self) -> np.ndarray:
        """(m, 3) int64 the faces of its parts."""
        return np.concatenate(self.runs[::2])


@dataclass(frozen=True, eq=False)
class TriangleSoup:
    """Triangles as they are stored in a file: no connectivity or orientation is guaranteed."""

    vertices: np.ndarray
    """(n, 3) float64, in the unit of the file."""
    faces: np.ndarray
    """(m, 3) int64, without those of `cuts`."""
    unit: str | None = None
    """The unit stated in the file."""
    notes: tuple[str, ...] = ()
    """Irregularities of the file that were ignored, and volumes that are no part."""
    cuts: tuple[Cut, ...] = ()

    @property
    def part_faces(self) -> np.ndarray:
        """(m, 3) int64 all faces but those of negative volumes."""
        return np.concatenate([self.faces, *(cut.part_faces for cut in self.cuts)]) if self.cuts else self.faces


def soup_of_corners(corners: np.ndarray, notes: tuple[str, ...] = ()) -> TriangleSoup:
    """The soup of corners (3 m, 3), three for each triangle."""
    return TriangleSoup(corners, np.arange(len(corners)).reshape(-1, 3), notes=notes)


def joined(meshes: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Meshes (vertices, faces) as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    points = np.concatenate([np.zeros((0, 3)), *(vertices for vertices, _ in meshes)])
    faces = [faces + start for (_, faces), start in zip(meshes, starts[:-1], strict=True)]
    return points, np.concatenate([np.zeros((0, 3), dtype=np.int64), *faces])


def check_indices(faces: np.ndarray, count: int, where: str) -> None:
    """Raise MeshRefused when faces name a vertex that does not exist."""
    if len(faces) and (faces.min() < 0 or faces.max() >= count):
        worst = int(faces.min()) if faces.min() < 0 else int(faces.max())
        raise MeshRefused(f"{where}: faces name vertex {worst:,} of {count:,}")
