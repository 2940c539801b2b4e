"""A shard: some scenes of a split made one after another and recorded in MCAP, observations and truth apart.

The shard is the unit of work, of download and of resumption; its record says which scenes it holds, what was drawn
again and why, and the figures of the data card.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kit1000.dataset.mcap_io import ObservationWriter, TruthWriter
from kit1000.dataset.schema import SCENES_PER_SHARD
from kit1000.errors import Redraw
from kit1000.generation.assemblies import read_assembly
from kit1000.generation.card_statistics import add_up, scene_statistics
from kit1000.generation.parts_and_kits import Record, finished_record, save_record
from kit1000.generation.plan import scene_id_of
from kit1000.generation.presets import Preset
from kit1000.generation.scenes import make_scene

OBSERVATIONS, TRUTH, EXTRA_VIEWS = ".mcap", ".truth.mcap", ".three.mcap"  # endings of the files of a shard
SPLITS_WITH_EXTRA_VIEWS = ("test",)  # splits that store the camera set `three`


@dataclass(frozen=True)
class ShardJob:
    """Scenes to be made and recorded together."""

    root: Path
    preset: Preset
    seed: int
    split: str
    number: int
    assemblies: tuple[str, ...]
    """The assemblies of its scenes, in order."""

    @property
    def id(self) -> str:
        """Where it stands in the dataset, without the ending."""
        return f"{self.split}/{self.number:04d}"

    def __str__(self) -> str:
        return f"shard {self.id}"


def shard_jobs(
    root: Path, preset: Preset, seed: int, split: str, planned: list[str], usable: set[str]
) -> list[ShardJob]:
    """The shards of a split. What a shard holds depends on the plan alone, less what could not be made."""
    jobs = []
    for first in range(0, len(planned), SCENES_PER_SHARD):
        chosen = tuple(i for i in planned[first : first + SCENES_PER_SHARD] if i in usable)
        if chosen:
            jobs.append(ShardJob(root, preset, seed, split, first // SCENES_PER_SHARD, chosen))
    return jobs


def make_shard(job: ShardJob) -> Record:
    """Do the job, or find it done, and return its record."""
    done = finished_record(job.root, "shards", job.id)
    if done is not None:
        return done
    redraws: Counter[str] = Counter()
    refused: dict[str, str] = {}
    figures: list[dict[str, Any]] = []
    held: list[str] = []
    with ExitStack() as stack:
        files = {ending: stack.enter_context(kind(job.root / f"{job.id}{ending}")) for ending, kind in _writers(job)}
        for assembly_id in job.assemblies:
            assembly, parts = read_assembly(job.root, assembly_id)
            try:
                scene = make_scene(job.preset, job.seed, job.split, assembly, parts, EXTRA_VIEWS in files)
            except Redraw as refusal:  # no layout shows its target: the scene is missing, the rest is not
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
            figures.append(scene_statistics([scene.truth]))
            held.append(scene.truth.scene_id)
    return save_record(
        job.root,
        "shards",
        job.id,
        {
            "id": job.id,
            "split": job.split,
            "files": {f"{job.id}{ending}": file.sha256 for ending, file in files.items() if file.sha256 is not None},
            "scenes": held,
            "redraws": dict(redraws),
            "refused": refused,
            "statistics": add_up(figures),
        },
    )


def _writers(job: ShardJob) -> list[tuple[str, Callable[[Path], Any]]]:
    """The files of a shard: their endings and who writes them."""
    extra_views = [(EXTRA_VIEWS, ObservationWriter)] if job.split in SPLITS_WITH_EXTRA_VIEWS else []
    return [(OBSERVATIONS, ObservationWriter), (TRUTH, TruthWriter), *extra_views]
