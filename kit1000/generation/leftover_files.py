"""Mesh files that no part needed, tried where all files of a part were refused, so that no split stays short."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from kit1000.generation.parts_and_kits import PartJob, Record, make_part_and_kit
from kit1000.generation.plan import Sources
from kit1000.parallel import ParallelMap
from kit1000.parts.near_duplicates import near_duplicate_of


def fill_short_splits(
    jobs: Mapping[str, PartJob], records: dict[str, Record], sources: Sources, parallel_map: ParallelMap
) -> None:
    """Give leftover files to refused parts, in rounds of one file a part, and change their records.

    The order of the files depends on the plan alone. A near-duplicate of an accepted part is refused like any other.
    """
    leftover = _leftover(jobs, records, sources)
    while short := [part_id for part_id in jobs if "refused" in records[part_id]]:
        round_jobs = {}
        for part_id, name in zip(short, leftover, strict=False):  # in this order: no part takes a file for nothing
            round_jobs[part_id] = _with_file(jobs[part_id], records[part_id], name, sources)
        if not round_jobs:
            return
        made = {record["id"]: record for record in parallel_map(make_part_and_kit, list(round_jobs.values()))}
        for part_id, job in round_jobs.items():
            records[part_id] = _unless_alike(job, made[part_id], records)


def _leftover(jobs: Mapping[str, PartJob], records: Mapping[str, Record], sources: Sources) -> Iterator[str]:
    """The names of the files that no part has tried: first those dealt to parts, then all others."""
    gone = {name for record in records.values() for name in record.get("tried", ())}
    gone |= {record["source"] for record in records.values() if "source" in record}
    dealt = [name for job in jobs.values() for name, _ in job.sources]
    yield from (name for name in dict.fromkeys([*dealt, *sorted(sources.files)]) if name not in gone)


def _with_file(job: PartJob, refused: Record, name: str, sources: Sources) -> PartJob:
    """The job of a refused part with one more file."""
    tried = tuple((each, sources.files[each]) for each in refused["tried"])
    return replace(job, sources=(*tried, (name, sources.files[name])), redraws=tuple(refused["redraws"]))


def _unless_alike(job: PartJob, record: Record, records: Mapping[str, Record]) -> Record:
    """The record, or where the part is a near-duplicate of an accepted one, that of the refused part."""
    if "refused" in record:
        return record
    accepted = [other for other in records.values() if "refused" not in other]
    measures = np.array([other["measures"] for other in accepted]).reshape(-1, 5)
    twin = near_duplicate_of(np.array(record["measures"]), measures)
    if twin is None:
        return record
    alike = f"near-duplicate of {accepted[twin]['source']}"
    return make_part_and_kit(replace(job, redraws=(*record["redraws"], alike)))
