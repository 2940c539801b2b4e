"""Fresh parts to learn completion from: draws of the families of the train split, made when needed and kept in shards.

Part i of a seed is the same whoever makes it, so shards are only a cache: a run that finds none makes its own.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kit1000.errors import InputError, MeshRefused, Redraw
from kit1000.files import write_bytes
from kit1000.generation.plan import family_weights
from kit1000.generation.presets import PRESETS
from kit1000.kits.face import resting_faces
from kit1000.mesh import Mesh, defect_float32, mesh_from_solid, solid_from_mesh
from kit1000.numerics.linear_algebra import length
from kit1000.parts.family import make_part, part_of_mesh
from kit1000.parts.family_catalog import FAMILIES
from kit1000.parts.mixtures import choose_family
from kit1000.rng import stream

PRESET = PRESETS["kit1000"]
SHARD = 100  # parts of a file
STRETCHED = 0.25  # share of parts whose axes are scaled apart, by up to STRETCH
STRETCH = 1.5
JOINED = 0.1  # share that is the union of two drawings
LEAST_PROBABILITY = 0.004  # of a resting face: rarer ones are not learned
MAX_DRAWS = 200  # of one part


@dataclass(frozen=True, eq=False)
class DrawnPart:
    """A part and how it may rest on a table."""

    mesh: Mesh
    """[m] about its centre of mass."""
    down: np.ndarray
    """(k, 3) outward unit normals of the faces it rests on, the most probable first."""
    probability: np.ndarray
    """(k,) of each, the sum is 1."""


@dataclass(frozen=True)
class DrawnParts:
    """The first parts of a seed; a sequence."""

    seed: int
    count: int
    folder: Path | None = None
    """Folder of the shards; None keeps them in memory alone."""
    _shards: dict[int, list[DrawnPart]] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> DrawnPart:
        if not 0 <= index < self.count:
            raise IndexError(index)
        number, place = divmod(index, SHARD)
        if number not in self._shards:
            self._shards[number] = self.shard(number)
        return self._shards[number][place]

    def __iter__(self) -> Iterator[DrawnPart]:
        return (self[index] for index in range(self.count))

    def shard(self, number: int) -> list[DrawnPart]:
        """The parts of a shard, from its file, which is written if there is none yet."""
        path = None if self.folder is None else self.folder / f"parts-{self.seed}-{number:04d}.npz"
        if path is not None and path.exists():
            return _read(path)
        parts = [drawn_part(self.seed, i) for i in range(SHARD * number, SHARD * (number + 1))]
        if path is not None:
            write_bytes(path, _packed(parts))
        return parts


def drawn_part(seed: int, index: int) -> DrawnPart:
    """Part number `index` of a seed: the first of its draws that is a part."""
    for attempt in range(MAX_DRAWS):
        rng = stream(seed, "completion-part", index, attempt)
        try:
            mesh = _mesh(seed, index, attempt, rng)
            faces = resting_faces(mesh, LEAST_PROBABILITY)
        except (Redraw, MeshRefused):
            continue
        if faces and length(mesh.extents) / 2 <= PRESET.max_part_radius:
            probability = np.array([face.probability for face in faces])
            return DrawnPart(mesh, np.stack([face.normal for face in faces]), probability / probability.sum())
    raise InputError(f"part {index} of seed {seed}: none of {MAX_DRAWS} draws is a part")


def _mesh(seed: int, index: int, attempt: int, rng: np.random.Generator) -> Mesh:
    """A closed mesh about its centre of mass; raises Redraw or MeshRefused."""
    longest = float(rng.uniform(*PRESET.longest))
    stretched, joined = rng.random() < STRETCHED, rng.random() < JOINED
    mesh = _drawing(seed, (index, attempt, 0), longest)
    if joined:
        other = _drawing(seed, (index, attempt, 1), longest * float(rng.uniform(0.5, 1)))
        yaw = 0.25 * np.pi * rng.integers(8)
        mesh = _union(mesh, other, yaw, rng.uniform(-0.4, 0.4, 3) * mesh.extents)
    if stretched:
        factors = STRETCH ** rng.uniform(-0.5, 0.5, 3)
        mesh = Mesh(mesh.vertices * factors, mesh.faces)
    if not (stretched or joined):
        return mesh
    mesh = part_of_mesh("drawn", mesh, longest).mesh.merged()
    if fault := defect_float32(mesh):
        raise Redraw(fault)
    return mesh


def _drawing(seed: int, key: Sequence[int], longest: float) -> Mesh:
    weights = family_weights(PRESET, "train")
    family = choose_family(seed, "completion-part", *key, weights=weights)
    drawing = FAMILIES[family].draw(stream(seed, "completion-part", *key, family))
    return make_part("drawn", family, drawing, longest).mesh


def _union(mesh: Mesh, other: Mesh, yaw: float, shift: np.ndarray) -> Mesh:
    """The union of two meshes, the other rotated about a vertical [rad] and shifted (3,) [m]; one body."""
    moved = solid_from_mesh(other).rotate((0.0, 0.0, float(np.degrees(yaw)))).translate(tuple(shift.tolist()))
    pieces = (solid_from_mesh(mesh) + moved).decompose()
    return mesh_from_solid(max(pieces, key=lambda piece: piece.volume()))


def _packed(parts: Sequence[DrawnPart]) -> bytes:
    """The parts as a file of numpy."""
    arrays = {
        "vertices": np.concatenate([part.mesh.vertices for part in parts]).astype(np.float32),
        "faces": np.concatenate([part.mesh.faces for part in parts]),
        "down": np.concatenate([part.down for part in parts]),
        "probability": np.concatenate([part.probability for part in parts]),
        "counts": np.array([(len(part.mesh.vertices), len(part.mesh.faces), len(part.down)) for part in parts]),
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def _read(path: Path) -> list[DrawnPart]:
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in ("vertices", "faces", "down", "probability", "counts")}
    ends = arrays["counts"][:-1].cumsum(0)
    vertices, faces = np.split(arrays["vertices"], ends[:, 0]), np.split(arrays["faces"], ends[:, 1])
    down, probability = np.split(arrays["down"], ends[:, 2]), np.split(arrays["probability"], ends[:, 2])
    columns = zip(vertices, faces, down, probability, strict=True)
    return [DrawnPart(Mesh(v.astype(np.float64), f), d, p) for v, f, d, p in columns]
