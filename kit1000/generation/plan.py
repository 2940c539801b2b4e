"""The plan of a dataset: every draw, no geometry. The same plan gives the same dataset on any number of workers.

Each part, assembly and scene has its own random stream, keyed by the root seed, its id and the attempt (`draw_part`,
`draw_assembly_of`). A draw that geometry rejects is replaced by the next attempt. The plan lists first attempts; the
tables of the dataset list the accepted ones.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.files import json_bytes, sha256
from kit1000.generation.presets import HELD_OUT, Preset
from kit1000.kits.assembly import AssemblyPlan, draw_assembly
from kit1000.parts.family import Family, dimensions
from kit1000.parts.family_catalog import FAMILIES
from kit1000.parts.mixtures import MIXTURES, choose_family
from kit1000.queries.tracks import SPLITS
from kit1000.rng import stream
from kit1000.sim.layout import UPRIGHT, draw_rest_modes

FORMAT = "kit1000-plan/2"
CONTENT_VERSION = "2.0.0"
"""Increased whenever the same plan gives other content. Each plan states it, so the id of a dataset depends on it."""
DATA_VERSION = "2.1.0"
"""Increased also if only the bytes of files change. `dataset.json` states it."""
MAX_CANDIDATES = 48  # parts tried to reach the drawn number of kits; more are tried only to reach the smallest number


@dataclass(frozen=True)
class PartDraw:
    """One attempt at a part."""

    family: str
    drawing: Family
    longest: float  # [m] longest side of the part


@dataclass(frozen=True)
class Sources:
    """Mesh files used in place of procedural parts."""

    files: dict[str, Path]
    """Files by name: the path relative to their common folder, so that a plan contains no absolute path."""
    unit: str | None = None
    """The unit of all files; None: as each file states, else guessed."""

    @classmethod
    def of(cls, paths: Iterable[Path], unit: str | None = None) -> Sources:
        """The sources of some paths."""
        absolute = [Path(os.path.abspath(path)) for path in paths]
        folder = os.path.commonpath([path.parent for path in absolute])
        return cls({path.relative_to(folder).as_posix(): path for path in absolute}, unit)


def plan_head(preset: Preset, seed: int, sources: Sources | None = None) -> dict[str, Any]:
    """The entries of a plan that are known before any mesh file is tried; mesh files have their SHA-256.

    Raises InputError for a seed out of range.
    """
    stream(seed)  # checks the seed before anything is written
    head = {
        "format": FORMAT,
        "data_version": CONTENT_VERSION,
        "preset": preset.name,
        "seed": seed,
        "config": preset.config,
        "held_out_families": sorted(HELD_OUT),
    }
    if sources is None:
        return head
    return head | {"unit": sources.unit, "sources": {name: sha256(path) for name, path in sources.files.items()}}


def make_plan(preset: Preset, seed: int, files: Sequence[str] | None = None) -> dict[str, Any]:
    """The plan of a preset with procedural parts, or with accepted mesh files, by name in their drawn order."""
    parts = _procedural_parts(preset, seed) if files is None else _parts_of_files(preset, files)
    assemblies = _assemblies(preset, seed, parts)
    own = {"parts": parts, "assemblies": assemblies, "scenes": _scenes(preset, seed, assemblies)}
    return plan_head(preset, seed) | own


def dataset_id(plan: dict[str, Any]) -> str:
    """The id of a dataset: 16 hex digits of the SHA-256 of its plan, which states the version of its content."""
    return hashlib.sha256(json_bytes(plan)).hexdigest()[:16]


def draw_part(preset: Preset, seed: int, part_id: str, split: str, attempt: int) -> PartDraw:
    """One attempt at a procedural part."""
    family = choose_family(seed, "part", part_id, attempt, weights=family_weights(preset, split))
    rng = stream(seed, "part", part_id, attempt, family)
    drawing = FAMILIES[family].draw(rng)
    return PartDraw(family, drawing, float(rng.uniform(*preset.longest)))


def draw_longest(preset: Preset, seed: int, name: str) -> float:
    """Longest side of the part that a mesh file becomes. [m]"""
    return float(stream(seed, "file", name, "longest").uniform(*preset.longest))


def file_order(seed: int, sources: Sources) -> list[str]:
    """The names of mesh files in the random order in which they become parts."""
    names = sorted(sources.files)
    return [names[i] for i in stream(seed, "sources").permutation(len(names))]


def draw_assembly_of(
    preset: Preset, seed: int, assembly_id: str, kits: int, attempt: int
) -> tuple[np.ndarray, AssemblyPlan]:
    """One attempt at placing a number of kits: (n,) int the kit at each place, the base first; and how they stand."""
    rng = stream(seed, "assembly", assembly_id, attempt)
    least, most = map(float, np.radians(preset.tilt_deg))
    order = rng.permutation(kits)
    brackets = tuple(float(np.radians(tilt)) for tilt in preset.brackets_deg)
    return order, draw_assembly(rng, kits, preset.level_base, (least, most), brackets)


def family_weights(preset: Preset, split: str) -> dict[str, float]:
    """Weights of the families of a split; held-out families occur in the test split only."""
    weights = MIXTURES[preset.mixture]
    return {name: weight for name, weight in weights.items() if split == "test" or name not in HELD_OUT}


def _procedural_parts(preset: Preset, seed: int) -> dict[str, Any]:
    parts = {}
    for split in SPLITS:
        for i in range(preset.count(split)):
            part_id = f"{split}-{i:04d}"
            draw = draw_part(preset, seed, part_id, split, 0)
            parts[part_id] = {
                "split": split,
                "family": draw.family,
                "longest": draw.longest,
                "dimensions": dimensions(draw.drawing),
            }
    return parts


def _parts_of_files(preset: Preset, names: Sequence[str]) -> dict[str, Any]:
    """Mesh files dealt to the splits in the preset's proportions."""
    total = sum(preset.count(split) for split in SPLITS)
    count = min(len(names), total)
    shares = np.cumsum([0] + [preset.count(split) for split in SPLITS]) * count / total
    bounds = np.floor(shares + 0.5).astype(int)  # halves go to the earlier split: a single file is for training
    return {
        f"{split}-{k - low:04d}": {"split": split, "source": names[k]}
        for split, low, high in zip(SPLITS, bounds[:-1], bounds[1:], strict=True)
        for k in range(low, high)
    }


def candidate_order(seed: int, target: str, ids: list[str]) -> list[str]:
    """The other parts of a split, in the random order in which they are tried as neighbours of a target."""
    others = [other for other in ids if other != target]
    return [others[i] for i in stream(seed, "company", target).permutation(len(others))]


def _assemblies(preset: Preset, seed: int, parts: dict[str, Any]) -> dict[str, Any]:
    """One assembly for each part of a split: the part is its target, its neighbours are of the same split."""
    plan = {}
    for split in SPLITS:
        ids = split_ids(parts, split)
        for target in ids:
            kits = int(stream(seed, "kits", target).integers(preset.kits[0], preset.kits[1] + 1))
            candidates = candidate_order(seed, target, ids)[:MAX_CANDIDATES]
            plan[target] = {"split": split, "target": target, "kits": kits, "company": candidates}
    return plan


def scene_id_of(assembly_id: str) -> str:
    """The id of an assembly's scene: test-s0007 for test-0007."""
    split, _, number = assembly_id.rpartition("-")
    return f"{split}-s{number}"


def rest_modes(preset: Preset, seed: int, scene_id: str, parts: int, attempt: int = 0) -> tuple[str, ...]:
    """Rest modes of the parts of a scene, in the order p0, p1, ...; one attempt."""
    if preset.all_upright and attempt == 0:  # then as elsewhere: some part topples
        return (UPRIGHT,) * parts
    return draw_rest_modes(stream(seed, "rest", scene_id, attempt), parts)


def is_crowded(preset: Preset, seed: int, scene_id: str, parts: int) -> bool:
    """Whether the parts of a scene are pushed together; never a single one."""
    return parts > 1 and bool(stream(seed, "crowded", scene_id).random() < preset.crowded)


def _scenes(preset: Preset, seed: int, assemblies: dict[str, Any]) -> dict[str, Any]:
    """One scene for each assembly. The rest modes are redrawn where an assembly ends with fewer kits than drawn."""
    scenes = {}
    for assembly_id, row in assemblies.items():
        scene_id = scene_id_of(assembly_id)
        rest = list(rest_modes(preset, seed, scene_id, row["kits"]))
        crowded = is_crowded(preset, seed, scene_id, row["kits"])
        scenes[scene_id] = {"split": row["split"], "assembly": assembly_id, "rest": rest, "crowded": crowded}
    return scenes


def split_ids(parts: dict[str, Any], split: str) -> list[str]:
    """Ids of the planned parts of a split, sorted."""
    return sorted(part_id for part_id, row in parts.items() if row["split"] == split)
