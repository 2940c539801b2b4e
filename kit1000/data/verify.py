"""Is a dataset what it says it is? Every file against its hash, and a sample of scenes built again from the plan.

Another processor may differ in last bits, so what is built again is compared within bounds: depths within 0.1 mm on
99.9 % of pixels, poses within 10 micrometres.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from kit1000.data.files import read_json, sha256
from kit1000.data.geometry import Geometry
from kit1000.data.mcap_io import ObservationFile, TruthFile
from kit1000.data.meshes import read_glb
from kit1000.data.pairs import PairJob, make_pair
from kit1000.data.plan import dataset_id, draw_assembly_of
from kit1000.data.presets import Preset, preset_of
from kit1000.data.scenes import make_scene
from kit1000.data.schema import Observation, SceneTruth
from kit1000.data.shards import SPLITS_WITH_FURTHER
from kit1000.data.summary import sealed
from kit1000.data.tables import Row, kit_of, part_of
from kit1000.errors import Kit1000Error
from kit1000.kits.assembly import build_assembly
from kit1000.mesh import Mesh
from kit1000.rng import stream
from kit1000.values import Assembly, Kit, Part

DEPTH_TOLERANCE = 1e-4  # [m]
PIXELS_ALIKE = 0.999
POSE_TOLERANCE = 1e-5  # [m], and as much in a quaternion's entries
SIZE_TOLERANCE = 1e-5  # [m] of a mesh's extents


@dataclass(frozen=True)
class Findings:
    """What `verify` found."""

    files: int
    """Files whose hash was checked."""
    rebuilt: tuple[str, ...]
    """Scenes that were built again."""
    faults: tuple[str, ...]
    """One line each; none when all is well."""
    notes: tuple[str, ...] = ()
    """What could not be checked, and why."""


def verify(root: Path, sample: int = 0) -> Findings:
    """Check all files of a dataset and build `sample` of its scenes again. Raises InputError when it is no dataset."""
    geometry = Geometry(root)
    faults = _files(root, geometry.summary)
    if sample == 0:
        return Findings(len(geometry.summary["files"]), (), tuple(faults))
    if not (root / "plan.json").is_file():
        note = "the plan is withheld: scenes can be built again from the whole dataset alone"
        return Findings(len(geometry.summary["files"]), (), tuple(faults), (note,))
    if faults:
        return Findings(len(geometry.summary["files"]), (), tuple(faults), ("nothing built again: files are damaged",))
    plan = read_json(root / "plan.json")
    scenes = _sampled(geometry.summary, sample)
    for scene_id in tqdm(scenes, desc="building scenes again", unit="", disable=None):
        faults += [f"{scene_id}: {said}" for said in _rebuilt(geometry, plan, scene_id)]
    notes = ("parts come from files: they are taken as stored",) if "unit" in plan else ()
    return Findings(len(geometry.summary["files"]), tuple(scenes), tuple(faults), notes)


def _files(root: Path, summary: dict[str, Any]) -> list[str]:
    faults = []
    if (root / "dataset.json").read_bytes() != sealed(summary):
        faults.append("dataset.json: changed since it was written (its checksum does not hold)")
    for name, digest in tqdm(sorted(summary["files"].items()), desc="files", unit="", disable=None):
        found = sha256(root / name)
        if found != digest:
            faults.append(f"{name}: {'missing or unreadable' if found is None else 'changed since it was written'}")
    listed = {"dataset.json", "withheld.json", *summary["files"]}
    present = (path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file())
    strays = sorted(name for name in present if name not in listed and not Path(name).name.startswith("."))
    faults += [f"{name}: not a file of this dataset" for name in strays]
    plan = root / "plan.json"
    if "plan.json" in summary["files"] and not faults and dataset_id(read_json(plan)) != summary["dataset_id"]:
        faults.append("plan.json: of another dataset")
    return faults


def _sampled(summary: dict[str, Any], sample: int) -> list[str]:
    """Scene ids, the same for the same dataset, spread over all splits."""
    scenes = sorted(scene_id for held in summary["shards"].values() for scene_id in held)
    chosen = stream(0, "verify", summary["dataset_id"]).permutation(len(scenes))[:sample]
    return sorted(scenes[i] for i in chosen)


def _rebuilt(geometry: Geometry, plan: dict[str, Any], scene_id: str) -> list[str]:
    """What differs between a scene on disk and the same scene built from the plan alone."""
    preset, row = preset_of(plan["preset"], plan["config"]), plan["scenes"][scene_id]
    stored = geometry.assembly(row["assembly"])
    faults: list[str] = []
    try:
        pairs = {m.kit.id: _pair(geometry, plan, preset, m.kit.id, faults) for m in stored.mounts}
        assembly = _assembly(geometry, plan, preset, stored, [pairs[m.kit.id][1] for m in stored.mounts])
        faults += _mesh_faults(f"assembly {assembly.id}", assembly.mesh, stored.mesh)
        parts = {part.id: part for part, _ in pairs.values()}
        made = make_scene(preset, plan["seed"], row["split"], assembly, parts, row["split"] in SPLITS_WITH_FURTHER)
    except Kit1000Error as error:
        return [*faults, f"cannot be built again ({error})"]
    shard = next(name for name, held in geometry.summary["shards"].items() if scene_id in held)
    path = geometry.root / shard
    faults += _observation_faults(made.observation, ObservationFile(path).observation(scene_id))
    faults += _truth_faults(made.truth, TruthFile(path.with_suffix(".truth.mcap")).truth(scene_id))
    if made.further is not None:
        further = ObservationFile(path.with_suffix(".three.mcap")).observation(scene_id)
        faults += _observation_faults(made.further, further)
    return faults


def _pair(
    geometry: Geometry, plan: dict[str, Any], preset: Preset, part_id: str, faults: list[str]
) -> tuple[Part, Kit]:
    """A part and its kit drawn anew; as stored where the part came from a file."""
    stored = geometry.part(part_id), geometry.kit(part_id)
    if "unit" in plan:
        return stored
    row = geometry.parts[part_id]
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        record = make_pair(PairJob(root, preset, plan["seed"], part_id, row["split"], redraws=tuple(row["redraws"])))
        part = part_of(part_id, record["part"], read_glb(root / f"parts/{part_id}.glb")[part_id])
        kit = kit_of(part_id, record["kit"], read_glb(root / f"kits/{part_id}.glb")[part_id])
    if record["redraws"] != row["redraws"]:
        faults.append(f"part {part_id}: drawn again more often than before")
    faults += _mesh_faults(f"part {part_id}", part.mesh, stored[0].mesh)
    faults += _mesh_faults(f"kit {part_id}", kit.mesh, stored[1].mesh)
    return part, kit


def _assembly(geometry: Geometry, plan: dict[str, Any], preset: Preset, stored: Assembly, kits: list[Kit]) -> Assembly:
    attempt = geometry.assemblies[stored.id]["attempt"]
    draw = draw_assembly_of(preset, plan["seed"], stored.id, len(kits), attempt)
    return build_assembly(stored.id, kits, draw.placing)


def _mesh_faults(what: str, made: Mesh, stored: Mesh) -> list[str]:
    apart = float(np.abs(made.bounds - stored.bounds).max())
    if apart > SIZE_TOLERANCE:
        return [f"{what}: bounds differ by {apart * 1e3:.3f} mm"]
    if abs(made.volume - stored.volume) > SIZE_TOLERANCE * made.area:
        return [f"{what}: volumes differ"]
    return []


def _observation_faults(made: Observation, stored: Observation) -> list[str]:
    faults = []
    if set(made.views) != set(stored.views):
        return [f"views {sorted(stored.views)}, expected {sorted(made.views)}"]
    for key, view in made.views.items():
        other = stored.views[key]
        alike = float(np.mean(np.abs(view.depth - other.depth) <= DEPTH_TOLERANCE))
        if alike < PIXELS_ALIKE:
            faults.append(f"{key}: depth agrees on {100 * alike:.2f} % of pixels, expected 99.9 %")
        if _apart(view.world_from_camera, other.world_from_camera):
            faults.append(f"{key}: another camera pose")
    if made.labels is not None and stored.labels is not None and np.mean(made.labels == stored.labels) < PIXELS_ALIKE:
        faults.append("masks differ")
    return faults + _row_faults("query", {row["id"]: row for row in made.queries}, {r["id"]: r for r in stored.queries})


def _truth_faults(made: SceneTruth, stored: SceneTruth) -> list[str]:
    faults = ["the assembly stands elsewhere"] if _apart(made.world_from_assembly, stored.world_from_assembly) else []
    faults += _row_faults("part", dict(enumerate(made.parts)), dict(enumerate(stored.parts)))
    faults += _row_faults("truth of", dict(made.queries), dict(stored.queries))
    if np.mean(made.seg == stored.seg) < PIXELS_ALIKE:
        faults.append("segmentation differs")
    return faults


def _row_faults(what: str, made: dict[Any, Row], stored: dict[Any, Row]) -> list[str]:
    if set(made) != set(stored):
        odd = sorted(map(str, set(made) ^ set(stored)))
        return [f"{what} {', '.join(odd[:3])}: in one and not in the other"]
    return [f"{what} {key}: differs" for key in made if not _alike(made[key], stored[key])]


def _alike(a: Any, b: Any) -> bool:
    """Equal JSON values, numbers within the tolerance of poses; counts of pixels and shares a little wider."""
    if isinstance(a, dict) and isinstance(b, dict):
        return set(a) == set(b) and all(_alike(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(_alike, a, b))
    if isinstance(a, float | int) and isinstance(b, float | int):
        return abs(a - b) <= max(POSE_TOLERANCE, (1 - PIXELS_ALIKE) * abs(a))
    return a == b


def _apart(a: Any, b: Any) -> bool:
    return bool(np.abs(a.matrix() - b.matrix()).max() > POSE_TOLERANCE)
