"""The plan of a dataset: every draw, no geometry. The same plan gives the same dataset on any number of workers.

Each thing is drawn from its own stream, addressed by the root seed, its id and its attempt (`draw_part`,
`draw_assembly_of`); a draw that geometry rejects is replaced by the next attempt of the same stream. The plan lists
first attempts, so a reader sees what was asked for; tables list what came of it.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.files import json_bytes, sha256
from kit1000.generation.presets import HELD_OUT, Preset
from kit1000.kits.assembly import AssemblyPlan, draw_assembly
from kit1000.parts.catalog import FAMILIES
from kit1000.parts.family import Family, dimensions
from kit1000.parts.mixtures import MIXTURES, choose_family
from kit1000.rng import stream
from kit1000.sim.layout import draw_rest_modes
from kit1000.tracks import SPLITS

FORMAT = "kit1000-plan/2"
DATA_VERSION = "0.2.1"
"""Raised whenever the same plan gives other data."""
MAX_SOURCE_FILES = 10  # files dealt to one part at most: the next is tried when one cannot be a part
MAX_CANDIDATES = (
    24  # parts asked to join an assembly before it may stay smaller than drawn; more only to reach the least
)


@dataclass(frozen=True)
class PartDraw:
    """One attempt at a part."""

    family: str
    drawing: Family
    longest: float
    """[m] of the part's longest side."""


@dataclass(frozen=True)
class Sources:
    """Mesh files that take the place of procedural parts."""

    files: dict[str, Path]
    """By name: the path from the folder that holds them all, so that a plan says nothing of this machine."""
    unit: str | None = None
    """The unit of all of them; None: as each file says, else guessed."""

    @classmethod
    def of(cls, paths: Iterable[Path], unit: str | None = None) -> Sources:
        """The sources of some paths."""
        whole = [Path(os.path.abspath(path)) for path in paths]
        folder = os.path.commonpath([path.parent for path in whole])
        return cls({path.relative_to(folder).as_posix(): path for path in whole}, unit)


@dataclass(frozen=True)
class AssemblyDraw:
    """One attempt at an assembly."""

    order: np.ndarray
    """(n,) where each chosen kit stands: order[0] is the base."""
    placement: AssemblyPlan


def make_plan(preset: Preset, seed: int, sources: Sources | None = None) -> dict[str, Any]:
    """The plan of a preset, with procedural parts or with parts read from files."""
    parts = _parts_from_files(preset, seed, sources) if sources is not None else _procedural_parts(preset, seed)
    origin = {} if sources is None else {"unit": sources.unit}
    return origin | {
        "format": FORMAT,
        "data_version": DATA_VERSION,
        "preset": preset.name,
        "seed": seed,
        "config": preset.config,
        "held_out_families": sorted(HELD_OUT),
        "parts": parts,
        "assemblies": (assemblies := _assemblies(preset, seed, parts)),
        "scenes": _scenes(seed, assemblies),
    }


def dataset_id(plan: dict[str, Any]) -> str:
    """The identity of a dataset: a hash of its plan, data version included."""
    return hashlib.sha256(json_bytes(plan)).hexdigest()[:16]


def draw_part(preset: Preset, seed: int, part_id: str, split: str, attempt: int) -> PartDraw:
    """One attempt at a procedural part."""
    family = choose_family(seed, "part", part_id, attempt, weights=family_weights(preset, split))
    rng = stream(seed, "part", part_id, attempt, family)
    drawing = FAMILIES[family].draw(rng)
    return PartDraw(family, drawing, float(rng.uniform(*preset.longest)))


def draw_longest(preset: Preset, seed: int, part_id: str) -> float:
    """[m] longest side of a part that is read from a file."""
    return float(stream(seed, "part", part_id, "longest").uniform(*preset.longest))


def draw_assembly_of(preset: Preset, seed: int, assembly_id: str, kits: int, attempt: int) -> AssemblyDraw:
    """One attempt at placing a number of kits."""
    rng = stream(seed, "assembly", assembly_id, attempt)
    least, most = np.radians(preset.tilt_deg)
    order = rng.permutation(kits)
    brackets = tuple(float(np.radians(tilt)) for tilt in preset.brackets_deg)
    return AssemblyDraw(
        order, draw_assembly(rng, kits, preset.level_base, side_tilt=(float(least), float(most)), brackets=brackets)
    )


def family_weights(preset: Preset, split: str) -> dict[str, float]:
    """The weight of each family that a split draws from: the held-out ones appear in the test split alone."""
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


def _parts_from_files(preset: Preset, seed: int, sources: Sources) -> dict[str, Any]:
    """Files dealt out in a drawn order, split in the preset's proportions; what is left over are spares."""
    names = sorted(sources.files)
    order = [names[i] for i in stream(seed, "sources").permutation(len(names))]
    total = sum(preset.count(split) for split in SPLITS)
    count = min(len(names), total)
    shares = np.cumsum([0] + [preset.count(split) for split in SPLITS]) * count / total
    bounds = np.floor(shares + 0.5).astype(int)  # halves go to the earlier split: a single file is for training
    parts = {}
    for split, low, high in zip(SPLITS, bounds[:-1], bounds[1:], strict=True):
        for k in range(low, high):
            part_id = f"{split}-{k - low:04d}"
            parts[part_id] = {
                "split": split,
                "sources": [[name, sha256(sources.files[name])] for name in order[k::count][:MAX_SOURCE_FILES]],
                "longest": draw_longest(preset, seed, part_id),
            }
    return parts


def candidate_order(seed: int, target: str, ids: list[str]) -> list[str]:
    """The other parts of a split in the order in which they are asked to join a target's assembly."""
    others = [other for other in ids if other != target]
    return [others[i] for i in stream(seed, "company", target).permutation(len(others))]


def _assemblies(preset: Preset, seed: int, parts: dict[str, Any]) -> dict[str, Any]:
    """One assembly for each part of a split, which is its target; company from the same split."""
    plan = {}
    for split in SPLITS:
        ids = split_ids(parts, split)
        for target in ids:
            kits = int(stream(seed, "kits", target).integers(preset.kits[0], preset.kits[1] + 1))
            company = candidate_order(seed, target, ids)[:MAX_CANDIDATES]
            plan[target] = {"split": split, "target": target, "kits": kits, "company": company}
    return plan


def scene_id_of(assembly_id: str) -> str:
    """The scene of an assembly: test-0007 stands in test-s0007."""
    split, _, number = assembly_id.rpartition("-")
    return f"{split}-s{number}"


def rest_modes(seed: int, scene_id: str, parts: int, attempt: int = 0) -> tuple[str, ...]:
    """How the parts of a scene come to lie, in the order p0, p1, ...; one attempt at drawing it."""
    return draw_rest_modes(stream(seed, "rest", scene_id, attempt), parts)


def _scenes(seed: int, assemblies: dict[str, Any]) -> dict[str, Any]:
    """One scene for each assembly. An assembly that ends with fewer kits than drawn draws its rest modes anew."""
    scenes = {}
    for assembly_id, row in assemblies.items():
        scene_id = scene_id_of(assembly_id)
        rest = list(rest_modes(seed, scene_id, row["kits"]))
        scenes[scene_id] = {"split": row["split"], "assembly": assembly_id, "rest": rest}
    return scenes


def split_ids(parts: dict[str, Any], split: str) -> list[str]:
    """Ids of the planned parts of a split, sorted."""
    return sorted(part_id for part_id, row in parts.items() if row["split"] == split)
