"""Verification of a dataset: every file against its hash, and a sample of scenes against the same scenes made again."""

from __future__ import annotations

import platform
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.json_rows import assembly_row
from kit1000.dataset.mcap_io import ObservationFile, TruthFile
from kit1000.dataset.mcap_io.content_hash import observation_hash, truth_hash
from kit1000.dataset.own_scenes import LABELS, is_labelled
from kit1000.dataset.reader import WITHHELD_FILE, WITHOUT_TRUTH
from kit1000.errors import InputError, Kit1000Error
from kit1000.files import read_json, sha256
from kit1000.generation.assemblies import read_part_and_kit
from kit1000.generation.dataset_summary import LIBRARIES, MADE_WITH, library_versions, summary_bytes
from kit1000.generation.parts_and_kits import PartJob, make_part_and_kit
from kit1000.generation.plan import CONTENT_VERSION, dataset_id, draw_assembly_of
from kit1000.generation.presets import preset_of
from kit1000.generation.scene_files import EXTRA_VIEWS, OBSERVATIONS, SPLITS_WITH_EXTRA_VIEWS, TRUTH
from kit1000.generation.scenes import make_scene
from kit1000.generation.withhold import secret_fault
from kit1000.kits.assembly import build_assembly
from kit1000.rng import stream
from kit1000.sim.world import PhysicsMissing, check_physics
from kit1000.values import Kit, Part

INDEX, PLAN = "dataset.json", "plan.json"
SAME_BYTES = ("x86_64", "AMD64")  # processors that give the same content


@dataclass(frozen=True)
class VerifyReport:
    """The results of `verify`."""

    files: int  # number of files whose hash was checked
    rebuilt: tuple[str, ...]  # ids of the scenes that were generated again
    faults: tuple[str, ...]  # one line for each fault; empty for an intact dataset
    notes: tuple[str, ...] = ()  # what could not be checked, and why


def verify(root: Path, sample: int = 0) -> VerifyReport:
    """Check all files of a dataset, and generate `sample` of its scenes again. Raises InputError for another folder."""
    geometry = Geometry(root)
    summary = geometry.summary
    own = PLAN not in summary.get("files", {}) and "withheld" not in summary
    notes = ["scenes of a camera cannot be generated again" if is_labelled(summary) else WITHOUT_TRUTH] if own else []
    index_fault = _index_fault(root, summary)
    if index_fault is not None:
        return VerifyReport(0, (), (index_fault,), (*notes, f"{INDEX} lists all other files: none was checked"))
    count, faults = len(summary["files"]), list(_file_faults(root, summary, own))
    reason = None if sample == 0 or own else _why_not_generated(root, faults)
    if sample == 0 or own or reason is not None:
        return VerifyReport(count, (), tuple(faults), tuple(notes if reason is None else [reason]))
    plan, scenes = read_json(root / PLAN), _sample_scenes(summary, sample)
    if "unit" in plan:
        notes.append("parts are from mesh files: stored parts are used")
    bar = tqdm(scenes, desc="generating scenes again", unit="", disable=None)
    differences = [f"{scene_id}: {what}" for scene_id in bar for what in scene_differences(geometry, plan, scene_id)]
    others = version_differences(summary)
    if differences and others:  # the files are intact, and another library may well make other triangles
        notes += [*differences, f"these are no faults: the dataset was made otherwise ({'; '.join(others)})"]
        differences = []
    return VerifyReport(count, tuple(scenes), (*faults, *differences), tuple(notes))


def version_differences(summary: Mapping[str, Any]) -> list[str]:
    """What is of another version here than where a dataset was made: "numpy 2.2.0, here 2.4.6"."""
    recorded, here = summary.get(MADE_WITH, {}), library_versions()
    pairs = [(name, recorded[name], here[name]) for name in LIBRARIES if name in recorded]
    pairs += [] if platform.machine() in SAME_BYTES else [("processor", "x86-64", platform.machine())]
    return [f"{name} {before}, here {now}" for name, before, now in pairs if not f"{now}.".startswith(f"{before}.")]


def scene_differences(geometry: Geometry, plan: dict[str, Any], scene_id: str) -> list[str]:
    """What of a scene on disk is not as the plan and the generator give it: ids of parts, and names of files."""
    try:
        return list(_scene_differences(geometry, plan, scene_id))
    except Kit1000Error as error:
        return [f"cannot be generated again ({error})"]


def _scene_differences(geometry: Geometry, plan: dict[str, Any], scene_id: str) -> Iterator[str]:
    preset, row = preset_of(plan["preset"], plan["config"]), plan["scenes"][scene_id]
    stored, split = geometry.assemblies[row["assembly"]], row["split"]
    pairs: dict[str, tuple[Part, Kit]] = {}
    for kit_id in (mount["kit_id"] for mount in stored["mounts"]):
        if "unit" in plan:
            pairs[kit_id] = geometry.part(kit_id), geometry.kit(kit_id)
            continue
        with tempfile.TemporaryDirectory() as scratch:
            redraws = tuple(geometry.parts[kit_id]["redraws"])
            record = make_part_and_kit(
                PartJob(Path(scratch), preset, plan["seed"], kit_id, geometry.parts[kit_id]["split"], redraws=redraws)
            )
            pairs[kit_id] = read_part_and_kit(Path(scratch), kit_id)
        rows = {**geometry.parts[kit_id], "redraws": list(redraws)}, geometry.kits[kit_id]
        if not (record["part"].items() <= rows[0].items() and record["kit"].items() <= rows[1].items()):
            yield f"part {kit_id}: another row"
        yield from (name for name, digest in record["files"].items() if geometry.summary["files"].get(name) != digest)
    _, placement = draw_assembly_of(preset, plan["seed"], row["assembly"], len(pairs), stored["attempt"])
    assembly = build_assembly(row["assembly"], [kit for _, kit in pairs.values()], placement)
    if not assembly_row(assembly).items() <= stored.items():
        yield f"assembly {assembly.id}: another row"
    parts = {part.id: part for part, _ in pairs.values()}
    scene = make_scene(preset, plan["seed"], split, assembly, parts, split in SPLITS_WITH_EXTRA_VIEWS)
    shard = next(name for name, scene_ids in geometry.summary["shards"].items() if scene_id in scene_ids)
    path = geometry.root / shard.removesuffix(OBSERVATIONS)
    hashes = {OBSERVATIONS: observation_hash(scene.observation), TRUTH: truth_hash(scene.truth)}
    if scene.extra_views is not None:
        hashes[EXTRA_VIEWS] = observation_hash(scene.extra_views)
    for ending, content_hash in hashes.items():
        file = (TruthFile if ending == TRUTH else ObservationFile)(f"{path}{ending}")
        if file.recomputed_hash(scene_id) != content_hash:
            yield f"{shard.removesuffix(OBSERVATIONS)}{ending}: another content"


def _why_not_generated(root: Path, faults: list[str]) -> str | None:
    """Why no scene can be generated again; None when it can."""
    if not (root / PLAN).is_file():
        return "the plan is withheld: scenes can be generated again only from the full dataset"
    if faults:
        return "no scene generated again: files are damaged"
    version = read_json(root / PLAN)["data_version"]
    if version != CONTENT_VERSION:
        return f"no scene generated again: content of version {version}, this kit1000 makes {CONTENT_VERSION}"
    try:
        check_physics()
    except PhysicsMissing as missing:
        return f"no scene generated again: {missing}"
    return None


def _index_fault(root: Path, summary: dict[str, Any]) -> str | None:
    """What is wrong with `dataset.json` itself; None when its checksum holds."""
    if "checksum" not in summary:
        return f"{INDEX}: has no checksum: nothing can be compared with what was written"
    try:
        intact = (root / INDEX).read_bytes() == summary_bytes(summary)
    except (ValueError, AttributeError):  # an infinite number, as a changed digit can make, or no table of versions
        intact = False
    return None if intact else f"{INDEX}: changed since it was written"


def _file_faults(root: Path, summary: dict[str, Any], own: bool) -> Iterator[str]:
    """Files that are changed, missing, or not listed. Hidden files are ignored, and labels, which a person changes."""
    faulty = False
    for name, digest in tqdm(sorted(summary["files"].items()), desc="files", unit="", disable=None):
        actual = sha256(root / name)
        if actual != digest:
            faulty = True
            yield f"{name}: {'missing or unreadable' if actual is None else 'changed since it was written'}"
    ignored = (LABELS,) if own else ()
    present = {path.relative_to(root) for path in root.rglob("*") if path.is_file()}
    visible = {path.as_posix() for path in present if not any(step.startswith(".") for step in path.parts)}
    full = PLAN in summary["files"]  # not the public part of a withheld dataset
    listed = {INDEX, *summary["files"], *([WITHHELD_FILE] if full else [])}
    for name in sorted(visible - listed):
        if name.partition("/")[0] not in ignored:
            faulty = True
            yield f"{name}: not a file of this dataset"
    if full and not faulty and dataset_id(read_json(root / PLAN)) != summary["dataset_id"]:
        yield f"{PLAN}: of another dataset"
    if full and (root / WITHHELD_FILE).is_file():
        try:
            fault = secret_fault(summary, read_json(root / WITHHELD_FILE))
        except InputError as error:
            yield str(error)
        else:
            yield from [] if fault is None else [f"{WITHHELD_FILE}: {fault}"]


def _sample_scenes(summary: dict[str, Any], sample: int) -> list[str]:
    """Random scene ids from all splits, always the same for a dataset."""
    scenes = sorted(scene_id for scene_ids in summary["shards"].values() for scene_id in scene_ids)
    chosen = stream(0, "verify", summary["dataset_id"]).permutation(len(scenes))[:sample]
    return sorted(scenes[i] for i in chosen)
