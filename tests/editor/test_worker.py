"""The method beside the page: what it may read, what it is asked and in which order, and how its failures are said."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from queue import Queue
from typing import Any

import numpy as np
import pytest

from baselines.catalog import method_of
from kit1000.cli.scenes import SNAP
from kit1000.dataset.reader import Dataset
from kit1000.editor import worker
from kit1000.editor.hand import PLACE
from kit1000.editor.scene import EditedScene
from kit1000.editor.session import same_motion
from kit1000.editor.worker import Completion, Job, Method, Result, Worker, prepared, proposals_of
from kit1000.errors import InputError
from kit1000.known_shapes.predictor import FoundShape, FoundShapes
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor
from kit1000.predictor import PredictedMotion
from kit1000.values import Query, SceneShapes, TrueGeometry
from tests.samples.editing import desk, dragged, goal, off, scene_of

NEAR = Pose.from_rotvec((0.0, 0.0, 0.1), (0.004, -0.003, 0.0))
METHOD = Method(f"{__name__}:keep", Path(), "test-s0000", "ideal", False)


class Pool:
    """Stands for a process: answers each job at once, and dies of part 3."""

    _processes: dict[int, Any] | None = None

    def submit(self, call: Any, method: Method, *jobs: Job) -> Future[Any]:
        future: Future[Any] = Future()
        if not jobs or jobs[0].part == 3:
            future.set_exception(BrokenProcessPool())
        else:
            future.set_result(Result(jobs[0], []))
        return future

    def shutdown(self, wait: bool, cancel_futures: bool) -> None:
        assert cancel_futures
        assert not wait


def test_what_the_hand_asks_comes_first_then_the_part_in_the_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also what is asked before the work begins; of several guesses about a part the last alone."""
    monkeypatch.setattr(worker, "one_process", Pool)
    results: Queue[Result] = Queue()
    completions: Queue[Completion] = Queue()
    work = Worker(METHOD, (0, 1, 2, 3, 4))
    work.prefer(2)
    work.ask(1, Pose.identity())
    work.ask(1, NEAR)
    work.start(results.put, completions.put)
    assert completions.get(timeout=30) == Completion(None, "the method's process died")  # and the others are answered
    order = [results.get(timeout=30) for _ in range(6)]
    assert [result.job.part for result in order] == [1, 2, 0, 1, 3, 4]
    assert order[0].job.guess is NEAR
    assert all(result.job.guess is None for result in order[1:])
    assert [bool(result.failure) for result in order] == [False, False, False, False, True, False]
    work.ask(0, NEAR)
    assert results.get(timeout=30).job == Job(0, NEAR)
    work.close()
    work.ask(0, NEAR)
    assert results.empty()
    assert completions.empty()


def test_a_blind_session_opens_no_file_with_truth(mini: Path, tmp_path: Path) -> None:
    opened: list[str] = []
    watching = [True]

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if watching[0] and event == "open" and isinstance(arguments[0], str):
            opened.append(arguments[0])

    sys.addaudithook(hook)  # for the life of this process
    dataset = Dataset(mini)
    scene_id = dataset.split("test").scene_ids[0]
    scene = EditedScene.open(dataset, scene_id, "ideal", truth=False)
    for interface, body in (("scene", scene.parts[0]), ("hand", PLACE)):
        table = desk(scene, tmp_path / interface, interface=interface)  # type: ignore[arg-type]
        table.controller.command(f"select-{scene.parts[0] + 1}")
        dragged(table, body, scene.plates[0].point)
        table.controller.command("confirm")
        assert table.controller.space.session.edits[scene.parts[0]].confirmed
    method = Method(f"{__name__}:keep", mini, scene_id, "ideal", False)
    proposals_of(prepared(method), Job(scene.parts[0], NEAR))
    watching[0] = False
    inside = {Path(name).name for name in opened if str(mini) in name}
    assert any(name.endswith(".mcap") for name in inside)
    assert inside <= {"dataset.json", "0000.mcap"}


def keep(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    """A method of one's own: the guess as it is."""
    assert geometry is None
    assert query.guess is not None
    return PredictedMotion(query.guess, 0.25)


class Fussy:
    """A method that wants the truth."""

    uses_true_geometry = True

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset

    def propose(self, query: Query, geometry: TrueGeometry) -> list[PredictedMotion]:
        assert geometry.part.vertices.shape[1] == 3
        return [PredictedMotion(Pose.identity(), 0.5)]


class Knowing:
    """A method that reads shapes."""

    reads = "shapes"

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset

    def __call__(self, query: Query, shapes: SceneShapes) -> PredictedMotion:
        assert query.guess is not None
        return PredictedMotion(query.guess, 0.25 if shapes.parts else 0.0)

    def find(self, queries: Sequence[Query], shapes: SceneShapes) -> FoundShapes:
        kits = FoundShape("kits", shapes.assembly, ())
        return FoundShapes(kits, {query.part: FoundShape("p", shapes.assembly, ("?",)) for query in queries})


def test_a_method_that_reads_shapes_gets_those_of_the_user_or_of_the_dataset(mini: Path) -> None:
    scene, triangle = scene_of(mini), Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32))
    method = Method(f"{__name__}:Knowing", mini, scene.recorded.id, "ideal", False)
    for shapes in (None, SceneShapes(triangle, {"p": triangle})):
        prepared.cache_clear()
        made = prepared(replace(method, shapes=shapes))
        found = made.known
        assert found is not None
        assert {*found.parts} == {*made.queries}
        assert (found.kits.mesh is triangle) == (shapes is not None)
        assert proposals_of(made, Job(scene.parts[0], NEAR))[0].confidence == 0.25
    assert hash(replace(method, shapes=shapes)) == hash(method)  # one is prepared once
    prepared.cache_clear()


def test_any_predictor_snaps_by_the_protocol_alone(mini: Path) -> None:
    scene = scene_of(mini)
    method = Method(f"{__name__}:keep", mini, scene.recorded.id, "ideal", False)
    method.check()
    answer = proposals_of(prepared(method), Job(scene.parts[0], NEAR))
    assert same_motion(answer[0].goal_from_now, NEAR)
    assert answer[0].confidence == 0.25
    assert proposals_of(prepared(method), Job(scene.parts[0], None)) == []  # it needs a guess
    assert prepared(method).known is None  # and knows no shapes


def test_true_geometry_is_for_sessions_that_show_it(mini: Path) -> None:
    scene_id = scene_of(mini).recorded.id
    with pytest.raises(InputError, match="--truth"):
        prepared(Method(f"{__name__}:Fussy", mini, scene_id, "ideal", False))
    made = prepared(Method(f"{__name__}:Fussy", mini, scene_id, "ideal", True))
    assert proposals_of(made, Job(next(iter(made.queries)), None))[0].confidence == 0.5


def test_the_page_gives_the_answer_of_the_method(mini: Path) -> None:
    """The same guess by way of the page and of `baselines predict`."""
    scene = scene_of(mini)
    part = scene.parts[0]
    guess = off(goal(scene, part), scene.pivot(part), 0.2, (0.01, -0.006, 0.004))
    through_page = proposals_of(prepared(Method(SNAP, mini, scene.recorded.id, "ideal", False)), Job(part, guess))[0]
    predictor = make_predictor(method_of("registration"), scene.dataset, 0)
    predicted = predictor(replace(scene.queries[part], guess=guess), None)
    assert np.abs(through_page.goal_from_now.matrix() - predicted.goal_from_now.matrix()).max() < 1e-6
    assert abs(through_page.confidence - predicted.confidence) < 1e-6


@pytest.mark.parametrize("snap", ["nothing", "no.such:Thing", ":x", "math:", "..x:y"])
def test_a_method_that_is_none_is_refused(snap: str, mini: Path) -> None:
    with pytest.raises(InputError, match="--snap"):
        Method(snap, mini, "test-s0000", "ideal", False).check()
