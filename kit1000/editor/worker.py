"""A method in a process of its own, which proposes fits while the page stays at hand.

Jobs wait in this order: the latest guess of the hand, one a part; then the parts for which nothing is known yet, the
one in the hand first. A job that runs is not interrupted; its result is dropped if the hand has moved on.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from kit1000.dataset.reader import Dataset
from kit1000.editor.proposals import Proposal
from kit1000.editor.scene import EditedScene
from kit1000.errors import InputError, Kit1000Error
from kit1000.parallel import start_worker
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor, method_of
from kit1000.predictor import to_prediction
from kit1000.values import Query, SceneShapes

if TYPE_CHECKING:
    from kit1000.known_shapes.predictor import FoundShapes

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Method:
    """What the worker runs, on which scene."""

    snap: str
    """A method of the catalog, or `module:Object`."""
    root: Path
    """Folder of the dataset."""
    scene_id: str
    sensor: str
    truth: bool
    """Whether true geometry may be read."""
    shapes: SceneShapes | None = field(default=None, compare=False)
    """Those that the user gives to a method that reads them."""

    def check(self) -> None:
        """Raise InputError if there is no such method or module. The worker imports it: that takes seconds."""
        if ":" not in self.snap:
            try:
                method_of(self.snap)
            except InputError as error:
                raise InputError(f"--snap {self.snap}: {error}, or none") from None
            return
        module, _, name = self.snap.partition(":")
        try:
            found = bool(name) and find_spec(module) is not None
        except (ImportError, ValueError):
            found = False
        if not found:
            raise InputError(f"--snap {self.snap}: expected a method of the catalog, module:Object, or none")


class Job(NamedTuple):
    """A question to the method."""

    part: int
    guess: Pose | None  # None: all fits, without one


class Result(NamedTuple):
    """What the method proposes."""

    job: Job
    proposals: list[Proposal]
    failure: str = ""  # why there are none


class Completion(NamedTuple):
    """The known shapes of the scene."""

    shapes: FoundShapes | None  # where they were found; None if the method knows none
    failure: str = ""  # why there are none although there should be some


class Worker:
    """Runs jobs one after another in one process, and hands each result on from a thread of its own."""

    def __init__(self, method: Method, parts: Iterable[int]) -> None:
        """Jobs wait until it is started. parts: indices, in the order in which fits are sought without a guess."""
        self._method = method
        self._first: list[int] = list(parts)
        self._guesses: dict[int, Pose] = {}
        self._changed, self._stopping = threading.Condition(), False
        self._executor = one_process()

    def start(self, done: Callable[[Result], None], completed: Callable[[Completion], None] | None = None) -> None:
        """Begin with the jobs. done: called with each result; completed: once before, with the known shapes."""
        threading.Thread(target=self._run, args=(done, completed), daemon=True).start()

    def ask(self, part: int, guess: Pose) -> None:
        """Ask for the answer to a guess; an earlier one about the part that still waits is forgotten."""
        with self._changed:
            self._guesses.pop(part, None)
            self._guesses[part] = guess
            self._changed.notify()

    def prefer(self, part: int) -> None:
        """The part in the hand: its fits come first."""
        with self._changed:
            self._first.sort(key=lambda other: other != part)

    def close(self) -> None:
        """End the process, whatever it does."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        for process in list((self._executor._processes or {}).values()):
            process.terminate()
        self._executor.shutdown(wait=False, cancel_futures=True)

    def _run(self, done: Callable[[Result], None], completed: Callable[[Completion], None] | None) -> None:
        if completed is not None:
            completion = self._answer(_complete, lambda failure: Completion(None, failure))
            if completion.shapes is not None:
                with self._changed:
                    self._first += sorted(completion.shapes.parts.keys() - set(self._first))
            if not self._stopping:
                completed(completion)
        while (job := self._next()) is not None:
            result = self._answer(_propose, partial(Result, job, []), job)
            if not self._stopping:
                done(result)

    def _answer(self, call: Callable[..., Answer], failed: Callable[[str], Answer], *job: Job) -> Answer:
        """The answer of the method's process, or what `failed` makes of the reason why there is none."""
        try:
            return self._executor.submit(call, self._method, *job).result()
        except BrokenProcessPool:
            self._executor = one_process()
            return failed("the method's process died")
        except Exception as error:
            return failed(_line(error))

    def _next(self) -> Job | None:
        """The next job, waited for; None at the end."""
        with self._changed:
            while not (self._stopping or self._guesses or self._first):
                self._changed.wait()
            if self._stopping:
                return None
            if self._guesses:
                return Job(*self._guesses.popitem())
            return Job(self._first.pop(0), None)


def one_process() -> ProcessPoolExecutor:
    """A new process for the method."""
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)


def _begin() -> None:
    start_worker(os.getppid())
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page, which ends this process


def _propose(method: Method, job: Job) -> Result:
    """Answer a job; an error becomes a line for the page."""
    try:
        return Result(job, proposals_of(prepared(method), job))
    except Exception as error:
        return Result(job, [], _line(error))


def _complete(method: Method) -> Completion:
    """The known shapes; an error becomes a line for the page."""
    try:
        return Completion(prepared(method).known)
    except Exception as error:
        return Completion(None, _line(error))


@dataclass(frozen=True, eq=False)
class Prepared:
    """A method, made, and the scene that it is asked about."""

    scene: EditedScene
    predictor: Any
    uses_truth: bool  # whether the predictor gets the true geometry
    shapes: SceneShapes | None = None  # the shapes of the scene, for a predictor that reads them

    @cached_property
    def known(self) -> FoundShapes | None:
        """The known shapes where the method finds them, by its `find`; None if it knows none."""
        if self.shapes is None or not hasattr(self.predictor, "find"):
            return None
        return self.predictor.find(tuple(self.scene.queries.values()), self.shapes)

    @cached_property
    def queries(self) -> dict[int, Query]:
        """A query about each part that can be edited, by index; also of known shapes that no mask shows."""
        return self.scene.queries if self.known is None else self.scene.knowing(self.known).queries


@lru_cache(maxsize=1)
def prepared(method: Method) -> Prepared:
    """Made once in each process."""
    dataset = Dataset(method.root)
    scene = EditedScene.open(dataset, method.scene_id, method.sensor, method.truth)
    described = method_of(method.snap)
    predictor = make_predictor(described, dataset, 0)
    uses_truth = bool(getattr(predictor, "uses_true_geometry", False))
    if uses_truth and not method.truth:
        raise InputError(f"--snap {method.snap}: needs the true geometry, which only --truth shows")
    shapes = _shapes(method, dataset) if described.reads == "shapes" else None
    return Prepared(scene, predictor, uses_truth, shapes)


def _shapes(method: Method, dataset: Dataset) -> SceneShapes:
    """The shapes that the user gives, or those of the dataset."""
    if method.shapes is not None:
        return method.shapes
    try:
        return dataset.recorded_scene(method.scene_id, truth=True).shapes
    except InputError as error:
        raise InputError(f"--snap {method.snap}: needs --shapes FOLDER, or --kit FILE --part FILE ({error})") from None


def proposals_of(made: Prepared, job: Job) -> list[Proposal]:
    """All fits of a part; of a method that proposes none, its prediction if there is a guess."""
    query, predictor = replace(made.queries[job.part], guess=job.guess), made.predictor
    dataset = made.scene.dataset
    true = dataset.geometry.true_geometry(dataset.truth_of(query)) if made.uses_truth else None
    geometry = true if made.shapes is None else made.shapes
    if hasattr(predictor, "propose"):
        motions = list(predictor.propose(query, geometry))
    else:
        motions = [] if job.guess is None else [predictor(query, geometry)]
    predictions = (to_prediction(query, motion, 0.0) for motion in motions)
    return [Proposal(each.goal_from_now, each.confidence) for each in predictions]


def _line(error: BaseException) -> str:
    """An error in one line."""
    message = " ".join(str(error).split()) or "no message"
    return message if isinstance(error, Kit1000Error) else f"{type(error).__name__}: {message}"
