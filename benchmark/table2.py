"""Table II: what a whole system reaches, from the image to the part in its slot, stage by stage.

A row of the chain is a submission: which stages of it read the truth is its own business, and its label says so. The
robot carries out its predictions (`kit1000.planner`), and the seating test judges the same predictions. Where a
submission finds its masks, the robot can find the part by these too. Components, such as segmentation and completion,
are measured where they are made; their numbers come as JSON files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial import ConvexHull
from tqdm import tqdm

from benchmark.failures import KINDS, SEATS, failure_kinds
from benchmark.intervals import rate_interval
from benchmark.measurements import Column, Measurement
from benchmark.report import json_text
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import read_json, write_own
from kit1000.metrics import Targets, pose_errors
from kit1000.perception.sensor_facts import AnySensor, sensor_of
from kit1000.planner.execute import NO_SEAL, NOT_FROM_ABOVE, OUTCOMES, SEATED, PartRun, SceneRun, run_scene
from kit1000.planner.runs import outcome_counts
from kit1000.pose import Pose
from kit1000.predictor import resolved
from kit1000.queries.tracks import TRACKS
from kit1000.submission.manifest import FILE as MANIFEST
from kit1000.submission.manifest import read_manifest
from kit1000.submission.predictions import FILE, read_predictions
from kit1000.values import Query, Truth

FIND_MASKS = "kit1000.perception.segmentation.predicted_masks:with_predicted_masks"  # by name: it loads networks
MaskFinder = Callable[[Query, float, AnySensor], Query]
"""Called with a query, the scale of the dataset's scenes and the sensor: the query with masks from its image alone."""
TRUTH = "truth"  # label of the row with the true motions
COMPONENT_KEYS = {"component", "label", "measure", "value", "interval", "n"}

CHAIN_COLUMNS = (
    Column("row", "chain"),
    Column("n", "n"),
    Column("possible", "possible"),
    Column("seated", "seated by the robot, %", 1, True),
    Column("tested", "by the test, %", 1, True),
    Column("position", "mm, median", 2),
    Column("rotation", "°, median", 1),
    Column("seconds", "s a part", 0),
)
COMPONENT_COLUMNS = (
    Column("component", "component"),
    Column("label", "method"),
    Column("measure", "measure"),
    Column("n", "n"),
    Column("value", "mean", 3),
)

PAPER = (  # Table II of "Scene Editing as Teleoperation", arXiv 2110.04450, and its user study
    ("segmentation, mean IoU", "69.1 %", "a missed part counts 0; the mean over objects of 23 scenes"),
    ("part completion, IoU", "92.4 %", "of free space: a box inflated by 4.5 mm scores 93 %"),
    ("part completion, Chamfer distance", "6.3 mm", "of points inside the shapes; two equal shapes score 4.9 mm"),
    ("kit completion, IoU", "99.1 %", "of free space: a kit without any cavity scores 99.4 %"),
    ("kit completion, Chamfer distance", "8.0 mm", "of points inside the shapes; two equal shapes score 7 to 9 mm"),
    ("snapping, position", "7.2 mm", "called average; the script prints the median, over 53 parts"),
    ("snapping, rotation", "6.0°", "likewise; symmetries are ignored"),
    ("parts seated", "62 %", "from a draft: people at a real robot, ten kits each"),
)
"""What the paper prints, and what is to be said about it."""


@dataclass(frozen=True)
class ChainRow:
    """A row of the chain: n queries of one track, carried out by the robot and judged by the seating test."""

    label: str
    n: int
    possible: int
    """Number of those whose part, moved truly, lies right side up and has a spot for a cup."""
    seated: float
    """Share of the possible ones that the robot seats."""
    interval: tuple[float, float]
    """95 % of it."""
    tested: float
    """Share of the possible ones that the seating test passes."""
    agreement: dict[str, int]
    """Number of picked parts that both seat, the robot alone, the test alone, neither."""
    position_mm: float | None
    """Median error of all predictions."""
    rotation_deg: float | None
    seconds: float | None
    """[s] median time of the robot a picked part."""
    outcomes: dict[str, int]
    """Number of queries by outcome."""
    failures: dict[str, int]
    """Number of the possible ones that the robot does not seat, by what is wrong with the motion (`failure_kinds`)."""
    against: dict[str, int]
    """Losses, possible ones that the row before seats and this does not, and wins, the reverse."""
    queries: list[dict[str, Any]]
    """Rows of each query: its id, outcome and detail, what is wrong with the motion (nothing where the seating test
    passes it), and the errors [mm], [degrees]."""


@dataclass(frozen=True)
class _Case:
    """A query with its truth, and what became of its prediction."""

    query: Query
    truth: Truth
    motion: Pose
    run: PartRun


def chain(
    root: str | Path,
    submissions: Mapping[str, str | Path],
    track: str,
    split: str = "test",
    scenes: int | None = None,
    seed: int = 0,
    find_masks: MaskFinder | None = None,
) -> list[ChainRow]:
    """The rows of the chain, the true motions first, then one for each submission.

    Args:
        root: dataset folder with ground truth.
        submissions: submission folders or predictions files by label.
        track: whose queries; their sensor is that by which the robot grasps.
        split: of the queries.
        scenes: number of scenes, the first ones; all when None.
        seed: of the path planner.
        find_masks: by which the robot finds the part in rows of submissions that state predicted masks; None: by the
            recorded masks, as in all others.
    """
    if track not in TRACKS:
        raise InputError(f"--track {track}: there are {', '.join(TRACKS)}")
    dataset = Dataset(root)
    queries = list(dataset.split(split).queries(track))
    ids = list(dict.fromkeys(query.scene_id for query in queries))[:scenes]
    queries = [query for query in queries if query.scene_id in set(ids)]
    if not queries:
        raise InputError(f"{root}: no query of track {track} in split {split}")
    truths = {query.id: dataset.truth_of(query) for query in queries}
    motions = {TRUTH: {query.id: truths[query.id].goal_drawn for query in queries}}
    for label, path in submissions.items():
        motions[label] = _motions_of(Path(path), queries)
    possible: set[str] = set()
    before: set[str] = set()
    rows = []
    for label, predicted in motions.items():
        find = (
            None
            if label == TRUTH
            else _mask_finder(dataset, Path(submissions[label]), TRACKS[track].sensor, find_masks)
        )
        cases = _execute(dataset, label, queries, truths, predicted, TRACKS[track].sensor, seed, find)
        if label == TRUTH:
            possible = {case.query.id for case in cases if case.run.outcome not in (NO_SEAL, NOT_FROM_ABOVE)}
            before = possible
        rows.append(_row(dataset, label, cases, possible, before))
        before = {case.query.id for case in cases if case.run.outcome == SEATED}
    return rows


def _motions_of(path: Path, queries: Sequence[Query]) -> dict[str, Pose]:
    """The predicted motions of queries by id; without a prediction the part stays."""
    predictions = read_predictions(path / FILE if path.is_dir() else path)
    rows = {query.id: predictions.row(query.id) for query in queries}
    if all(row is None for row in rows.values()):
        raise InputError(f"{path}: no prediction for any of {len(rows)} queries, such as {queries[0].id}")
    return {i: Pose.identity() if row is None else predictions.motions[row] for i, row in rows.items()}


def _mask_finder(dataset: Dataset, path: Path, sensor: str, find: MaskFinder | None) -> Callable[[Query], Query] | None:
    """How a submission that states predicted masks found them: by the facts of the sensor."""
    if find is None or not path.is_dir():
        return None
    manifest = read_manifest(path / MANIFEST, path)
    if manifest.masks != "predicted":
        return None
    scale = dataset.summary["config"]["scale"]
    return lambda query: find(query, scale, sensor_of(dataset.summary, sensor, query.scene_id))


def _execute(
    dataset: Dataset,
    label: str,
    queries: Sequence[Query],
    truths: Mapping[str, Truth],
    motions: Mapping[str, Pose],
    sensor: str,
    seed: int,
    find: Callable[[Query], Query] | None,
) -> list[_Case]:
    """Let the robot carry out all motions of a row, scene by scene."""
    cases = []
    for scene_id in tqdm(dict.fromkeys(query.scene_id for query in queries), desc=label, unit="", disable=None):
        own = {query.part: query for query in queries if query.scene_id == scene_id}
        scene = dataset.recorded_scene(scene_id, truth=True)
        images = None if find is None else {part: find(query).image for part, query in own.items()}
        moves = {part: motions[query.id] for part, query in own.items()}
        run: SceneRun = run_scene(scene, moves, sensor, seed, images)
        for part in run.parts:
            query = own[part.part]
            cases.append(_Case(query, truths[query.id], motions[query.id], part))
    return cases


def _row(dataset: Dataset, label: str, cases: Sequence[_Case], possible: set[str], before: set[str]) -> ChainRow:
    truths, motions = [case.truth for case in cases], Pose.stack([case.motion for case in cases])
    targets = Targets.of(truths, lambda part_id: _hull(dataset, part_id))
    errors = pose_errors(motions, targets)
    kinds = np.array(failure_kinds(motions, truths, targets, dataset.geometry))
    tested = kinds == SEATS
    seated = np.array([case.run.outcome == SEATED for case in cases])
    among = np.array([case.query.id in possible for case in cases])
    earlier = np.array([case.query.id in before for case in cases])
    clusters = [case.truth.assembly_id for case in cases if case.query.id in possible]
    picked = np.array([bool(case.run.physics) for case in cases])
    seconds = [case.run.seconds for case in cases if case.run.physics]
    return ChainRow(
        label,
        len(cases),
        int(among.sum()),
        float(seated[among].mean()) if among.any() else 0.0,
        rate_interval(seated[among], [clusters]),
        float(tested[among].mean()) if among.any() else 0.0,
        _agreement(seated[picked], tested[picked]),
        float(np.median(errors.position) * 1e3),
        float(np.degrees(np.median(errors.rotation))),
        float(np.median(seconds)) if seconds else None,
        outcome_counts(case.run for case in cases),
        {kind: int((kinds[among & ~seated] == kind).sum()) for kind in KINDS},
        {"losses": int((earlier & ~seated)[among].sum()), "wins": int((seated & ~earlier)[among].sum())},
        [
            {
                "query": case.query.id,
                "outcome": case.run.outcome,
                "detail": case.run.detail,
                "motion": str(kind),
                "position_mm": round(float(position) * 1e3, 3),
                "rotation_deg": round(float(np.degrees(rotation)), 3),
            }
            for case, kind, position, rotation in zip(cases, kinds, errors.position, errors.rotation, strict=True)
        ],
    )


def _agreement(seated: np.ndarray, tested: np.ndarray) -> dict[str, int]:
    """How often robot and test, (n,) bool each, say seated."""
    counts = {"both": seated & tested, "robot alone": seated & ~tested, "test alone": ~seated & tested}
    return {name: int(which.sum()) for name, which in (counts | {"neither": ~seated & ~tested}).items()}


def _hull(dataset: Dataset, part_id: str) -> np.ndarray:
    vertices = dataset.geometry.part(part_id).mesh.vertices
    return vertices[ConvexHull(vertices).vertices]


def read_components(path: Path) -> list[dict[str, Any]]:
    """The rows of a file of component measures: a JSON list of objects with the keys COMPONENT_KEYS."""
    rows = read_json(path)
    if not isinstance(rows, list) or any(not isinstance(row, dict) or set(row) != COMPONENT_KEYS for row in rows):
        keys = ", ".join(sorted(COMPONENT_KEYS))
        raise InputError(f"{path}: expected a JSON list of objects with the keys {keys}")
    return rows


def markdown(rows: Sequence[ChainRow], components: Sequence[Mapping[str, Any]], title: str) -> str:
    """The table as Markdown: the chain, outcomes, components, and the paper's numbers with what is wrong with them."""
    lines = [title, "", "| chain | n | possible | seated by the robot | by the test | mm | ° | s a part |"]
    lines.append("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for row in rows:
        low, high = row.interval
        share = f"{100 * row.seated:.1f} % [{100 * low:.0f}, {100 * high:.0f}]"
        cells = [row.label, row.n, row.possible, share, f"{100 * row.tested:.1f} %", _number(row.position_mm, 2)]
        lines.append(_line([*cells, _number(row.rotation_deg, 1), _number(row.seconds, 0)]))
    lines += ["", _line(["outcomes", *OUTCOMES]), _line(["---", *["---:"] * len(OUTCOMES)])]
    lines += [_line([row.label, *row.outcomes.values()]) for row in rows]
    for title, counted in (
        ("robot and test, picked parts", [row.agreement for row in rows]),
        ("not seated, by what is wrong with the motion", [row.failures for row in rows]),
        ("against the row before", [row.against for row in rows]),
    ):
        lines += ["", _line([title, *counted[0]]), _line(["---", *["---:"] * len(counted[0])])]
        lines += [_line([row.label, *counts.values()]) for row, counts in zip(rows, counted, strict=True)]
    if components:
        lines += ["", "| component | method | measure | value | 95 % | n |", "| --- | --- | --- | ---: | ---: | ---: |"]
        for part in components:
            ends = " to ".join(f"{end:g}" for end in part["interval"])
            keys = ("component", "label", "measure", "value")
            lines.append(_line([*(part[key] for key in keys), ends, part["n"]]))
    lines += ["", "| the paper | printed | to be said about it |", "| --- | ---: | --- |", *map(_line, PAPER)]
    return "\n".join(lines)


def measured(
    rows: Sequence[ChainRow], components: Sequence[Mapping[str, Any]], dataset: Dataset, track: str
) -> Measurement:
    """The same tables with their setting, for documents."""
    measurement = Measurement.begin(dataset)
    title = f"Preset {dataset.summary['preset']}, track `{track}`: parts seated by the robot, and by the seating test"
    table = measurement.table("chain", title, *CHAIN_COLUMNS)
    for row in rows:
        seated = {"n": row.possible, "rate": row.seated, "ci95": list(row.interval)}
        medians = {"position": row.position_mm, "rotation": row.rotation_deg, "seconds": row.seconds}
        table.add(row=row.label, n=row.n, possible=row.possible, seated=seated, tested=row.tested, **medians)
    for name, title, counted in (
        ("outcomes", "Queries by outcome", [row.outcomes for row in rows]),
        ("agreement", "Picked parts that robot and seating test seat", [row.agreement for row in rows]),
        ("failures", "Parts that the robot does not seat, by the fault of the motion", [row.failures for row in rows]),
        ("against", "Parts seated against the row before", [row.against for row in rows]),
    ):
        counts = measurement.table(name, title, Column("row", "chain"), *(Column(key, key) for key in counted[0]))
        for row, values in zip(rows, counted, strict=True):
            counts.add(row=row.label, **values)
    stages = measurement.table("components", "Single stages", *COMPONENT_COLUMNS)
    for part in components:
        value = {"n": part["n"], "mean": part["value"], "ci95": part["interval"]}
        stages.add(**{key: part[key] for key in ("component", "label", "measure", "n")}, value=value)
    return measurement


def _line(cells: Sequence[Any]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def run(
    data: Path,
    submissions: Sequence[Path],
    track: str,
    split: str,
    components: Path | None,
    scenes: int | None,
    out: Path | None,
    masks: Literal["given", "predicted"] = "given",
) -> str:
    """The table of a dataset and submissions as Markdown, and as JSON in a file `out` if given."""
    labelled = {path.name if path.is_dir() else path.stem: path for path in submissions}
    if len(labelled) < len(submissions) or TRUTH in labelled:
        raise InputError("submissions: expected names of their own, and none called truth, which is there anyway")
    find_masks = resolved(FIND_MASKS) if masks == "predicted" else None
    rows = chain(data, labelled, track, split, scenes, find_masks=find_masks)
    parts = [] if components is None else read_components(components)
    dataset = Dataset(data)
    if out is not None:
        details = {"track": track, "split": split, "chain": list(map(asdict, rows)), "components": parts}
        write_own(out, json_text({**measured(rows, parts, dataset, track).stored(), **details}).encode())
    title = f"Preset {dataset.summary['preset']}, dataset {dataset.id}, track {track}, split {split}."
    return markdown(rows, parts, title)
