"""The files that describe a finished dataset: tables, `dataset.json`, the data card and the Croissant description."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from kit1000.dataset.json_rows import FORMAT, Row
from kit1000.dataset.scene_data import LICENCE
from kit1000.files import json_bytes, with_checksum
from kit1000.generation.croissant import croissant_bytes
from kit1000.generation.parts_and_kits import Record
from kit1000.generation.plan import DATA_VERSION, dataset_id
from kit1000.generation.readme import readme_bytes
from kit1000.generation.statistics import add_up, part_statistics
from kit1000.queries.tracks import SPLITS
from kit1000.version import __version__

LIBRARIES = ("manifold3d", "mcap", "numba", "numpy", "pybullet", "scipy", "zstandard")  # that decide the bytes
MADE_WITH = "made_with"  # entry of dataset.json: the versions of libraries
ABSENT = "absent"


@dataclass(frozen=True, eq=False)
class JobRecords:
    """The records of all jobs of a dataset, by id."""

    parts: dict[str, Record]
    assemblies: dict[str, Record]
    shards: dict[str, Record]
    refused: dict[str, str] = field(default_factory=dict)  # reasons by name of the mesh files that are no parts
    untried: int | None = None  # number of mesh files that were not needed; None for procedural parts

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 of all files that jobs wrote, by name."""
        records = [*self.parts.values(), *self.assemblies.values(), *self.shards.values()]
        return {name: digest for record in records for name, digest in record["files"].items()}


def tables(plan: Mapping[str, Any], records: JobRecords) -> dict[str, dict[str, Row]]:
    """Rows by id of the tables `parts`, `kits` and `assemblies`."""
    parts = {part_id: records.parts[part_id] for part_id in plan["parts"]}
    common = ("split", "source", "redraws", "measures")
    return {
        "parts": {i: r["part"] | {key: r[key] for key in common if key in r} for i, r in parts.items()},
        "kits": {i: r["kit"] | {"split": r["split"]} for i, r in parts.items()},
        "assemblies": {
            i: r["assembly"] | {key: r[key] for key in ("split", "target", "redraws")}
            for i, r in records.assemblies.items()
        },
    }


def make_summary(plan: dict[str, Any], records: JobRecords, written: Mapping[str, str]) -> dict[str, Any]:
    """The contents of `dataset.json`, without the hashes of the data card and of the Croissant file.

    `written`: SHA-256 by name of files that no job wrote, such as the tables.
    """
    untried = {} if records.untried is None else {"untried_files": records.untried}
    return {
        "format": FORMAT,
        "data_version": DATA_VERSION,
        "dataset_id": dataset_id(plan),
        "licence": LICENCE,
        "preset": plan["preset"],
        "seed": plan["seed"],
        "config": plan["config"],
        "held_out_families": plan["held_out_families"],
        "counts": {split: _counts(records, split) for split in SPLITS},
        "redraws": {
            "parts": _count_reasons(record["redraws"] for record in records.parts.values()),
            "assemblies": _count_reasons(record["redraws"] for record in records.assemblies.values()),
            "scenes": _count_reasons(record["redraws"] for record in records.shards.values()),
        },
        "refused": records.refused,
        "refused_scenes": {k: v for _, record in sorted(records.shards.items()) for k, v in record["refused"].items()},
        "statistics": {split: _statistics(records, split) for split in SPLITS},
        "shards": {
            f"{shard_id}.mcap": record["scenes"] for shard_id, record in records.shards.items() if record["scenes"]
        },
        "files": records.files | dict(written),
        MADE_WITH: library_versions(),
    } | untried


def library_versions() -> dict[str, str]:
    """Versions of LIBRARIES by name, and of kit1000 and Python."""
    found = {"kit1000": __version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = ABSENT
    return found


def description_files(summary: dict[str, Any]) -> dict[str, bytes]:
    """The data card and the Croissant description, as bytes by file name."""
    return {"README.md": readme_bytes(summary), "croissant.json": croissant_bytes(summary)}


def summary_bytes(summary: Mapping[str, Any]) -> bytes:
    """The bytes of `dataset.json`, with a checksum of its other entries.

    Versions of libraries have a checksum of their own: they are no part of what tells copies of a dataset apart.
    """
    plain = {key: value for key, value in summary.items() if key not in ("checksum", MADE_WITH)}
    made = {MADE_WITH: with_checksum(summary[MADE_WITH])} if MADE_WITH in summary else {}
    return json_bytes(with_checksum(plain) | made)


def _of_split(records: Mapping[str, Record], split: str) -> list[Record]:
    return [record for _, record in sorted(records.items()) if record["split"] == split]


def _counts(records: JobRecords, split: str) -> dict[str, int]:
    return {
        "parts": sum(record["split"] == split for record in records.parts.values()),
        "assemblies": len(_of_split(records.assemblies, split)),
        "scenes": sum(len(record["scenes"]) for record in _of_split(records.shards, split)),
    }


def _statistics(records: JobRecords, split: str) -> dict[str, Any]:
    """The statistics of a split for the data card: of the scenes, and of the parts and their kits."""
    parts = [record for record in records.parts.values() if record["split"] == split]
    of_pairs = part_statistics([record["part"] for record in parts], [record["kit"] for record in parts])
    return add_up([*(record["statistics"] for record in _of_split(records.shards, split)), of_pairs])


def _count_reasons(redraws: Iterable[Iterable[str] | Mapping[str, int]]) -> dict[str, int]:
    """Number of redraws by reason; each record has a list of reasons, or their counts."""
    total: Counter[str] = Counter()
    for reasons in redraws:
        total.update(reasons)
    return dict(total)
