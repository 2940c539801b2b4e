"""A scene generated again from the plan alone, compared with the one on disk.

Another processor may give other last bits, so values are compared within tolerances: depths within 0.1 mm on 99.9 % of
pixels, poses within 10 micrometres. Pivots are rounded to 0.1 mm, so a last bit may shift them by a whole step: they
and the guesses, which rotate about them, are compared within two steps.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.mcap_io import ObservationFile, TruthFile
from kit1000.dataset.schema import Observation, SceneTruth
from kit1000.dataset.tables import Row, assembly_row, kit_row, part_row
from kit1000.errors import Kit1000Error
from kit1000.generation.assemblies import read_part_and_kit
from kit1000.generation.parts_and_kits import PartJob, make_part_and_kit
from kit1000.generation.plan import draw_assembly_of
from kit1000.generation.presets import Preset, preset_of
from kit1000.generation.scenes import make_scene
from kit1000.generation.shards import EXTRA_VIEWS, OBSERVATIONS, SPLITS_WITH_EXTRA_VIEWS, TRUTH
from kit1000.kits.assembly import build_assembly
from kit1000.mesh import Mesh
from kit1000.pictures.scene_preview import same_picture, with_previews
from kit1000.pose import Pose
from kit1000.values import Assembly, Kit, Part

DEPTH_TOLERANCE = 1e-4  # [m]
MATCHING_PIXELS = 0.999  # smallest share of the pixels that agree
POSE_TOLERANCE = 1e-5  # [m], and the same number for a quaternion's entries
TOLERANCES = {
    "pivot": 2e-4,
    "guess": 2e-4,
    "pixels": 10,
    "visible": 1e-3,
    "slot_visible": 1e-3,
}  # by key, where not POSE_TOLERANCE
SIZE_TOLERANCE = 1e-5  # [m] of a mesh's bounds


def scene_differences(geometry: Geometry, plan: dict[str, Any], scene_id: str) -> list[str]:
    """The differences between a scene on disk and the same scene generated from the plan, one line each."""
    preset, row = preset_of(plan["preset"], plan["config"]), plan["scenes"][scene_id]
    differences: list[str] = []
    try:
        stored = geometry.assembly(row["assembly"])
        pairs = {m.kit.id: _rebuild_part_and_kit(geometry, plan, preset, m.kit.id, differences) for m in stored.mounts}
        assembly = _rebuild_assembly(
            geometry, plan, preset, stored, [pairs[m.kit.id][1] for m in stored.mounts], differences
        )
        parts = {part.id: part for part, _ in pairs.values()}
        rebuilt = make_scene(
            preset, plan["seed"], row["split"], assembly, parts, row["split"] in SPLITS_WITH_EXTRA_VIEWS
        )
        shard = next(name for name, scene_ids in geometry.summary["shards"].items() if scene_id in scene_ids)
        path = geometry.root / shard.removesuffix(OBSERVATIONS)
        seen = ObservationFile(f"{path}{OBSERVATIONS}").observation(scene_id)
        truth = TruthFile(f"{path}{TRUTH}").truth(scene_id)
        differences += observation_differences(rebuilt.observation, seen)
        differences += truth_differences(rebuilt.truth, truth)
        differences += preview_differences(seen, truth, parts[assembly.id].mesh)
        if rebuilt.extra_views is not None:
            differences += observation_differences(
                rebuilt.extra_views, ObservationFile(f"{path}{EXTRA_VIEWS}").observation(scene_id)
            )
    except Kit1000Error as error:
        differences.append(f"cannot be generated again ({error})")
    return differences


def observation_differences(rebuilt: Observation, stored: Observation) -> list[str]:
    """The differences between two observations of a scene, one line each."""
    differences = []
    if set(rebuilt.views) != set(stored.views):
        return [f"views {sorted(stored.views)}, expected {sorted(rebuilt.views)}"]
    for key, view in rebuilt.views.items():
        other = stored.views[key]
        if view.camera != other.camera:
            differences.append(f"{key}: another camera")
        elif not _images_match(view.depth, other.depth, DEPTH_TOLERANCE):
            differences.append(f"{key}: depths differ")
        if not _poses_match(view.world_from_camera, other.world_from_camera):
            differences.append(f"{key}: another camera pose")
    if not _images_match(rebuilt.labels, stored.labels):
        differences.append("masks differ")
    return differences + _row_differences(
        "query", {row["id"]: row for row in rebuilt.queries}, {r["id"]: r for r in stored.queries}
    )


def truth_differences(rebuilt: SceneTruth, stored: SceneTruth) -> list[str]:
    """The differences between two ground truths of a scene, one line each; of the models only names are compared."""
    differences = [] if rebuilt.assembly_id == stored.assembly_id else [f"assembly {stored.assembly_id}"]
    if not _poses_match(rebuilt.world_from_assembly, stored.world_from_assembly):
        differences.append("another pose of the assembly")
    if rebuilt.crowded != stored.crowded:
        differences.append("crowded" if stored.crowded else "not crowded")
    if rebuilt.noise_px != stored.noise_px:
        differences.append("another noise of the images")
    differences += _row_differences("part", dict(enumerate(rebuilt.parts)), dict(enumerate(stored.parts)))
    differences += _row_differences("truth of", rebuilt.queries, stored.queries)
    if not _images_match(rebuilt.seg, stored.seg):
        differences.append("segmentation differs")
    if set(rebuilt.models) != set(stored.models):
        differences.append("other models")
    if not _poses_match(rebuilt.goals, stored.goals):
        differences.append("goals differ")
    return differences


def preview_differences(seen: Observation, truth: SceneTruth, mesh: Mesh) -> list[str]:
    """The previews that differ from those drawn again from what is stored; `mesh` is that of the target."""
    drawn = with_previews(seen, truth, mesh)
    names = ("preview differs", "preview of the goals differs")
    return [
        name
        for name, again, stored in zip(names, drawn, (seen, truth), strict=True)
        if not same_picture(again.preview, stored.preview)
    ]


def _rebuild_part_and_kit(
    geometry: Geometry, plan: dict[str, Any], preset: Preset, part_id: str, differences: list[str]
) -> tuple[Part, Kit]:
    """A part and its kit, generated again; as stored where the part is from a mesh file."""
    stored = geometry.part(part_id), geometry.kit(part_id)
    if "unit" in plan:
        return stored
    row = geometry.parts[part_id]
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        record = make_part_and_kit(
            PartJob(root, preset, plan["seed"], part_id, row["split"], redraws=tuple(row["redraws"]))
        )
        part, kit = read_part_and_kit(root, part_id)
    if record["redraws"] != row["redraws"]:
        differences.append(f"part {part_id}: more redraws than before")
    differences += _row_differences("part", {part_id: part_row(part)}, {part_id: part_row(stored[0])})
    differences += _row_differences("kit", {part_id: kit_row(kit)}, {part_id: kit_row(stored[1])})
    differences += _mesh_differences(f"part {part_id}", part.mesh, stored[0].mesh)
    differences += _mesh_differences(f"kit {part_id}", kit.mesh, stored[1].mesh)
    return part, kit


def _rebuild_assembly(
    geometry: Geometry, plan: dict[str, Any], preset: Preset, stored: Assembly, kits: list[Kit], differences: list[str]
) -> Assembly:
    """The assembly, generated again at the attempt that passed."""
    attempt = geometry.assemblies[stored.id]["attempt"]
    draw = draw_assembly_of(preset, plan["seed"], stored.id, len(kits), attempt)
    assembly = build_assembly(stored.id, kits, draw.placement)
    differences += _row_differences("assembly", {stored.id: assembly_row(assembly)}, {stored.id: assembly_row(stored)})
    differences += _mesh_differences(f"assembly {stored.id}", assembly.mesh, stored.mesh)
    return assembly


def _mesh_differences(what: str, rebuilt: Mesh, stored: Mesh) -> list[str]:
    apart = float(np.abs(rebuilt.bounds - stored.bounds).max())
    if apart > SIZE_TOLERANCE:
        return [f"{what}: bounds differ by {apart * 1e3:.3f} mm"]
    if abs(rebuilt.volume - stored.volume) > SIZE_TOLERANCE * rebuilt.area:
        return [f"{what}: volumes differ"]
    return []


def _row_differences(what: str, rebuilt: Any, stored: Any) -> list[str]:
    """The differences between two sets of rows by key."""
    if set(rebuilt) != set(stored):
        unmatched = sorted(map(str, set(rebuilt) ^ set(stored)))
        return [f"{what} {', '.join(unmatched[:3])}: only in one of the two"]
    return [f"{what} {key}: differs" for key in rebuilt if not rows_match(rebuilt[key], stored[key])]


def rows_match(a: Row, b: Row) -> bool:
    """Whether two rows are equal, numbers within their tolerances."""
    return set(a) == set(b) and all(_values_match(a[key], b[key], TOLERANCES.get(key, POSE_TOLERANCE)) for key in a)


def _values_match(a: Any, b: Any, tolerance: float) -> bool:
    """Whether two JSON values are equal, numbers within a tolerance."""
    if isinstance(a, dict) and isinstance(b, dict):
        return set(a) == set(b) and all(_values_match(a[key], b[key], tolerance) for key in a)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(_values_match(one, other, tolerance) for one, other in zip(a, b, strict=True))
    if isinstance(a, float | int) and isinstance(b, float | int):
        return abs(a - b) <= tolerance
    return a == b


def _images_match(a: np.ndarray | None, b: np.ndarray | None, tolerance: float = 0.0) -> bool:
    """Whether MATCHING_PIXELS of the pixels of two images (H, W) differ by no more than a tolerance."""
    if a is None or b is None:
        return a is b
    return a.shape == b.shape and float(np.mean(np.abs(a.astype(float) - b) <= tolerance)) >= MATCHING_PIXELS


def _poses_match(a: Pose | None, b: Pose | None) -> bool:
    if a is None or b is None:
        return a is b
    return a.xyz.shape == b.xyz.shape and float(np.abs(a.matrix() - b.matrix()).max()) <= POSE_TOLERANCE
