"""Generation of a dataset from its plan: parts and kits, then assemblies, then scenes, and `dataset.json` last.

Every job writes a record, so an interrupted run continues where it stopped and ends with the same bytes. Jobs run in
any order on any number of workers; decisions that depend on order (near-duplicates) are made in this process.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from kit1000.errors import InputError
from kit1000.files import check_writable, clear_partial, json_bytes, locked, read_json, write_bytes, write_json
from kit1000.generation.assemblies import AssemblyJob, make_assembly
from kit1000.generation.dataset_summary import JobRecords, description_files, make_summary, summary_bytes, tables
from kit1000.generation.parts_and_kits import BUILD_FOLDER, PartJob, Record, make_part_and_kit, read_intact
from kit1000.generation.plan import Sources, candidate_order, make_plan, plan_head, split_ids
from kit1000.generation.presets import Preset
from kit1000.generation.scene_files import make_shard, shard_jobs
from kit1000.generation.tried_files import deal_files, try_file, try_files
from kit1000.parallel import ParallelMap, local_engine
from kit1000.parts.files.read import refusal_counts
from kit1000.parts.near_duplicates import near_duplicate_of
from kit1000.queries.tracks import SPLITS
from kit1000.sim.world import check_physics

FILES, PARTS, ASSEMBLIES, SCENES = "mesh files", "parts and kits", "assemblies", "scenes"
SECONDS = {FILES: 1.1, PARTS: 0.6, ASSEMBLIES: 0.33, SCENES: 0.25}
"""CPU time of one file, part, assembly or scene, roughly [s]: the weights of the progress bar."""
SCENE_COST = {"test": 2.0}
"""Cost of a scene of a split with more images, in the cost of a scene of the other splits."""
BAR = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
SMOOTHING = 0.01  # of the speed from which the bar expects the end: the mean over about a hundred jobs

Run = Callable[..., dict[str, Record]]
"""Runs the jobs of a stage: `_run_jobs` with its bar and its engine."""


def generate(
    preset: Preset,
    root: Path,
    seed: int | None = None,
    workers: int | None = None,
    sources: Sources | None = None,
    engine: AbstractContextManager[ParallelMap] | None = None,
) -> dict[str, Any]:
    """Generate a dataset in a folder, or complete an interrupted one; returns the contents of its dataset.json.

    Args:
        preset: the configuration.
        root: the folder.
        seed: root of all random draws; that of the preset when None.
        workers: number of local processes; one per core when None. Ignored when an engine is given.
        sources: mesh files to use in place of procedural parts.
        engine: runs the jobs; local processes when None.

    Raises:
        InputError: the folder contains something else or cannot be written, no mesh file can be a part, or there is no
            physics engine.
    """
    head = plan_head(preset, preset.seed if seed is None else seed, sources)
    check_writable(root)
    _check_folder(root, head)  # before the lock, which leaves a file
    with locked(root):
        _check_folder(root, head)
        clear_partial(root)
        summary = _finished_summary(root)
        if summary is not None:
            return summary
        check_physics()  # now, not after all parts are made
        write_json(root / "plan.json", head)
        refused, untried = {}, None
        expected = _expected_seconds(preset, None if sources is None else len(sources.files))
        bar_of = partial(tqdm, total=expected, bar_format=BAR, disable=None, smoothing=SMOOTHING)
        with engine or local_engine(workers) as parallel_map, bar_of() as bar:
            run = partial(_run_jobs, bar, parallel_map)
            if sources is None:
                plan = make_plan(preset, head["seed"])
                parts = _make_parts_and_kits(root, preset, plan, run)
            else:
                tried = try_files(root, preset, head["seed"], sources, partial(run, FILES, try_file))
                if not tried.accepted:
                    raise InputError(_no_usable_file(root, tried.refused))
                plan = make_plan(preset, head["seed"], list(tried.accepted)) | head
                parts, refused, untried = deal_files(root, plan, tried.accepted), tried.refused, tried.untried
            assemblies = _make_assemblies(root, preset, plan, run)
            scenes = _make_shards(root, preset, plan, assemblies, run)
        return write_summary(root, plan, JobRecords(parts, assemblies, scenes, refused, untried))


def _check_folder(root: Path, head: dict[str, Any]) -> None:
    """Raise InputError if a folder contains anything but a dataset of this plan, finished or not."""
    if not root.is_dir():
        return
    path = root / "plan.json"
    if path.is_file():
        begun = read_json(path)
        other = _difference(begun, head)
        if other is not None:
            raise InputError(f"{root} contains another dataset ({other}): choose another --out, or delete that folder")
    elif any(not entry.name.startswith(".") for entry in root.iterdir()):
        raise InputError(f"{root} is not empty and contains no dataset: choose another --out")


def _difference(begun: Any, head: dict[str, Any]) -> str | None:
    """The first difference of a begun plan from the head of this one, for a message; None if there is none."""
    if not isinstance(begun, dict):
        return "its plan.json is no plan"
    for key in ("format", "data_version", "preset", "seed", "unit"):
        if begun.get(key) != head.get(key):
            return f"{key.replace('_', ' ')} {begun.get(key)}, expected {head.get(key)}"
    same = {key: begun.get(key) for key in {*head, "sources"} & {*begun}}
    return None if json_bytes(same) == json_bytes(head) else "with other parts"


def _finished_summary(root: Path) -> dict[str, Any] | None:
    """The summary of a finished dataset; None when there is none, or when files are missing or changed."""
    path = root / "dataset.json"
    if not path.is_file():
        return None
    summary = read_intact(root, path)
    if summary is not None:
        shutil.rmtree(root / BUILD_FOLDER, ignore_errors=True)
        print(f"{root} is complete: nothing to do", file=sys.stderr)
        return summary
    print(f"{root}: files are missing or changed, generating them again", file=sys.stderr)
    path.unlink()
    return None


def _make_parts_and_kits(root: Path, preset: Preset, plan: dict[str, Any], run: Run) -> dict[str, Record]:
    """The record of every procedural part and its kit, by id; near-duplicates are redrawn until none is left."""
    jobs = {
        part_id: PartJob(root, preset, plan["seed"], part_id, row["split"]) for part_id, row in plan["parts"].items()
    }
    records = run(PARTS, make_part_and_kit, list(jobs.values()))
    measures = np.zeros((0, 5))
    for part_id, job in jobs.items():
        while near_duplicate_of(np.array(records[part_id]["measures"]), measures) is not None:
            redraws = (*records[part_id]["redraws"], "near-duplicate")
            records[part_id] = make_part_and_kit(replace(job, redraws=redraws))
        measures = np.concatenate([measures, [records[part_id]["measures"]]])
    return records


def _no_usable_file(root: Path, refused: dict[str, str]) -> str:
    """The message that no mesh file became a part. Deletes the plan, so that the folder can be used again."""
    shutil.rmtree(root / BUILD_FOLDER, ignore_errors=True)
    (root / "plan.json").unlink(missing_ok=True)
    reasons = [f"{name}: {reason}" for name, reason in refused.items()]
    more = f"; and {len(reasons) - 3} more" if len(reasons) > 3 else ""
    counts = refusal_counts(refused.values())
    return f"none of {len(reasons)} mesh files can be a part: {counts} ({'; '.join(reasons[:3])}{more})"


def _make_assemblies(root: Path, preset: Preset, plan: dict[str, Any], run: Run) -> dict[str, Record]:
    """The record of every assembly, by id."""
    ids = {split: split_ids(plan["parts"], split) for split in SPLITS}
    jobs = [
        AssemblyJob(
            root,
            preset,
            plan["seed"],
            assembly_id,
            row["split"],
            row["target"],
            row["kits"],
            tuple(candidate_order(plan["seed"], row["target"], ids[row["split"]])),
        )
        for assembly_id, row in plan["assemblies"].items()
    ]
    return run(ASSEMBLIES, make_assembly, jobs)


def _make_shards(
    root: Path, preset: Preset, plan: dict[str, Any], assemblies: dict[str, Record], run: Run
) -> dict[str, Record]:
    """The record of every shard of scenes, by id; the dearest are made first, so that no core idles at the end."""
    jobs = [
        job
        for split in SPLITS
        for job in shard_jobs(root, preset, plan["seed"], split, split_ids(plan["assemblies"], split), set(assemblies))
    ]
    costs = {job.id: SCENE_COST.get(job.split, 1.0) * len(job.assemblies) for job in jobs}
    return run(SCENES, make_shard, sorted(jobs, key=lambda job: -costs[job.id]), costs)


def _expected_seconds(preset: Preset, files: int | None) -> float:
    """CPU time of all jobs, roughly [s]; files: number of mesh files, None for procedural parts."""
    counts = {split: preset.count(split) for split in SPLITS}
    total = sum(counts.values())
    parts = SECONDS[PARTS] * total if files is None else SECONDS[FILES] * min(files, total)
    scenes = sum(SCENE_COST.get(split, 1.0) * count for split, count in counts.items())
    return parts + SECONDS[ASSEMBLIES] * total + SECONDS[SCENES] * scenes


def _run_jobs(
    bar: tqdm[Any],
    parallel_map: ParallelMap,
    what: str,
    function: Callable[[Any], Record],
    jobs: list[Any],
    costs: Mapping[str, float] | None = None,
) -> dict[str, Record]:
    """Run the jobs of a stage and return their records by id.

    bar: progress of all stages, in CPU seconds.
    costs: by id of a job, in the cost of one part, assembly or scene; 1 if None.
    """
    records: dict[str, Record] = {}
    bar.set_description_str(what)
    for record in parallel_map(function, jobs):
        _check_files_present(jobs[0].root, record)
        records[record["id"]] = record
        bar.update(SECONDS[what] * (1.0 if costs is None else costs[record["id"]]))
    return records


def _check_files_present(root: Path, record: Record) -> None:
    """Raise InputError when files of a job are not in the folder: a cluster node may have written to its own disk."""
    for name in record["files"]:
        if not (root / name).is_file():
            raise InputError(
                f"{name} was written on another machine and is not in {root}: all nodes must share that folder"
            )


def write_summary(root: Path, plan: dict[str, Any], records: JobRecords) -> dict[str, Any]:
    """Write the tables, the plan, the data card, the Croissant file and last `dataset.json`; returns its contents."""
    written = {f"{name}.json": write_json(root / f"{name}.json", rows) for name, rows in tables(plan, records).items()}
    _remove_unlisted(root, records.files)
    written["plan.json"] = write_json(root / "plan.json", plan)
    summary = make_summary(plan, records, written)
    for name, data in description_files(summary).items():
        summary["files"][name] = write_bytes(root / name, data)
    write_bytes(root / "dataset.json", summary_bytes(summary))
    shutil.rmtree(root / BUILD_FOLDER, ignore_errors=True)
    return read_json(root / "dataset.json")


def _remove_unlisted(root: Path, files: dict[str, str]) -> None:
    """Delete meshes and recordings that no record lists, such as those of a part that was refused later."""
    for kind in ("parts", "kits", "assemblies", *SPLITS):
        for pattern in ("*.glb", "*.mcap"):
            for path in (root / kind).glob(pattern):
                if f"{kind}/{path.name}" not in files:
                    path.unlink()
