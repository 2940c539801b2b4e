"""A dataset small enough for tests, files for tests to read, and what tests ask of folders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import card_samples
import recorded

from kit1000.dataset.mesh_files import stl_bytes
from kit1000.generation.plan import Sources, scene_id_of
from kit1000.generation.presets import Preset
from kit1000.generation.scenes import GeneratedScene
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.parts.cad import polygon, prism
from kit1000.values import Assembly, Part

MINI = Preset("mini", 2, 1, 1, kits=(1, 2), seed=7)


def contents(folder: Path) -> dict[str, str]:
    """The hash of every file below a folder by its name, hidden ones too, the lock apart."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != ".lock"]
    return {path.relative_to(folder).as_posix(): sha256(path.read_bytes()).hexdigest() for path in files}


def corner(width: float = 24.0) -> Mesh:
    """An L of 40 x 30 mm and some width [mm], in metres."""
    outline = [(0, 0), (40, 0), (40, 9), (14, 9), (14, 30), (0, 30)]
    return mesh_from_solid(prism(polygon(outline), width)).scaled(1e-3)


def written(path: Path, mesh: Mesh) -> Path:
    """A mesh as an STL file in millimetres."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(stl_bytes(mesh))
    return path


def corners(folder: Path, widths: tuple[int, ...] = (20, 24, 28, 33)) -> Sources:
    """As many different files as MINI has parts, of shapes that take no time."""
    return Sources.of([written(folder / f"corner{width}.stl", corner(width)) for width in widths])


def sketched(
    preset: Preset, seed: int, split: str, assembly: Assembly, parts: Mapping[str, Part], extra_views: bool
) -> GeneratedScene:
    """In place of `make_scene`, a scene of made-up numbers in a millisecond, for tests of what is done with scenes."""
    scene_id, k = scene_id_of(assembly.id), int(assembly.id[-4:])
    seen = replace(recorded.observation(k), scene_id=scene_id)
    extra = replace(recorded.extra_views(k), scene_id=scene_id) if extra_views else None
    return GeneratedScene(seen, card_samples.truth(scene_id), extra, ("parts touch",) * (len(parts) + seed % 2))
