"""A small dataset for tests, mesh files for tests, and the hashes of a folder."""

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


def file_hashes(folder: Path) -> dict[str, str]:
    """The SHA-256 of every file below a folder by name, hidden ones included, except the lock."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != ".lock"]
    return {path.relative_to(folder).as_posix(): sha256(path.read_bytes()).hexdigest() for path in files}


def l_shape(width: float = 24.0) -> Mesh:
    """An L-shaped mesh [m] of 40 x 30 mm and some width [mm]."""
    outline = [(0, 0), (40, 0), (40, 9), (14, 9), (14, 30), (0, 30)]
    return mesh_from_solid(prism(polygon(outline), width)).scaled(1e-3)


def write_stl(path: Path, mesh: Mesh) -> Path:
    """Write a mesh as an STL file in millimetres; returns the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(stl_bytes(mesh))
    return path


def l_shape_sources(folder: Path, widths: tuple[int, ...] = (20, 24, 28, 33)) -> Sources:
    """As many different mesh files as MINI has parts, of simple shapes."""
    return Sources.of([write_stl(folder / f"corner{width}.stl", l_shape(width)) for width in widths])


def fake_scene(
    preset: Preset, seed: int, split: str, assembly: Assembly, parts: Mapping[str, Part], extra_views: bool
) -> GeneratedScene:
    """Replaces `make_scene`: a scene of made-up numbers in a millisecond."""
    scene_id, k = scene_id_of(assembly.id), int(assembly.id[-4:])
    seen = replace(recorded.observation(k), scene_id=scene_id)
    extra = replace(recorded.extra_views(k), scene_id=scene_id) if extra_views else None
    return GeneratedScene(seen, card_samples.truth(scene_id), extra, ("parts touch",) * (len(parts) + seed % 2))
