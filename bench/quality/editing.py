"""Does the editing page keep what its method promises? A scripted hand edits scenes, beside the method alone.

    python bench/quality/editing.py data/kit1000 --scenes 30
    python bench/quality/editing.py data/kit1000 --scenes 30 --sensor d415
    python bench/quality/editing.py data/kit1000 --snap kit1000.registration.proposals:CompletingRegistration

The hand puts each part up to 20 mm and 15 degrees off its goal, takes the fit that the page shows, and confirms. The
method alone corrects the recorded guesses about the same parts, up to 28 mm along each axis and 27.5 degrees off. The
rows are also a submission, in the folder of --out. Times of the page: a drag step with its ghost, and a lookup.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from benchmark.intervals import wilson_interval
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


@dataclass(frozen=True)
class Editing:
    """Edit scenes by a script."""

    data: tyro.conf.Positional[Path]
    """Dataset folder, with ground truth: the script aims by it, the page does not see it."""
    scenes: int = 30
    """The first so many scenes of the split."""
    split: Literal["test", "val"] = "test"
    sensor: Literal["ideal", "d415"] = "ideal"
    snap: str = SNAP
    """Method that proposes, `module:Object`."""
    out: Path | None = None
    """Submission folder; a temporary one when absent."""


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
    with tempfile.TemporaryDirectory() as temporary:
        out, times = options.out or Path(temporary), ([], [])
        scene_ids = dataset.split(options.split).scene_ids[: options.scenes]
        edited = [each for scene_id in scene_ids for each in _edited(dataset, scene_id, options, out, times)]
    print(f"{dataset.root.name} {options.split} {options.sensor}: {len(scene_ids)} scenes, {len(edited)} parts")
    print(f"  {'':14} {'position mm':>12} {'median':>7} {'rotation':>9} {'median':>7} {'seated':>7}   95 %")
    truths = [each.truth for each in edited]
    for name, motions in (
        ("hand", [each.hand for each in edited]),
        ("hand + snap", [each.taken for each in edited]),
        ("method alone", [each.alone for each in edited]),
    ):
        print(f"  {name:14} {_row(Pose.stack(motions), truths, dataset)}")
    sure = np.array([each.confidence for each in edited])
    seated = seatings(Pose.stack([each.taken for each in edited]), truths, dataset.geometry).seated
    for low, high in ((0.8, 1.01), (0.5, 0.8), (0.0, 0.5)):
        chosen = (sure >= low) & (sure < high)
        stated, share = (float(values[chosen].mean()) if chosen.any() else np.nan for values in (sure, seated))
        span = f"{low:.1f} to {min(high, 1):.1f}"
        print(f"  confidence {span}: {chosen.sum():3} parts, stated {stated:.2f}, seated {share:.2f}")
    steps, lookups = (1e3 * np.array(each) for each in times)
    print(f"  drag step ms: median {np.median(steps):.2f}, p95 {np.quantile(steps, 0.95):.2f} (n {len(steps)})")
    print(f"  lookup ms:    median {np.median(lookups):.2f}, p95 {np.quantile(lookups, 0.95):.2f} (n {len(lookups)})")


def _edited(
    dataset: Dataset, scene_id: str, options: Editing, out: Path, times: tuple[list[float], list[float]]
) -> Iterator[Edited]:
    """All parts of a scene, one after another."""
    sensor = options.sensor
    scene = EditedScene.open(dataset, scene_id, sensor, truth=False)
    method = Method(options.snap, dataset.root, scene_id, sensor, truth=False)
    asker = AtOnce(method)
    log = EventLog(out, Header(dataset.id, scene_id, sensor, False, options.snap, "scene"))
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


def _row(motions: Pose, truths: list[Truth], dataset: Dataset) -> str:
    """Errors and the seated share with its Wilson interval, as text."""
    errors = pose_errors(motions, Targets.of(truths, lambda part_id: dataset.geometry.part(part_id).mesh.vertices))
    seated = seatings(motions, truths, dataset.geometry).seated
    position, rotation = 1e3 * errors.position, np.degrees(errors.rotation)
    low, high = wilson_interval(float(seated.mean()), len(seated))
    return (
        f"{position.mean():12.2f} {np.median(position):7.2f} {rotation.mean():8.2f}° {np.median(rotation):6.2f}°"
        f" {seated.mean():7.3f}   {low:.3f} to {high:.3f}"
    )


if __name__ == "__main__":
    try:
        main(tyro.cli(Editing))
    except Kit1000Error as error:
        raise SystemExit(f"editing: {error}") from error
