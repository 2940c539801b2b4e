"""The data card of a dataset, its `README.md`: what it is, what it holds, and how it is read.

Everything in it follows from `dataset.json`, which also has the histograms. The Croissant description shares its texts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from kit1000.errors import shown
from kit1000.queries.tracks import SPLITS

NAME = "KIT1000"
ABOUT = (
    "Depth scenes of kit assembly: machine parts lie on a table beside an assembly of tilted kits, and each kit has a "
    "cavity for one of the parts. A method is asked for the rigid motion in 6DoF that seats a part in its cavity."
)
COLLECTION = (
    "A program makes everything from one seed: parts by procedural CAD or from a folder of meshes, kits and assemblies "
    "by exact geometry, rest poses by rigid-body simulation, depth images by rendering and by models of two sensors. "
    "No person, place or real object was recorded."
)
LIMITS = (
    "The depth images are simulated and have no colour; `d415` and `photoneo` are models of sensors.",
    "Parts are rigid and of one size class. They lie on the table, never on one another.",
    "Every cavity lets its part out straight along one axis: there are no press fits, threads or snap fits.",
    "A scene is kept only if the camera sees enough of its target; the redraws are counted.",
    "The content is the same on every x86-64 processor; others may differ in the last bits.",
)
BIASES = (
    "Part families are mixed so that shape statistics resemble those of real CAD parts. Slim bars, and parts whose "
    "cavity accepts them in a wrong pose, are rarer than in machines.",
    "Cameras look down at 28 to 60 degrees from the vertical, from 0.6 to 1 m away times the scale of the preset.",
)
USES = (
    "Training and scoring methods that predict the motion which seats an unseen part in its kit.",
    "6DoF pose estimation, segmentation and shape completion of machine parts from depth.",
)
NO_PERSONS = "None: no person is recorded, named or described."
MAINTENANCE = (
    "A dataset is named by its id, a hash of its plan; scores name the id they were measured on. The data version "
    "changes with the files, the id with their content."
)
CITATION = """@misc{kit1000,
  title = {{KIT1000}: dataset, benchmark and reference system for {6DoF} kit assembly},
  author = {{The KIT1000 authors}},
  year = {2026},
  note = {data version %s, dataset %s}
}"""
PAPER = (
    'The task is that of Li et al., "Scene Editing as Teleoperation: A Case Study in 6DoF Kit Assembly", IROS 2022 '
    "(arXiv:2110.04450)."
)
WITHHELD = (
    "The truth of the split `{split}`, its meshes and the plan are withheld: their keepers score the answers. "
    "Each of its scenes has the queries of one track and the images of that track's sensor. "
    "`dataset.json` commits to what is withheld by a salted hash."
)
FILES = {
    "dataset.json": "identity, configuration, counts, histograms, SHA-256 of each file",
    "plan.json": "every random draw, no geometry: all else follows from it",
    "parts.json": "parts: family, dimensions, mass, symmetry",
    "kits.json": "kits: the pose of the seated part, every goal, clearance, depth, keyedness",
    "assemblies.json": "assemblies: which kits stand where",
    "parts/*.glb": "a mesh for each part: metres, y up",
    "kits/*.glb": "a mesh for each kit",
    "assemblies/*.glb": "a mesh for each assembly, printable",
    "*/????.mcap": "observations: depth, masks, camera, queries",
    "*/*.truth.mcap": "truth: poses, goals, segmentation, models",
    "*/*.three.mcap": "depth from three further cameras",
    "croissant.json": "this description for machines (Croissant 1.1)",
}
WITHOUT_HASH = ("dataset.json", "croissant.json")  # written after the data card, or with it
KINDS = ("parts", "assemblies", "scenes")
READING_EXAMPLE = """from kit1000 import Dataset

data = Dataset("path/to/this/folder")
for query in data.split("test").queries("snap"):
    depth = query.view.depth            # (H, W) float32 [m] along the optical axis, 0 = no return
    part, kit = query.part_mask, query.kit_region
    guess = query.guess                 # goal_from_now, as a person might state it
    break

truth = data.split("val", truth=True)   # truth is read only if requested
print(next(iter(truth)).truth.parts[0]["family"])"""


def readme_bytes(summary: Mapping[str, Any]) -> bytes:
    """The data card of a dataset, from the contents of its `dataset.json`."""
    sections = [_head(summary), *_contents(summary), *_redraws(summary), *_about(summary)]
    return ("\n\n".join(sections) + "\n").encode("utf-8", "backslashreplace")  # file names are any bytes


def title(summary: Mapping[str, Any]) -> str:
    """The name of a dataset: KIT1000, followed by the preset unless that is kit1000."""
    return NAME if summary["preset"] == "kit1000" else f"{NAME} {summary['preset']}"


def citation(summary: Mapping[str, Any]) -> str:
    """The citation of a dataset, as BibTeX."""
    return CITATION % (summary["data_version"], summary["dataset_id"])


def files_by_pattern(summary: Mapping[str, Any]) -> dict[str, list[str]]:
    """The files of a dataset, sorted, by the pattern of FILES that they match; patterns without files are left out."""
    names = sorted(summary["files"])
    matching = {
        pattern: [name for name in names if name.count("/") == pattern.count("/") and fnmatchcase(name, pattern)]
        for pattern in FILES
    }
    return {pattern: files for pattern, files in matching.items() if files}


def _head(summary: Mapping[str, Any]) -> str:
    lines = [
        "---",
        f"pretty_name: {title(summary)}",
        f"license: {summary['licence'].lower()}",
        "tags: [robotics, kit assembly, 6DoF pose, depth, CAD]",
        "---",
        "",
        f"# {title(summary)}",
        "",
        ABOUT,
    ]
    return "\n".join(lines)


def _contents(summary: Mapping[str, Any]) -> Iterator[str]:
    identity = [("dataset id", f"`{summary['dataset_id']}`"), ("data version", summary["data_version"])]
    identity += [("preset", f"`{summary['preset']}`")]
    identity += [("seed", summary["seed"])] if summary.get("seed") is not None else []
    config = summary.get("config") or {}
    if "longest" in config:
        identity.append(
            ("longest side of a part", "{:g} to {:g} mm".format(*(1e3 * side for side in config["longest"])))
        )
    if "clearance" in config:
        identity.append(("clearance", f"{1e3 * config['clearance']:g} mm"))
    yield "## Identity\n\n" + _table(("", ""), identity)
    rows = [(split, *(summary["counts"].get(split, {}).get(kind, 0) for kind in KINDS)) for split in SPLITS]
    yield "## Counts\n\n" + _table(("split", *KINDS), rows)
    statistics = {split: summary.get("statistics", {}).get(split) or {} for split in SPLITS}
    tracks = sorted({track for entry in statistics.values() for track in entry.get("queries", {})})
    if tracks:
        queries = [
            (track, *(statistics[split].get("queries", {}).get(track, 0) for split in SPLITS)) for track in tracks
        ]
        yield _table(("queries of track", *SPLITS), queries)
    held_out = summary.get("held_out_families") or ()
    if held_out:
        yield f"These families may occur in the test split alone: {', '.join(held_out)}."
    files = files_by_pattern(summary) | {name: [name] for name in WITHOUT_HASH}
    rows = [(f"`{pattern}`", len(files[pattern]), text) for pattern, text in FILES.items() if pattern in files]
    yield "## Files\n\n" + _table(("path", "files", "content"), rows)
    if summary.get("withheld"):
        yield WITHHELD.format(**summary["withheld"])


def _redraws(summary: Mapping[str, Any]) -> Iterator[str]:
    """The refused draws by kind and reason, the most frequent first, and the refused files and scenes."""
    counted = dict(summary.get("redraws", {}))
    for what, key in (("files without a part", "refused"), ("scenes left out", "refused_scenes")):
        reasons = list((summary.get(key) or {}).values())
        counted[what] = {reason: reasons.count(reason) for reason in reasons}
    rows = [
        (kind, _cell(reason), times)
        for kind in sorted(counted, key=lambda kind: (KINDS.index(kind) if kind in KINDS else len(KINDS), kind))
        for reason, times in sorted(counted[kind].items(), key=lambda row: (-row[1], row[0]))
    ]
    text = "## Redraws\n\nA draw that geometry refuses is replaced by the next one; every refusal is counted."
    yield f"{text}\n\n{_table(('of', 'reason', 'times'), rows)}" if rows else f"{text} There were none."


def _about(summary: Mapping[str, Any]) -> Iterator[str]:
    yield f"## Origin\n\n{COLLECTION}"
    yield "## Use\n\n" + _bullet_list(USES)
    yield "## Known limits\n\n" + _bullet_list((*LIMITS, *BIASES))
    yield f"## How to read it\n\n```python\n{READING_EXAMPLE}\n```"
    yield (
        "Units are SI, quaternions are wxyz, `a_from_b` maps coordinates in b to coordinates in a, cameras are those "
        "of OpenCV. The MCAP files open in Foxglove and Lichtblick as they are. `statistics` in `dataset.json` has "
        "histograms by split: families, symmetries, tilts, visibility, rest modes."
    )
    yield f"## Licence\n\n{summary['licence']}. {PAPER} Parts made from meshes of others stand under their terms."
    yield f"## Versions\n\n{MAINTENANCE}"
    yield f"## Citation\n\n```bibtex\n{citation(summary)}\n```"


def _table(head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown; columns of numbers are right-aligned."""
    cells = [[str(cell) for cell in row] for row in rows]
    numbers = [bool(cells) and all(row[i][:1].isdigit() for row in cells) for i in range(len(head))]
    rule = ["---:" if number and i else "---" for i, number in enumerate(numbers)]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in [head, rule, *cells])


def _cell(reason: str) -> str:
    """A reason, which may contain the name of a file, as a cell of a table."""
    return shown(reason).replace("|", "\\|").replace("<", "&lt;")


def _bullet_list(texts: Sequence[str]) -> str:
    return "\n".join(f"- {text}" for text in texts)
