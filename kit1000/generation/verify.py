"""Verification of a dataset: every file against its hash, and a sample of scenes generated again from the plan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.own_scenes import LABELS, is_labelled
from kit1000.dataset.reader import WITHHELD_FILE, WITHOUT_TRUTH
from kit1000.errors import InputError
from kit1000.files import read_json, sha256
from kit1000.generation.dataset_summary import summary_bytes
from kit1000.generation.library_versions import library_versions, version_differences
from kit1000.generation.plan import DATA_VERSION, dataset_id
from kit1000.generation.rebuild import scene_differences
from kit1000.generation.withhold import secret_fault
from kit1000.rng import stream
from kit1000.sim.world import PhysicsMissing, check_physics

INDEX, PLAN = "dataset.json", "plan.json"

NOT_GENERATED = "scenes of a camera: there is nothing to generate again"


@dataclass(frozen=True)
class VerifyReport:
    """The results of `verify`."""

    files: int
    """Number of files whose hash was checked."""
    rebuilt: tuple[str, ...]
    """Ids of the scenes that were generated again."""
    faults: tuple[str, ...]
    """One line for each fault; empty for an intact dataset."""
    notes: tuple[str, ...] = ()
    """What could not be checked, and why."""


def verify(root: Path, sample: int = 0) -> VerifyReport:
    """Check all files of a dataset, and generate `sample` of its scenes again. Raises InputError for another folder."""
    geometry = Geometry(root)
    summary = geometry.summary
    own = _is_of_camera(summary)
    own_notes = ((NOT_GENERATED if is_labelled(summary) else WITHOUT_TRUTH),) if own else ()
    if "checksum" not in summary:
        fault = f"{INDEX}: has no checksum: nothing can be compared with what was written"
        return VerifyReport(0, (), (fault,), own_notes)
    if not _checksum_holds(root, summary):
        return VerifyReport(
            0, (), (f"{INDEX}: changed since it was written",), ("it lists all others: none was checked",)
        )
    count, faults = len(summary["files"]), _file_faults(root, summary)
    if sample == 0 or own:
        return VerifyReport(count, (), tuple(faults), own_notes)
    reason = _why_not_rebuilt(root, summary, faults)
    if reason is not None:
        return VerifyReport(count, (), tuple(faults), (reason,))
    plan, scenes = read_json(root / PLAN), _sample_scenes(summary, sample)
    notes = ["parts are from mesh files: stored parts are used"] if "unit" in plan else []
    differences = [
        f"{scene_id}: {difference}"
        for scene_id in tqdm(scenes, desc="generating scenes again", unit="", disable=None)
        for difference in scene_differences(geometry, plan, scene_id)
    ]
    others = version_differences(summary)
    if differences and others:  # files are intact, and another library may well make other triangles
        notes += [*differences, f"no faults, as it was made with other libraries: {'; '.join(others)}"]
        differences = []
    elif differences and others is None:
        here = f"manifold3d {library_versions()['manifold3d']}"
        notes.append(f"it does not say with which libraries it was made; another version than {here} may explain this")
    return VerifyReport(count, tuple(scenes), (*faults, *differences), tuple(notes))


def _why_not_rebuilt(root: Path, summary: dict[str, Any], faults: list[str]) -> str | None:
    """Why no scene can be generated again; None when it can."""
    if not (root / PLAN).is_file():
        return "the plan is withheld: scenes can be generated again only from the full dataset"
    if faults:
        return "no scene generated again: files are damaged"
    if summary["data_version"] != DATA_VERSION:
        return f"no scene generated again: data version {summary['data_version']}, this kit1000 makes {DATA_VERSION}"
    try:
        check_physics()
    except PhysicsMissing as missing:
        return f"no scene generated again: {missing}"
    return None


def _checksum_holds(root: Path, summary: dict[str, Any]) -> bool:
    try:
        return (root / INDEX).read_bytes() == summary_bytes(summary)
    except (ValueError, AttributeError):  # an infinite number, as a changed digit can make, or no table of versions
        return False


def _is_of_camera(summary: dict[str, Any]) -> bool:
    return PLAN not in summary.get("files", {}) and "withheld" not in summary


def _file_faults(root: Path, summary: dict[str, Any]) -> list[str]:
    """Files that are changed, missing, or not listed; hidden files are ignored."""
    faults = []
    for name, digest in tqdm(sorted(summary["files"].items()), desc="files", unit="", disable=None):
        actual = sha256(root / name)
        if actual != digest:
            faults.append(f"{name}: {'missing or unreadable' if actual is None else 'changed since it was written'}")
    full = PLAN in summary["files"]  # not the public part of a withheld dataset
    listed = {INDEX, *summary["files"], *([WITHHELD_FILE] if full else [])}
    present = (path.relative_to(root) for path in root.rglob("*") if path.is_file())
    others = () if not _is_of_camera(summary) else (LABELS,)
    not_hidden = (
        path.as_posix()
        for path in present
        if path.parts[0] not in others and not any(step.startswith(".") for step in path.parts)
    )
    faults += [f"{name}: not a file of this dataset" for name in sorted(not_hidden) if name not in listed]
    if full and not faults and dataset_id(read_json(root / PLAN)) != summary["dataset_id"]:
        faults.append(f"{PLAN}: of another dataset")
    if full and (root / WITHHELD_FILE).is_file():
        faults += _secret_faults(root, summary)
    return faults


def _secret_faults(root: Path, summary: dict[str, Any]) -> list[str]:
    try:
        fault = secret_fault(summary, read_json(root / WITHHELD_FILE))
    except InputError as error:
        return [str(error)]
    return [] if fault is None else [f"{WITHHELD_FILE}: {fault}"]


def _sample_scenes(summary: dict[str, Any], sample: int) -> list[str]:
    """Random scene ids from all splits, always the same for a dataset."""
    scenes = sorted(scene_id for scene_ids in summary["shards"].values() for scene_id in scene_ids)
    chosen = stream(0, "verify", summary["dataset_id"]).permutation(len(scenes))[:sample]
    return sorted(scenes[i] for i in chosen)
