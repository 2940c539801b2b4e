"""A method in a process of its own, which proposes fits while the page stays at hand.

Jobs wait in this order: the latest guess of the hand, one a part; then the parts for which nothing is known yet, the
one in the hand first. A job that runs is not interrupted; its result is dropped if the hand has moved on.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from kit1000.dataset.reader import Dataset
from kit1000.editor.proposals import Proposal
from kit1000.engines.processes import start_worker
from kit1000.errors import InputError, Kit1000Error
from kit1000.pose import Pose
from kit1000.predictor import predictor_of, to_prediction
from kit1000.values import Query


@dataclass(frozen=True)
class Method:
    """What the worker runs, on which scene."""

    snap: str
    """`module:Object`"""
    root: Path
    """Of the dataset."""
    scene_id: str
    sensor: str
    truth: bool
    """Whether true geometry may be read."""

    def check(self) -> None:
        """Raise InputError where there is no such module. It is imported by the worker: that takes seconds."""
        module, colon, name = self.snap.partition(":")
        try:
            found = bool(colon and name) and find_spec(module) is not None
        except (ImportError, ValueError):
            found = False
        if not found:
            raise InputError(f"--snap {self.snap}: expected module:Object that Python can import, or none")


class Job(NamedTuple):
    """A question to the method."""

    part: int
    guess: Pose | None
    """None: all fits, without one."""


class Result(NamedTuple):
    """What the method proposes."""

    job: Job
    proposals: list[Proposal]
    failure: str = ""
    """Why there are none."""


class Worker:
    """Runs jobs one after another in one process, and hands each result on from a thread of its own."""

    def __init__(self, method: Method, parts: Iterable[int], done: Callable[[Result], None]) -> None:
        """Start with the jobs without a guess.

        Args:
            method: what runs.
            parts: indices, in order.
            done: called with each result.
        """
        self._method, self._done = method, done
        self._first: list[int] = list(parts)
        self._guesses: dict[int, Pose] = {}
        self._changed, self._stopping = threading.Condition(), False
        self._executor = self._start()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

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

    def _start(self) -> ProcessPoolExecutor:
        spawn = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(1, mp_context=spawn, initializer=_prepare, initargs=(self._method,))

    def _run(self) -> None:
        while (job := self._next()) is not None:
            try:
                result = self._submitted(job).result()
            except BrokenProcessPool:
                if self._stopping:
                    return
                self._executor = self._start()
                result = Result(job, [], "the method's process died")
            except Exception as error:
                result = Result(job, [], _line(error))
            if not self._stopping:
                self._done(result)

    def _submitted(self, job: Job) -> Future[Result]:
        return self._executor.submit(_propose, self._method, job)

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


class AtOnce:
    """Answers in this process before the question returns: for scripts."""

    def __init__(self, method: Method) -> None:
        self._method = method
        self.done: Callable[[Result], None] | None = None
        """Called with each result."""

    def ask(self, part: int, guess: Pose | None) -> None:
        """Answer a guess, or find all fits without one."""
        job = Job(part, guess)
        if self.done is not None:
            self.done(Result(job, proposals_of(prepared(self._method), job)))

    def prefer(self, part: int) -> None:
        """The part in the hand: nothing waits for it."""


def scene_queries(dataset: Dataset, scene_id: str, sensor: str, truth: bool) -> dict[int, Query]:
    """A query for each part of a scene that can be edited, without the recorded guess: that is not the hand's."""
    scene = dataset.recorded_scene(scene_id, truth)
    track = "snap" if sensor == "ideal" else f"snap-{sensor}"
    queries = {query.part: query for query in scene.queries if query.track == track}
    if not queries:
        raise InputError(f"{scene_id}: no part of it can be edited from the {sensor} depth image")
    return {part: with_guess(query, None) for part, query in sorted(queries.items())}


def with_guess(query: Query, guess: Pose | None) -> Query:
    """The query with the hand's pose as the guess, or with none."""
    return replace(query, guess=guess)


def _prepare(method: Method) -> None:
    start_worker()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page, which ends this process


def _propose(method: Method, job: Job) -> Result:
    """All fits of a part; an error becomes a line for the page."""
    try:
        return Result(job, proposals_of(prepared(method), job))
    except Exception as error:
        return Result(job, [], _line(error))


@dataclass(frozen=True, eq=False)
class Prepared:
    """A method, made, and the queries about a scene."""

    dataset: Dataset
    queries: dict[int, Query]
    predictor: Any
    truth: bool


@lru_cache(maxsize=1)
def prepared(method: Method) -> Prepared:
    """Made once in each process."""
    dataset = Dataset(method.root)
    queries = scene_queries(dataset, method.scene_id, method.sensor, method.truth)
    predictor = predictor_of(method.snap, dataset)
    if getattr(predictor, "uses_true_geometry", False) and not method.truth:
        raise InputError(f"--snap {method.snap}: needs the true geometry, which only --truth shows")
    return Prepared(dataset, queries, predictor, bool(getattr(predictor, "uses_true_geometry", False)))


def proposals_of(made: Prepared, job: Job) -> list[Proposal]:
    """All fits of a part; of a method that proposes none, its prediction, where the hand gives it a guess."""
    query, predictor = with_guess(made.queries[job.part], job.guess), made.predictor
    geometry = made.dataset.geometry.true_geometry(made.dataset.truth_of(query)) if made.truth else None
    if hasattr(predictor, "propose"):
        motions = list(predictor.propose(query, geometry))
    else:
        motions = [] if job.guess is None else [predictor(query, geometry)]
    predictions = (to_prediction(query, motion, 0.0) for motion in motions)
    return [Proposal(each.goal_from_now, each.confidence, job.guess is not None) for each in predictions]


def _line(error: BaseException) -> str:
    """An error in one line."""
    message = " ".join(str(error).split()) or "no message"
    return message if isinstance(error, Kit1000Error) else f"{type(error).__name__}: {message}"
