"""The data card: a description of a dataset in words and tables, written as its `README.md`.

Everything in it follows from `dataset.json`; its numbers are the statistics in there. Texts that the Croissant
description shares are defined here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from kit1000.errors import shown
from kit1000.generation import card_statistics
from kit1000.generation.card_statistics import add_up, part_statistics, scene_statistics
from kit1000.queries.tracks import SPLITS

__all__ = ["add_up", "card_bytes", "part_statistics", "scene_statistics"]

NAME = "KIT1000"
ABOUT = (
    "Depth scenes of kit assembly: machine parts lie on a table beside an angled assembly of kits, each kit has a "
    "cavity for one of the parts. Asked is the rigid motion that seats a part in its cavity, in 6DoF."
)
COLLECTION = (
    "Everything is made by a program from one seed: parts by procedural CAD (or from a folder of meshes), kits and "
    "assemblies by exact geometry, rest poses by rigid-body simulation, depth images by rendering, and models of a "
    "stereo camera and a scanner on top, with errors measured on public images of real ones. No person, place or real "
    "object was recorded."
)
LIMITS = (
    "Simulated depth only, without colour; `d415` and `photoneo` are models of sensors, not recordings.",
    "Parts are rigid and of one size class, and lie on the table: close together in crowded scenes, but none lies on "
    "another or leans on one.",
    "Every cavity lets its part out straight along one axis; press fits, threads and snap fits do not occur.",
    "Which scenes are kept is decided by what the camera sees of the drawn target; the redraws above count the rest.",
    "Bytes are the same on x86-64 processors with and without AVX2 and FMA; others may differ in the last bits of "
    "geometry and depth, so `kit1000 verify` compares within 0.1 mm.",
)
BIASES = (
    "Part families are mixed so that shape statistics resemble those of real CAD parts; slim bars, and parts whose "
    "cavity would accept them in a wrong pose, are drawn again and so are rarer than in machines.",
    "Cameras look down at 28 to 60 degrees from the vertical (crowded scenes: 45 to 60), from 0.6 to 1 m away, times "
    "the scale of the preset; other views occur in the camera set `three` alone.",
)
USES = (
    "Training and scoring methods that predict the motion which seats an unseen part in its kit.",
    "6DoF pose estimation, segmentation and shape completion of machine parts from depth, by way of the BOP export.",
)
NO_PERSONS = "None: no person is recorded, named or described."
MAINTENANCE = (
    "The data version has three numbers and is raised whenever the same plan gives other data. A dataset is named by "
    "its id, a hash of its plan and data version; scores name the id they were measured on."
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
    "The truth of the split `{split}`, its meshes and the plan are withheld: answers are scored by their keepers. "
    "Each of its scenes has the queries of one track and the images of that track's sensor. "
    "`dataset.json` commits to what is withheld by a salted hash."
)
FILES = {
    "dataset.json": "identity, configuration, counts, figures, SHA-256 of each file; written last",
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
ALWAYS = (
    "dataset.json",
    "croissant.json",
)  # listed in the card without their hashes: the first is written after it, the second with it
COUNTED_KINDS = ("parts", "assemblies", "scenes")
READING_EXAMPLE = """from kit1000 import Dataset

data = Dataset("path/to/this/folder")
for query in data.split("test").queries("snap"):
    depth = query.view.depth            # (H, W) float32 [m] along the optical axis, 0 = no return
    part, kit = query.part_mask, query.kit_region
    guess = query.guess                 # goal_from_now, as a person might say it
    break

truth = data.split("val", truth=True)   # truth is read when asked for by name
print(next(iter(truth)).truth.parts[0]["family"])"""
HISTOGRAMS = (
    ("Kits in an assembly", "kits", "scenes", None),
    ("How parts lie", "rest_mode", "parts", None),
    ("Parts of a scene", "crowding", "scenes", None),
    ("Tilt of the slot [deg]", "tilt_deg", "parts", card_statistics.TILT_DEG),
    ("Share of the part that is seen [%]", "visible_percent", "parts", card_statistics.VISIBLE_PERCENT),
    ("Pixels of the part", "pixels", "parts", card_statistics.PIXELS),
    ("Angle at which the slot is seen [deg]", "slot_angle_deg", "parts", card_statistics.SLOT_ANGLE_DEG),
    ("Share of the cavity that is seen [%]", "slot_visible_percent", "parts", card_statistics.SLOT_VISIBLE_PERCENT),
    ("Family of the part", "family", "parts", None),
    ("Symmetry of the part", "symmetry", "pairs", None),
    (
        "Keyedness: smallest wrong turn that does not seat [deg]",
        "keyedness_deg",
        "pairs",
        card_statistics.KEYEDNESS_DEG,
    ),
)


def card_bytes(summary: Mapping[str, Any]) -> bytes:
    """The data card of a dataset, from the contents of its `dataset.json`."""
    sections = [_head(summary), *_contents(summary), *_redraws_and_statistics(summary), *_about(summary)]
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
    matching = {pattern: [name for name in names if _fits(name, pattern)] for pattern in FILES}
    return {pattern: files for pattern, files in matching.items() if files}


def _fits(name: str, pattern: str) -> bool:
    return name.count("/") == pattern.count("/") and fnmatchcase(name, pattern)


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
    identity += [("licence", summary["licence"]), *_preset_rows(summary.get("config") or {})]
    yield "## Identity\n\n" + _table(("", ""), identity)
    counted = {kind for split in SPLITS for kind in summary["counts"].get(split, {})}
    kinds = [kind for kind in COUNTED_KINDS if kind in counted] + sorted(counted - {*COUNTED_KINDS})
    rows = [(split, *(summary["counts"].get(split, {}).get(kind, 0) for kind in kinds)) for split in SPLITS]
    yield "## Counts\n\n" + _table(("split", *kinds), rows)
    occur = summary.get("statistics", {}).get("test", {}).get("family")
    held_out = [family for family in summary.get("held_out_families") or () if occur is None or family in occur]
    if held_out:
        yield f"Families in the test split alone: {', '.join(held_out)}."
    listed_files = files_by_pattern(summary) | {name: [name] for name in ALWAYS}
    rows = [
        (f"`{pattern}`", len(listed_files[pattern]), FILES[pattern]) for pattern in FILES if pattern in listed_files
    ]
    yield "## Files\n\n" + _table(("path", "files", "holds"), rows)
    if summary.get("withheld"):
        yield WITHHELD.format(**summary["withheld"])


def _preset_rows(config: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Rows (name, value) of the preset's main settings, in millimetres and degrees."""
    if "longest" in config:
        low, high = (1e3 * side for side in config["longest"])
        yield "longest side of a part", f"{low:g} to {high:g} mm" if high > low else f"{low:g} mm"
    if "clearance" in config:
        yield "clearance", f"{1e3 * config['clearance']:g} mm"
    if config.get("frames", 1) > 1:
        yield "depth image of a sensor", f"mean of {config['frames']} frames"
    if "kits" in config:
        yield "kits in an assembly", "{} to {}".format(*config["kits"])
    if "tilt_deg" in config:
        yield "tilt of side kits", "{:g} to {:g} degrees".format(*config["tilt_deg"])


def _redraws_and_statistics(summary: Mapping[str, Any]) -> Iterator[str]:
    yield "## Drawn again\n\nNothing is dropped in silence: a draw that geometry refuses is replaced by the next one."
    redraws = summary.get("redraws", {})
    for kind in sorted(
        redraws, key=lambda kind: (COUNTED_KINDS.index(kind) if kind in COUNTED_KINDS else len(COUNTED_KINDS), kind)
    ):
        ranked = sorted(redraws[kind].items(), key=lambda row: (-row[1], row[0]))
        rows = [(_reason(reason), times) for reason, times in ranked]
        yield f"### {kind.capitalize()}\n\n" + (_table(("reason", "times"), rows) if rows else "None.")
    for what, key in (("files", "refused"), ("scenes", "refused_scenes")):
        if summary.get(key):
            reasons: dict[str, int] = {}
            for reason in summary[key].values():
                reasons[reason] = reasons.get(reason, 0) + 1
            yield f"### Refused {what}\n\n" + _table(
                ("reason", "times"), [(_reason(reason), times) for reason, times in sorted(reasons.items())]
            )
    yield (
        "Loose fits (a cavity that accepts its part in a pose which is no goal) are drawn again in every split: "
        f"{redraws.get('parts', {}).get('loose fit', 0)} were, and none is left."
    )
    statistics = {split: summary.get("statistics", {}).get(split) or {} for split in SPLITS}
    if not any(statistics.values()):
        return
    yield "## Figures\n\nParts are counted once for each scene they lie in."
    for heading, key, total_key, edges in HISTOGRAMS:
        if any(key in entry for entry in statistics.values()):
            yield f"### {heading}\n\n" + _histogram(statistics, key, total_key, edges)
    yield from _query_tables(statistics)


def _histogram(statistics: Mapping[str, Mapping], key: str, total_key: str, edges: tuple[int, ...] | None) -> str:
    """A table with a row for each bin and a column for each split: counts, and their shares of the total.

    Args:
        statistics: by split.
        key: of the histogram in them.
        of: key of the total count in them.
        edges: of the bins; None where bins are names.
    """
    every = {name for entry in statistics.values() for name in entry.get(key, {})}
    ordered = [name for name in card_statistics.bin_names(edges) if name in every] if edges else []
    names = ordered + sorted(every - {*ordered}, key=lambda name: (len(name) if name.isdigit() else 0, name))
    splits = [split for split in SPLITS if statistics[split].get(key)]
    rows = [
        (name, *(_share(statistics[split][key].get(name, 0), statistics[split].get(total_key, 0)) for split in splits))
        for name in names
    ]
    return _table(("", *splits), rows)


def _query_tables(statistics: Mapping[str, Mapping]) -> Iterator[str]:
    """Tables of the queries by track, of the parts without queries, and of the mean errors of guesses."""
    splits = [split for split in SPLITS if statistics[split]]
    for heading, key in (("Queries by track", "queries"), ("Parts not asked about, and why", "unseen")):
        names = sorted({name for split in splits for name in statistics[split].get(key, {})})
        rows = [(name, *(statistics[split].get(key, {}).get(name, 0) for split in splits)) for name in names]
        yield f"### {heading}\n\n" + (_table(("", *splits), rows) if rows else "None.")
    guesses = [
        (split, track, entry)
        for split in splits
        for track, entry in sorted(statistics[split].get("guesses", {}).items())
    ]
    if guesses:
        rows = [
            (split, track, entry["n"], _mean(entry["sum_um"], entry["n"]), _mean(entry["sum_mdeg"], entry["n"]))
            for split, track, entry in guesses
        ]
        head = ("split", "track", "guesses", "mean error [mm]", "mean error [deg]")
        yield "### How far guesses are off, at the pivot\n\n" + _table(head, rows)


def _about(summary: Mapping[str, Any]) -> Iterator[str]:
    yield f"## Where it comes from\n\n{COLLECTION}"
    yield "## Use\n\n" + _bullet_list(USES)
    yield "## Known limits\n\n" + _bullet_list((*LIMITS, *BIASES))
    yield f"## How to read it\n\n```python\n{READING_EXAMPLE}\n```"
    yield (
        "Units are SI, quaternions are wxyz, `a_from_b` maps coordinates in b to coordinates in a, cameras are those "
        "of OpenCV. The MCAP files open in Foxglove and Lichtblick as they are."
    )
    yield f"## Licence\n\n{summary['licence']}. {PAPER} Parts made from meshes of others stand under their terms."
    yield f"## Upkeep\n\n{MAINTENANCE}"
    yield f"## Citation\n\n```bibtex\n{citation(summary)}\n```"


def _table(head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown; columns of numbers are right-aligned."""
    cells = [[str(cell) for cell in row] for row in rows]
    numbers = [bool(cells) and all(row[i][:1].isdigit() for row in cells) for i in range(len(head))]
    rule = ["---:" if number and i else "---" for i, number in enumerate(numbers)]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in [head, rule, *cells])


def _reason(text: str) -> str:
    """A reason, which may contain the name of a file, as a cell of a table."""
    return shown(text).replace("|", "\\|").replace("<", "&lt;")


def _bullet_list(texts: Sequence[str]) -> str:
    return "\n".join(f"- {text}" for text in texts)


def _share(count: int, total: int) -> str:
    return f"{count} ({100 * count / total:.1f} %)" if total else str(count)


def _mean(thousandths: int, n: int) -> str:
    return f"{thousandths / 1e3 / n:.1f}"
