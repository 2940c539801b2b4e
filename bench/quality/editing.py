"""Does the editing page keep what its method promises? A scripted hand edits scenes, beside the method alone.

    python bench/quality/editing.py data/kit1000 --scenes 30
    python bench/quality/editing.py data/kit1000 --scenes 30 --snap registration-completed

The hand puts each part up to 20 mm and 15 degrees off its goal, takes the fit that the page shows, and confirms. The
method alone corrects the recorded guesses about the same parts, up to 28 mm along each axis and 27.5 degrees off. The
rows are also a submission. Times of the page: a drag step with its ghost, and a lookup of what lies below the pointer.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from benchmark.measurements import Column, Measurement, estimate, rate
from kit1000.camera import look_at
from kit1000.cli.scenes import SNAP
from kit1000.dataset.reader import Dataset
from kit1000.editor.controller import Controller
from kit1000.editor.pointing import Eye
from kit1000.editor.records import EventLog, Header
from kit1000.editor.scene import EditedScene
from kit1000.editor.worker import AtOnce, Method, prepared
from kit1000.errors import Kit1000Error
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.pose import Pose
from kit1000.queries.guesses import draw_direction
from kit1000.queries.motions import apply_error
from kit1000.rng import stream
from kit1000.values import Query, Truth

HAND_OFFSET, HAND_ANGLE = 20e-3, float(np.radians(15))  # the largest errors of the scripted hand
EYE = Eye(look_at((0.0, -0.8, 0.7), (0.0, 0.0, 0.0)), float(np.radians(45)), 1.6)
STEPS = 20  # of a timed drag
SEED = 0
LEVELS = ((0.8, 1.01), (0.5, 0.8), (0.0, 0.5))  # of confidence
SENSOR, N = Column("sensor", "sensor"), Column("n", "n")
ERROR_COLUMNS = (
    SENSOR,
    Column("way", "motions"),
    N,
    Column("position", "position, mm", 2),
    Column("position_median", "median", 2),
    Column("rotation", "rotation, °", 2),
    Column("rotation_median", "median", 2),
    Column("seated", "seated, %", 1, True),
)
LEVEL_COLUMNS = (
    SENSOR,
    Column("level", "confidence"),
    N,
    Column("stated", "mean confidence, %", 0, True),
    Column("seated", "seated, %", 1, True),
)
TIME_COLUMNS = (
    SENSOR,
    Column("step", "step"),
    N,
    Column("ms", "mean, ms", 2),
    Column("median", "median", 2),
    Column("p95", "95th percentile", 2),
)


@dataclass(frozen=True)
class Editing:
    """Edit scenes by a script."""

    data: tyro.conf.Positional[Path]
    """Dataset folder, with ground truth: the script aims by it, the page does not see it."""
    scenes: int = 30
    """Number of scenes, the first ones of the split."""
    split: Literal["test", "val"] = "test"
    sensor: Literal["ideal", "d415"] | None = None
    """One sensor; both when absent."""
    snap: str = SNAP
    """Method that proposes: one of the catalog or module:Object."""
    submission: Path | None = None
    """Submission folder; a temporary one when absent."""
    out: Path | None = None
    """JSON file of the tables, such as results/editing.json."""


class Blank:
    """A stage that shows nothing."""

    def __getattr__(self, verb: str) -> object:
        return lambda *arguments, **options: None


@dataclass(frozen=True, eq=False)
class Edited:
    """One part, edited and predicted for."""

    truth: Truth
    hand: Pose
    taken: Pose
    alone: Pose
    confidence: float


def main(options: Editing) -> None:
    """Edit, measure, print."""
    dataset = Dataset(options.data)
    measurement = Measurement.begin(dataset)
    scene_ids = dataset.split(options.split).scene_ids[: options.scenes]
    title = f"Parts placed in {len(scene_ids)} scenes of {options.split}, snapped by `{options.snap}`"
    measurement.table("errors", title, *ERROR_COLUMNS)
    measurement.table("confidence", "Snapped parts by the confidence that the page states", *LEVEL_COLUMNS)
    measurement.table("times", "Wall time of a step of the page", *TIME_COLUMNS)
    for sensor in (options.sensor,) if options.sensor else ("ideal", "d415"):
        with tempfile.TemporaryDirectory() as temporary:
            folder, times = (options.submission or Path(temporary)) / sensor, ([], [])
            edited = [
                each
                for scene_id in scene_ids
                for each in _edited(dataset, scene_id, sensor, options.snap, folder, times)
            ]
        _add_errors(measurement, sensor, edited, dataset)
        _add_confidence(measurement, sensor, edited, dataset)
        for step, seconds in zip(("drag", "lookup"), times, strict=True):
            ms = 1e3 * np.array(seconds)
            row = {"ms": estimate(ms), "median": np.median(ms), "p95": np.quantile(ms, 0.95)}
            measurement.tables["times"].add(sensor=sensor, step=step, n=len(ms), **row)
    measurement.report(options.out)


def _add_errors(measurement: Measurement, sensor: str, edited: Sequence[Edited], dataset: Dataset) -> None:
    """Add the errors and seated shares of the hand, of the hand with the page, and of the method alone."""
    truths = [each.truth for each in edited]
    targets = Targets.of(truths, lambda part_id: dataset.geometry.part(part_id).mesh.vertices)
    clusters = [truth.assembly_id for truth in truths]
    for way, motions in (
        ("hand", [each.hand for each in edited]),
        ("hand, snapped", [each.taken for each in edited]),
        ("method alone, from recorded guesses", [each.alone for each in edited]),
    ):
        stacked = Pose.stack(motions)
        errors = pose_errors(stacked, targets)
        position = estimate(1e3 * errors.position, clusters)
        rotation = estimate(np.degrees(errors.rotation), clusters)
        medians = {"position_median": position["median"], "rotation_median": rotation["median"]}
        seated = rate(seatings(stacked, truths, dataset.geometry).seated)
        row = {"position": position, "rotation": rotation, "seated": seated} | medians
        measurement.tables["errors"].add(sensor=sensor, way=way, n=len(edited), **row)


def _add_confidence(measurement: Measurement, sensor: str, edited: Sequence[Edited], dataset: Dataset) -> None:
    """Add the seated share of snapped parts by LEVELS of stated confidence."""
    sure = np.array([each.confidence for each in edited])
    motions = Pose.stack([each.taken for each in edited])
    seated = seatings(motions, [each.truth for each in edited], dataset.geometry).seated
    for low, high in LEVELS:
        chosen = (sure >= low) & (sure < high)
        if chosen.any():
            row = {"stated": estimate(sure[chosen]), "seated": rate(seated[chosen])}
            level = f"{low:.1f} to {min(high, 1):.1f}"
            measurement.tables["confidence"].add(sensor=sensor, level=level, n=int(chosen.sum()), **row)


def _edited(
    dataset: Dataset, scene_id: str, sensor: str, snap: str, out: Path, times: tuple[list[float], list[float]]
) -> Iterator[Edited]:
    """All parts of a scene, one after another."""
    scene = EditedScene.open(dataset, scene_id, sensor, truth=False)
    method = Method(snap, dataset.root, scene_id, sensor, truth=False)
    asker = AtOnce(method)
    log = EventLog(out, Header(dataset.id, scene_id, sensor, False, snap, "scene"))
    controller = Controller(scene, Blank(), log, asker)  # type: ignore[arg-type]
    asker.start(controller.received)
    recorded = dataset.recorded_scene(scene_id, truth=True)
    track = "snap" if sensor == "ideal" else f"snap-{sensor}"
    for query in recorded.queries:
        if query.track != track or query.part not in scene.parts:
            continue
        truth = recorded.truth_of(query.id)
        hand = _hand(query, truth.goal_drawn)
        _time(controller, query.part, hand, times)
        controller.place(query.part, hand, "script")
        controller.command("take")
        controller.command("confirm")
        edit = controller.space.session.edits[query.part]
        alone = prepared(method).predictor(query, None).goal_from_now
        yield Edited(truth, hand, edit.goal_from_now, alone, edit.confidence)


def _hand(query: Query, goal: Pose) -> Pose:
    """The goal, off by up to HAND_OFFSET in any direction and HAND_ANGLE about any axis."""
    rng = stream(SEED, "hand", query.id)
    offset = draw_direction(rng) * rng.uniform(0, HAND_OFFSET)
    return apply_error(goal, query.pivot, offset, draw_direction(rng) * rng.uniform(0, HAND_ANGLE))


def _time(controller: Controller, part: int, hand: Pose, times: tuple[list[float], list[float]]) -> None:
    """Time the steps of a drag to the hand's place and the lookups below it; then take the part back."""
    space = controller.space
    grabbed, target = space.scene.pivot(part), hand.apply(space.scene.pivot(part))
    start, end = EYE.screen(grabbed), EYE.screen(target)
    controller.grab(part, EYE, start, grabbed)
    for k in range(1, STEPS + 1):
        screen = tuple(a + (b - a) * k / STEPS for a, b in zip(start, end, strict=True))
        for step, values in ((controller.drag, times[0]), (lambda at: space.pointing.support(EYE, at), times[1])):
            began = time.perf_counter()
            step(screen)  # type: ignore[arg-type]
            values.append(time.perf_counter() - began)
    controller.drag(start)
    controller.release()
    controller.command("undo")


if __name__ == "__main__":
    try:
        main(tyro.cli(Editing))
    except Kit1000Error as error:
        raise SystemExit(f"editing: {error}") from error
