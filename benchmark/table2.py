"""Table II: what a whole system reaches, from the image to the part in its slot, stage by stage.

A row of the chain is a submission; its label says which of its stages read the truth. The robot carries out its
predictions (`kit1000.planner`), and the seating test evaluates the same predictions. If a submission predicts its
masks, the robot can find the parts by predicted masks too. Components, such as segmentation and completion, are
measured by the programs of bench/; their numbers come as JSON files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from tqdm import tqdm

from benchmark.intervals import rate_interval
from benchmark.measurements import Column, Measurement
from benchmark.queries import hull_points
from benchmark.report import Grid, json_text
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import read_json, write_own
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.perception.sensor_facts import SensorFacts, sensor_of
from kit1000.planner.execute import NO_SEAL, NOT_FROM_ABOVE, SEATED, PartRun, run_scene
from kit1000.planner.runs import outcome_counts
from kit1000.pose import Pose
from kit1000.predictor import resolved
from kit1000.queries.tracks import TRACKS
from kit1000.submission.manifest import FILE as MANIFEST
from kit1000.submission.manifest import read_manifest
from kit1000.submission.predictions import FILE, read_predictions
from kit1000.values import Query, Truth

FIND_MASKS = "kit1000.perception.segmentation.predicted_masks:with_predicted_masks"  # by name: it loads networks
MaskFinder = Callable[[Query, float, SensorFacts], Query]
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
"""Measures and values that the paper prints, each with a remark."""


@dataclass(frozen=True)
class ChainRow:
    """A row of the chain: n queries of one track, carried out by the robot and evaluated by the seating test."""

    label: str
    n: int
    possible: int
    """Number of queries whose part the robot can pick: it lies right side up and has a spot for the suction cup."""
    seated: float
    """Share of the possible ones that the robot seats."""
    interval: tuple[float, float]
    """95 % interval of the share."""
    tested: float
    """Share of the possible ones that the seating test passes."""
    position_mm: float | None
    """Median error of all predictions."""
    rotation_deg: float | None
    seconds: float | None
    """[s] median time of the robot a picked part."""
    outcomes: dict[str, int]
    """Number of queries by outcome."""
    queries: list[dict[str, Any]]
    """For each query its id, outcome and detail, whether the test passes the motion, and the errors [mm], [degrees]."""


@dataclass(frozen=True)
class _Case:
    """A query with its truth, its predicted motion, and the result of the robot."""

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
    find_masks: MaskFinder | None = None,
) -> list[ChainRow]:
    """The rows of the chain, the true motions first, then one for each submission.

    Args:
        root: dataset folder with ground truth.
        submissions: submission folders or predictions files by label.
        track: track of the queries; the robot grasps by its sensor.
        split: split of the queries.
        scenes: number of scenes, the first ones; all if None.
        find_masks: finds the masks for the robot in rows of submissions that state predicted masks; the robot uses the
            recorded masks if None, and in all other rows.
    """
    if track not in TRACKS:
        raise InputError(f"--track {track}: there are {', '.join(TRACKS)}")
    dataset = Dataset(root)
    queries = list(dataset.split(split).queries(track))
    kept = set(list(dict.fromkeys(query.scene_id for query in queries))[:scenes])
    queries = [query for query in queries if query.scene_id in kept]
    if not queries:
        raise InputError(f"{dataset.root}: no query of track {track} in split {split}")
    predicted = {label: _motions_of(Path(path), queries) for label, path in submissions.items()}
    cases = _execute(dataset, queries, TRUTH, {query.id: dataset.truth_of(query).goal_drawn for query in queries})
    possible = {case.query.id for case in cases if case.run.outcome not in (NO_SEAL, NOT_FROM_ABOVE)}
    rows = [_row(dataset, TRUTH, cases, possible)]
    for label, motions in predicted.items():
        folder = Path(submissions[label])
        predicts_masks = folder.is_dir() and read_manifest(folder / MANIFEST, folder).masks == "predicted"
        find = find_masks if predicts_masks else None
        rows.append(_row(dataset, label, _execute(dataset, queries, label, motions, find), possible))
    return rows


def _motions_of(path: Path, queries: Sequence[Query]) -> dict[str, Pose]:
    """The predicted motions of queries by id; without a prediction the part stays."""
    predictions = read_predictions(path / FILE if path.is_dir() else path)
    rows = {query.id: predictions.row(query.id) for query in queries}
    if all(row is None for row in rows.values()):
        raise InputError(f"{path}: no prediction for any of {len(rows)} queries, such as {queries[0].id}")
    return {i: Pose.identity() if row is None else predictions.motions[row] for i, row in rows.items()}


def _execute(
    dataset: Dataset,
    queries: Sequence[Query],
    label: str,
    motions: Mapping[str, Pose],
    find_masks: MaskFinder | None = None,
) -> list[_Case]:
    """Let the robot carry out all motions of a row, scene by scene."""
    cases = []
    scale, sensor = dataset.summary["config"]["scale"], queries[0].sensor
    for scene_id in tqdm(dict.fromkeys(query.scene_id for query in queries), desc=label, unit="", disable=None):
        own = {query.part: query for query in queries if query.scene_id == scene_id}
        images = None
        if find_masks is not None:
            facts = sensor_of(dataset.summary, sensor, scene_id)
            images = {part: find_masks(query, scale, facts).image for part, query in own.items()}
        moves = {part: motions[query.id] for part, query in own.items()}
        scene = dataset.recorded_scene(scene_id, truth=True)
        for run in run_scene(scene, moves, sensor, images=images).parts:
            query = own[run.part]
            cases.append(_Case(query, scene.truth_of(query.id), motions[query.id], run))
    return cases


def _row(dataset: Dataset, label: str, cases: Sequence[_Case], possible: set[str]) -> ChainRow:
    """A row of the chain. possible: ids of the queries whose part the robot can pick."""
    truths, motions = [case.truth for case in cases], Pose.stack([case.motion for case in cases])
    errors = pose_errors(motions, Targets.of(truths, lambda part_id: hull_points(dataset.geometry, part_id)))
    position_mm, rotation_deg = errors.position * 1e3, np.degrees(errors.rotation)
    tested = seatings(motions, truths, dataset.geometry).seated
    among = np.array([case.query.id in possible for case in cases])
    seated = np.array([case.run.outcome == SEATED for case in cases])
    clusters = np.array([truth.assembly_id for truth in truths])[among]
    seconds = [case.run.seconds for case in cases if case.run.physics]
    return ChainRow(
        label=label,
        n=len(cases),
        possible=int(among.sum()),
        seated=float(seated[among].mean()) if among.any() else 0.0,
        interval=rate_interval(seated[among], [clusters]),
        tested=float(tested[among].mean()) if among.any() else 0.0,
        position_mm=float(np.median(position_mm)),
        rotation_deg=float(np.median(rotation_deg)),
        seconds=float(np.median(seconds)) if seconds else None,
        outcomes=outcome_counts(case.run for case in cases),
        queries=[
            {
                "query": case.query.id,
                "outcome": case.run.outcome,
                "detail": case.run.detail,
                "tested": bool(tested[i]),
                "position_mm": round(float(position_mm[i]), 3),
                "rotation_deg": round(float(rotation_deg[i]), 3),
            }
            for i, case in enumerate(cases)
        ],
    )


def read_components(path: Path) -> list[dict[str, Any]]:
    """The rows of a file of component measures: a JSON list of objects with the keys COMPONENT_KEYS."""
    rows = read_json(path)
    if not isinstance(rows, list) or any(not isinstance(row, dict) or set(row) != COMPONENT_KEYS for row in rows):
        keys = ", ".join(sorted(COMPONENT_KEYS))
        raise InputError(f"{path}: expected a JSON list of objects with the keys {keys}")
    return rows


def measured(
    rows: Sequence[ChainRow], components: Sequence[Mapping[str, Any]], dataset: Dataset, track: str
) -> Measurement:
    """The tables of chain and components with their setting."""
    measurement = Measurement.begin(dataset)
    title = f"Preset {dataset.summary['preset']}, track `{track}`: parts seated by the robot, and by the seating test"
    table = measurement.table("chain", title, *CHAIN_COLUMNS)
    for row in rows:
        seated = {"n": row.possible, "rate": row.seated, "ci95": list(row.interval)}
        medians = {"position": row.position_mm, "rotation": row.rotation_deg, "seconds": row.seconds}
        table.add(row=row.label, n=row.n, possible=row.possible, seated=seated, tested=row.tested, **medians)
    outcomes = [Column("row", "chain"), *(Column(key, key) for key in rows[0].outcomes)]
    counts = measurement.table("outcomes", "Queries by outcome", *outcomes)
    for row in rows:
        counts.add(row=row.label, **row.outcomes)
    stages = measurement.table("components", "Single stages", *COMPONENT_COLUMNS)
    for part in components:
        value = {"n": part["n"], "mean": part["value"], "ci95": part["interval"]}
        stages.add(**{key: part[key] for key in ("component", "label", "measure", "n")}, value=value)
    return measurement


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
        raise InputError("submissions: expected different names, and none called truth, which is the first row anyway")
    find_masks = resolved(FIND_MASKS) if masks == "predicted" else None
    rows = chain(data, labelled, track, split, scenes, find_masks=find_masks)
    parts = [] if components is None else read_components(components)
    dataset = Dataset(data)
    measurement = measured(rows, parts, dataset, track)
    if out is not None:
        details = {"track": track, "split": split, "chain": list(map(asdict, rows)), "components": parts}
        write_own(out, json_text({**measurement.stored(), **details}).encode())
    title = f"Preset {dataset.summary['preset']}, dataset {dataset.id}, track {track}, split {split}."
    tables = [table.markdown() for table in measurement.tables.values() if table.rows]
    paper = Grid(("the paper", "printed", "remark"), PAPER, (True, False, True)).markdown()
    return "\n\n".join([title, *tables, paper])
