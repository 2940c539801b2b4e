"""The Croissant description of a dataset (JSON-LD, version 1.1 with the RAI vocabulary), from `dataset.json`.

Every recording and table is listed with its SHA-256; the thousands of meshes are listed by pattern. Tables and the list
of scenes can be loaded as records; recordings are read by `kit1000.dataset.reader` or any MCAP reader.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from kit1000.generation.readme import (
    ABOUT,
    BIASES,
    COLLECTION,
    FILES,
    LIMITS,
    MAINTENANCE,
    NO_PERSONS,
    PAPER,
    USES,
    WITHHELD,
    citation,
    files_by_pattern,
    title,
)
from kit1000.queries.tracks import SPLITS

PUBLISHED = "2026-11-28"  # date of the current data version: a constant, so that the bytes do not depend on the day
CONFORMS = ["http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0"]
LICENCES = {"CC-BY-4.0": "https://creativecommons.org/licenses/by/4.0/"}
FORMATS = {"json": "application/json", "glb": "model/gltf-binary", "mcap": "application/x-mcap"}
SPLIT_KINDS = {"train": "cr:TrainingSplit", "val": "cr:ValidationSplit", "test": "cr:TestSplit"}
TERMS = (
    *("arrayShape", "citeAs", "column", "containedIn", "equivalentProperty", "extract", "field", "fileProperty"),
    *("fileObject", "fileSet", "format", "includes", "isArray", "isLiveDataset", "jsonPath", "key", "md5"),
    *("parentField", "path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate", "separator"),
    *("source", "subField", "transform"),
)
CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "name": {"@container": "@language"},
    "description": {"@container": "@language"},
    "data": {"@id": "cr:data", "@type": "@json"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
} | {term: f"cr:{term}" for term in TERMS}
TABLES = {
    "parts": {
        "family": ("sc:Text", "family", "Family of procedural CAD it was drawn from, or `file`."),
        "split": ("sc:Text", "split", "The split that the part belongs to."),
        "mass": ("sc:Float", "mass", "[kg]"),
        "volume": ("sc:Float", "volume", "[m^3]"),
        "symmetry": ("sc:Text", "symmetry.name", "Schoenflies name of its rotations, or free, free_flipped, none."),
    },
    "kits": {
        "part": ("sc:Text", "part_id", "Id of the part, which is that of the kit."),
        "split": ("sc:Text", "split", "The split that the kit belongs to."),
        "clearance": ("sc:Float", "clearance", "[m] between the part's shadow and the walls."),
        "depth": ("sc:Float", "depth", "[m] from the rim to the cavity's floor."),
    },
    "assemblies": {
        "target": ("sc:Text", "target", "The part it was made for, which gives it its id."),
        "split": ("sc:Text", "split", "The split that the assembly belongs to."),
    },
}

Node = dict[str, Any]


def croissant_bytes(summary: Mapping[str, Any]) -> bytes:
    """The bytes of `croissant.json`, from the contents of `dataset.json`."""
    text = json.dumps(_dataset(summary), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    return text.encode("utf-8", "backslashreplace")  # escapes of JSON


def _dataset(summary: Mapping[str, Any]) -> Node:
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": CONFORMS,
        "name": title(summary),
        "description": f"{ABOUT} {PAPER} {_identity(summary)}",
        "url": f"urn:kit1000:{summary['dataset_id']}",
        "license": LICENCES.get(summary["licence"], summary["licence"]),
        "version": summary["data_version"],
        "datePublished": PUBLISHED,
        "creator": {"@type": "sc:Organization", "name": "The KIT1000 authors"},
        "publisher": {"@type": "sc:Organization", "name": "The KIT1000 authors"},
        "inLanguage": "en",
        "isLiveDataset": False,
        "keywords": ["robotics", "kit assembly", "6DoF pose", "depth", "CAD", "benchmark"],
        "citeAs": citation(summary),
        "rai:dataCollection": COLLECTION,
        "rai:dataLimitations": list(LIMITS),
        "rai:dataBiases": list(BIASES),
        "rai:dataUseCases": list(USES),
        "rai:personalSensitiveInformation": NO_PERSONS,
        "rai:dataReleaseMaintenancePlan": MAINTENANCE,
        "distribution": list(_distribution(summary)),
        "recordSet": list(_record_sets(summary)),
    }


def _identity(summary: Mapping[str, Any]) -> str:
    """Id and preset of the dataset, what is withheld, and that its URL is only a name."""
    what = f"Dataset {summary['dataset_id']}, preset {summary['preset']}."
    withheld = f" {WITHHELD.format(**summary['withheld'])}" if summary.get("withheld") else ""
    return f"{what}{withheld} Its address is a name; its files stand beside this one."


def _distribution(summary: Mapping[str, Any]) -> Iterator[Node]:
    """A node for each file with its hash, and one node for each folder of meshes."""
    for pattern, names in files_by_pattern(summary).items():
        if pattern.endswith(".glb"):
            yield {
                "@type": "cr:FileSet",
                "@id": pattern.partition("/")[0] + "-meshes",
                "name": pattern.partition("/")[0] + "-meshes",
                "description": f"{FILES[pattern]} ({len(names)} files; dataset.json has the SHA-256 of each)",
                "encodingFormat": FORMATS["glb"],
                "includes": pattern,
            }
        else:
            yield from (_file(name, FILES[pattern], summary["files"][name]) for name in names)


def _file(name: str, description: str, digest: str) -> Node:
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "description": description,
        "contentUrl": name,
        "encodingFormat": FORMATS[name.rpartition(".")[2]],
        "sha256": digest,
    }


def _record_sets(summary: Mapping[str, Any]) -> Iterator[Node]:
    yield {
        "@type": "cr:RecordSet",
        "@id": "splits",
        "name": "splits",
        "description": "No part of a split occurs in another.",
        "dataType": "cr:Split",
        "key": {"@id": "splits/name"},
        "field": [
            _field("splits", "name", "sc:Text", "Name of the split."),
            _field("splits", "url", "sc:URL", "Its kind."),
        ],
        "data": [{"splits/name": split, "splits/url": SPLIT_KINDS[split]} for split in SPLITS],
    }
    if summary.get("shards"):
        yield _scenes(summary["shards"])
    for table, columns in TABLES.items():
        if f"{table}.json" in summary["files"]:
            yield _table(table, columns)


def _scenes(shards: Mapping[str, list[str]]) -> Node:
    """The scenes and their recordings, as records in the description itself."""
    rows = [
        {"scenes/id": scene, "scenes/split": shard.partition("/")[0], "scenes/recording": shard}
        for shard, scenes in sorted(shards.items())
        for scene in scenes
    ]
    split = _field("scenes", "split", "sc:Text", "The split that the scene belongs to.")
    return {
        "@type": "cr:RecordSet",
        "@id": "scenes",
        "name": "scenes",
        "description": "The scenes, and the recording that holds each.",
        "key": {"@id": "scenes/id"},
        "field": [
            _field("scenes", "id", "sc:Text", "Id of the scene."),
            split | {"references": {"field": {"@id": "splits/name"}}},
            _field("scenes", "recording", "sc:Text", "The file of its observations."),
        ],
        "data": rows,
    }


def _table(table: str, columns: Mapping[str, tuple[str, str, str]]) -> Node:
    def source(path: str) -> Node:
        return {"source": {"fileObject": {"@id": f"{table}.json"}, "extract": {"jsonPath": f"$.*.{path}"}}}

    return {
        "@type": "cr:RecordSet",
        "@id": table,
        "name": table,
        "description": FILES[f"{table}.json"],
        "field": [_field(table, name, kind, text) | source(path) for name, (kind, path, text) in columns.items()],
    }


def _field(record_set: str, name: str, kind: str, description: str) -> Node:
    identity = f"{record_set}/{name}"
    return {"@type": "cr:Field", "@id": identity, "name": identity, "description": description, "dataType": kind}
