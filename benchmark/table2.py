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
from kit1000.metrics.pose_errors import nearest_goal_motions
from kit1000.metrics.seating import GeometrySource
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
SEATS, WRONG_PLATE, ROTATION, POSITION = "nothing", "wrong plate", "rotation", "position"
EITHER, BOTH = "rotation or position", "both"
KINDS = (SEATS, WRONG_PLATE, ROTATION, POSITION, EITHER, BOTH)
"""What is wrong with a motion: nothing, it passes the seating test; the part is nearer to another plate than to its
own; the motion passes with the rotation of the nearest goal; it passes with that goal's position; it passes with either
of them; it passes with neither alone."""

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
    agreement: dict[str, int]
    """Numbers of picked parts that are seated by robot and test, by the robot alone, by the test alone, by neither."""
    position_mm: float | None
    """Median error of all predictions."""
    rotation_deg: float | None
    seconds: float | None
    """[s] median time of the robot a picked part."""
    outcomes: dict[str, int]
    """Number of queries by outcome."""
    failures: dict[str, int]
    """Number of the possible ones that the robot does not seat, by the kind of failure (`failure_kinds`)."""
    against: dict[str, int]
    """Losses: possible ones that the row before seats and this row does not. Wins: the reverse."""
    queries: list[dict[str, Any]]
    """For each query its id, outcome and detail, the kind of failure of the motion, and the errors [mm], [degrees]."""


@dataclass(frozen=True)
class _Task:
    """The queries of a chain, and how the robot carries them out."""

    dataset: Dataset
    queries: Sequence[Query]
    truths: Mapping[str, Truth]
    """By id of the query."""
    sensor: str
    """The sensor by which the robot grasps."""
    seed: int
    """Seed of the path planner."""


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
    seed: int = 0,
    find_masks: MaskFinder | None = None,
) -> list[ChainRow]:
    """The rows of the chain, the true motions first, then one for each submission.

    Args:
        root: dataset folder with ground truth.
        submissions: submission folders or predictions files by label.
        track: track of the queries; the robot grasps by its sensor.
        split: split of the queries.
        scenes: number of scenes, the first ones; all if None.
        seed: seed of the path planner.
        find_masks: finds the masks for the robot in rows of submissions that state predicted masks; the robot uses the
            recorded masks if None, and in all other rows.
    """
    if track not in TRACKS:
        raise InputError(f"--track {track}: there are {', '.join(TRACKS)}")
    task = _read_task(Dataset(root), track, split, scenes, seed)
    predicted = {label: _motions_of(Path(path), task.queries) for label, path in submissions.items()}
    cases = _execute(task, TRUTH, {query_id: truth.goal_drawn for query_id, truth in task.truths.items()})
    possible = {case.query.id for case in cases if case.run.outcome not in (NO_SEAL, NOT_FROM_ABOVE)}
    rows = [_row(task, TRUTH, cases, possible, possible)]
    for label, motions in predicted.items():
        before = {case.query.id for case in cases if case.run.outcome == SEATED}
        find = _mask_finder(task, Path(submissions[label]), find_masks)
        cases = _execute(task, label, motions, find)
        rows.append(_row(task, label, cases, possible, before))
    return rows


def _read_task(dataset: Dataset, track: str, split: str, scenes: int | None, seed: int) -> _Task:
    queries = list(dataset.split(split).queries(track))
    kept = set(list(dict.fromkeys(query.scene_id for query in queries))[:scenes])
    queries = [query for query in queries if query.scene_id in kept]
    if not queries:
        raise InputError(f"{dataset.root}: no query of track {track} in split {split}")
    truths = {query.id: dataset.truth_of(query) for query in queries}
    return _Task(dataset, queries, truths, TRACKS[track].sensor, seed)


def _motions_of(path: Path, queries: Sequence[Query]) -> dict[str, Pose]:
    """The predicted motions of queries by id; without a prediction the part stays."""
    predictions = read_predictions(path / FILE if path.is_dir() else path)
    rows = {query.id: predictions.row(query.id) for query in queries}
    if all(row is None for row in rows.values()):
        raise InputError(f"{path}: no prediction for any of {len(rows)} queries, such as {queries[0].id}")
    return {i: Pose.identity() if row is None else predictions.motions[row] for i, row in rows.items()}


def _mask_finder(task: _Task, path: Path, find: MaskFinder | None) -> Callable[[Query], Query] | None:
    """Finds masks as a submission that states predicted masks did, by the facts of the sensor; None for others."""
    if find is None or not path.is_dir() or read_manifest(path / MANIFEST, path).masks != "predicted":
        return None
    summary = task.dataset.summary
    return lambda query: find(query, summary["config"]["scale"], sensor_of(summary, task.sensor, query.scene_id))


def _execute(
    task: _Task, label: str, motions: Mapping[str, Pose], find: Callable[[Query], Query] | None = None
) -> list[_Case]:
    """Let the robot carry out all motions of a row, scene by scene."""
    cases = []
    for scene_id in tqdm(dict.fromkeys(query.scene_id for query in task.queries), desc=label, unit="", disable=None):
        own = {query.part: query for query in task.queries if query.scene_id == scene_id}
        scene = task.dataset.recorded_scene(scene_id, truth=True)
        images = None if find is None else {part: find(query).image for part, query in own.items()}
        moves = {part: motions[query.id] for part, query in own.items()}
        for run in run_scene(scene, moves, task.sensor, task.seed, images).parts:
            query = own[run.part]
            cases.append(_Case(query, task.truths[query.id], motions[query.id], run))
    return cases


def _row(task: _Task, label: str, cases: Sequence[_Case], possible: set[str], before: set[str]) -> ChainRow:
    """A row of the chain. possible, before: ids of the queries that can be seated, and that the row before seats."""
    geometry = task.dataset.geometry
    truths, motions = [case.truth for case in cases], Pose.stack([case.motion for case in cases])
    targets = Targets.of(truths, lambda part_id: hull_points(geometry, part_id))
    errors, kinds = pose_errors(motions, targets), np.array(failure_kinds(motions, truths, targets, geometry))
    position_mm, rotation_deg = errors.position * 1e3, np.degrees(errors.rotation)
    among = np.array([case.query.id in possible for case in cases])
    earlier = np.array([case.query.id in before for case in cases])
    picked = np.array([bool(case.run.physics) for case in cases])
    seated, tested = np.array([case.run.outcome == SEATED for case in cases]), kinds == SEATS
    clusters = np.array([truth.assembly_id for truth in truths])[among]
    seconds = [case.run.seconds for case in cases if case.run.physics]
    return ChainRow(
        label=label,
        n=len(cases),
        possible=int(among.sum()),
        seated=float(seated[among].mean()) if among.any() else 0.0,
        interval=rate_interval(seated[among], [clusters]),
        tested=float(tested[among].mean()) if among.any() else 0.0,
        agreement=_agreement(seated[picked], tested[picked]),
        position_mm=float(np.median(errors.position) * 1e3),
        rotation_deg=float(np.degrees(np.median(errors.rotation))),
        seconds=float(np.median(seconds)) if seconds else None,
        outcomes=outcome_counts(case.run for case in cases),
        failures={kind: int((kinds[among & ~seated] == kind).sum()) for kind in KINDS},
        against={"losses": int((earlier & ~seated)[among].sum()), "wins": int((seated & ~earlier)[among].sum())},
        queries=[
            {
                "query": case.query.id,
                "outcome": case.run.outcome,
                "detail": case.run.detail,
                "motion": str(kinds[i]),
                "position_mm": round(float(position_mm[i]), 3),
                "rotation_deg": round(float(rotation_deg[i]), 3),
            }
            for i, case in enumerate(cases)
        ],
    )


def _agreement(seated: np.ndarray, tested: np.ndarray) -> dict[str, int]:
    """How often robot and test, (n,) bool each, seat a part."""
    counts = {
        "both": seated & tested,
        "robot alone": seated & ~tested,
        "test alone": ~seated & tested,
        "neither": ~seated & ~tested,
    }
    return {name: int(which.sum()) for name, which in counts.items()}


def failure_kinds(motions: Pose, truths: Sequence[Truth], targets: Targets, geometry: GeometrySource) -> list[str]:
    """One of KINDS for each of n motions goal_from_now (n,). targets: those of the same truths."""
    anchors = targets.anchors
    goals = nearest_goal_motions(targets, pose_errors(motions, targets))
    turned = _about(goals, anchors, motions.apply(anchors))
    shifted = _about(motions, anchors, goals.apply(anchors))
    passed, with_rotation, with_position = (
        seatings(tried, truths, geometry).seated for tried in (motions, turned, shifted)
    )
    kinds = []
    for i, truth in enumerate(truths):
        if passed[i]:
            kinds.append(SEATS)
        elif not _is_at_own_plate(motions[i].apply(truth.anchor), truth, geometry):
            kinds.append(WRONG_PLATE)
        else:
            found = {(True, True): EITHER, (True, False): ROTATION, (False, True): POSITION, (False, False): BOTH}
            kinds.append(found[bool(with_rotation[i]), bool(with_position[i])])
    return kinds


def _about(motions: Pose, points: np.ndarray, images: np.ndarray) -> Pose:
    """The rotations of motions (n,) with the translations that take points (n, 3) [m] to images (n, 3) [m]."""
    return Pose(motions.wxyz, images - motions.rotate(points))


def _is_at_own_plate(middle: np.ndarray, truth: Truth, geometry: GeometrySource) -> bool:
    """Whether the middle (3,) [m] of a moved part is nearest to the plate of its own slot."""
    mounts = geometry.assembly(truth.assembly_id).mounts
    own = next(i for i, mount in enumerate(mounts) if mount.kit.id == truth.part_id)
    in_assembly = mounts[own].assembly_from_kit.apply(truth.world_from_kit.inverse().apply(middle))
    distances = [float(np.sqrt(((mount.assembly_from_kit.xyz - in_assembly) ** 2).sum())) for mount in mounts]
    return int(np.argmin(distances)) == own


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
