"""What a method is to the benchmark: something to call with a query, which answers with a motion."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.values import Prediction, Query, Truth


class PredictedMotion(NamedTuple):
    """What a method says to a query."""

    goal_from_now: Pose
    """How the part that is seen must move in the world."""
    confidence: float
    """0 to 1: how sure the method is, to be compared with its own other answers."""


class Predictor(Protocol):
    """A method: a function, or an instance whose `__init__` read its weights."""

    def __call__(self, query: Query, truth: Truth | None, /) -> PredictedMotion:
        """Answer a query from itself alone. The truth is None unless the method says that it uses true geometry."""
        ...


def to_prediction(query: Query, answer: PredictedMotion, seconds: float) -> Prediction:
    """The answer to a query as a prediction; raises InputError when it is none. seconds: [s] that it took."""
    if not (isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[0], Pose)):
        raise InputError(
            f"{query.id}: expected a PredictedMotion(goal_from_now: Pose, confidence: float), got {_told(answer)}"
        )
    motion, confidence = answer
    if motion.batch_shape != ():
        raise InputError(f"{query.id}: expected one motion, got a batch of shape {motion.batch_shape}")
    try:
        return Prediction(query.id, motion, float(confidence), seconds)
    except (TypeError, ValueError) as error:
        told = f"confidence of {query.id}: expected a number, got {type(confidence).__name__}"
        raise InputError(str(error) if isinstance(error, InputError) else told) from error


def _told(answer: object) -> str:
    """A short word for what came in place of an answer."""
    if isinstance(answer, tuple):
        return f"({', '.join(type(entry).__name__ for entry in answer)})"
    return type(answer).__name__
