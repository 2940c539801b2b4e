"""The job that makes a shard: up to 25 scenes of a split, recorded in MCAP, observations and ground truth apart.

The shard is the unit of work, of download and of resumption. Its record lists its scenes, the reasons of the redraws,
and the statistics for the data card.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kit1000.dataset.mcap_io import ObservationWriter, TruthWriter
from kit1000.dataset.scene_data import SCENES_PER_SHARD
from kit1000.errors import Redraw
from kit1000.generation.assemblies import read_assembly
from kit1000.generation.parts_and_kits import Record, finished_record, save_record
from kit1000.generation.plan import scene_id_of
from kit1000.generation.presets import Preset
from kit1000.generation.scenes import make_scene
from kit1000.generation.statistics import add_up, scene_statistics

OBSERVATIONS, TRUTH, EXTRA_VIEWS = ".mcap", ".truth.mcap", ".three.mcap"  # file name endings
SPLITS_WITH_EXTRA_VIEWS = ("test",)  # splits that store the camera set `three`


@dataclass(frozen=True)
class ShardJob:
    """The arguments of a job: scenes to make and record together."""

    root: Path
    preset: Preset
    seed: int
    split: str
    number: int
    assemblies: tuple[str, ...]  # ids of the assemblies of its scenes, in order

    @property
    def id(self) -> str:
        """The path in the dataset without the ending, such as test/0000."""
        return f"{self.split}/{self.number:04d}"

    def __str__(self) -> str:
        return f"shard {self.id}"


def shard_jobs(
    root: Path, preset: Preset, seed: int, split: str, planned: list[str], usable: set[str]
) -> list[ShardJob]:
    """The shards of a split. The plan alone decides which scenes share a shard; unusable assemblies are left out.

    planned: ids of all planned assemblies of the split, in order. usable: ids of those that were made.
    """
    jobs = []
    for first in range(0, len(planned), SCENES_PER_SHARD):
        chosen = tuple(i for i in planned[first : first + SCENES_PER_SHARD] if i in usable)
        if chosen:
            jobs.append(ShardJob(root, preset, seed, split, first // SCENES_PER_SHARD, chosen))
    return jobs


def make_shard(job: ShardJob) -> Record:
    """Do the job unless its record exists; returns the record."""
    done = finished_record(job.root, "shards", job.id)
    if done is not None:
        return done
    redraws: Counter[str] = Counter()
    refused: dict[str, str] = {}
    per_scene: list[dict[str, Any]] = []
    scene_ids: list[str] = []
    with ExitStack() as stack:
        files = {ending: stack.enter_context(kind(job.root / f"{job.id}{ending}")) for ending, kind in _writers(job)}
        for assembly_id in job.assemblies:
            assembly, parts = read_assembly(job.root, assembly_id)
            try:
                scene = make_scene(job.preset, job.seed, job.split, assembly, parts, EXTRA_VIEWS in files)
            except Redraw as refusal:  # no layout shows its target: this scene is missing, the others are made
                refused[scene_id_of(assembly_id)] = refusal.reason
                continue
            redraws.update(scene.redraws)
            for ending, value in (
                (OBSERVATIONS, scene.observation),
                (TRUTH, scene.truth),
                (EXTRA_VIEWS, scene.extra_views),
            ):
                if value is not None:
                    files[ending].add(value)
            per_scene.append(scene_statistics([scene.truth]))
            scene_ids.append(scene.truth.scene_id)
    return save_record(
        job.root,
        "shards",
        job.id,
        {
            "id": job.id,
            "split": job.split,
            "files": {f"{job.id}{ending}": file.sha256 for ending, file in files.items() if file.sha256 is not None},
            "scenes": scene_ids,
            "redraws": dict(redraws),
            "refused": refused,
            "statistics": add_up(per_scene),
        },
    )


def _writers(job: ShardJob) -> list[tuple[str, Callable[[Path], Any]]]:
    """The endings of a shard's files, and the class that writes each."""
    extra_views = [(EXTRA_VIEWS, ObservationWriter)] if job.split in SPLITS_WITH_EXTRA_VIEWS else []
    return [(OBSERVATIONS, ObservationWriter), (TRUTH, TruthWriter), *extra_views]
