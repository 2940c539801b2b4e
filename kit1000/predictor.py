"""The interface of a method: a callable that takes a query and returns a motion of the part."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from importlib import import_module, invalidate_caches
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from kit1000.errors import InputError, InternalError, Kit1000Error, failure_text
from kit1000.pose import Pose
from kit1000.values import Prediction, Query, TrueGeometry

FILE_TARGET = re.compile(r"(?P<path>.+\.py):(?P<object>[^:/\\]*)\Z")
"""A target that names a file: ./my_method.py:predict."""


class PredictedMotion(NamedTuple):
    """What a method predicts for a query."""

    goal_from_now: Pose
    """Motion in the world that takes the part from its present pose to its goal."""
    confidence: float
    """0 to 1; it is compared with the confidences of the other predictions of the same method."""


class Predictor(Protocol):
    """A method: a function, or an instance whose `__init__` read its weights."""

    def __call__(self, query: Query, geometry: Any, /) -> PredictedMotion:
        """Predict from this query alone.

        geometry: None; `TrueGeometry` for a method that sets `uses_true_geometry`; `SceneShapes` for one whose `reads`
        is "shapes".
        """
        ...


class Proposer(Protocol):
    """A method that also returns all fits of a part, from which a person can choose."""

    def propose(self, query: Query, geometry: TrueGeometry | None, /) -> Sequence[PredictedMotion]:
        """All fits, the best first; empty if nothing fits. The first one is what the predictor returns.

        A confidence is calibrated: of fits with 0.8, about 80 % are seated.
        """
        ...


def resolved(target: str) -> Any:
    """The object that `module:Object` or `file.py:Object` names.

    Raises:
        InputError: there is no such object, or it cannot be called.
        InternalError: its module fails or ends the process while it is imported.
    """
    module, name = module_and_object(target)
    try:
        value = getattr(import_module(module), name, None)
    except (ImportError, ValueError) as error:
        raise InputError(f"{target}: {' '.join(str(error).split())}") from error
    except Kit1000Error:
        raise
    except (Exception, SystemExit) as error:
        raise InternalError(f"{target}: {failure_text(error)}") from error
    if not callable(value):
        raise InputError(f"{target}: {module} has no {name or 'object'} that can be called")
    return value


def module_and_object(target: str) -> tuple[str, str]:
    """The names of the module and the object of a target; the folder of a file is added to `sys.path`.

    Raises InputError if the file is missing, or another module of its name is loaded.
    """
    match = FILE_TARGET.match(target)
    if match is None:
        module, _, name = target.partition(":")
        return module, name
    path = Path(match["path"]).expanduser()
    if not path.is_file():
        raise InputError(f"{target}: no file {path}")
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.insert(0, folder)
    invalidate_caches()
    loaded = getattr(sys.modules.get(path.stem), "__file__", None)
    if path.stem in sys.modules and (loaded is None or Path(loaded).resolve() != path.resolve()):
        raise InputError(f"{target}: another module is called {path.stem}; rename the file")
    return path.stem, match["object"]


def to_prediction(query: Query, predicted: PredictedMotion, seconds: float) -> Prediction:
    """The return value of a method as a Prediction; raises InputError if it is not a PredictedMotion.

    seconds: time that the method took [s].
    """
    if not (isinstance(predicted, tuple) and len(predicted) == 2 and isinstance(predicted[0], Pose)):
        wanted = "expected a PredictedMotion(goal_from_now: Pose, confidence: float)"
        raise InputError(f"{query.id}: {wanted}, got {_type_name(predicted)}")
    motion, confidence = predicted
    if motion.batch_shape != ():
        raise InputError(f"{query.id}: expected one motion, got a batch of shape {motion.batch_shape}")
    try:
        return Prediction(query.id, motion, float(confidence), seconds)
    except (TypeError, ValueError) as error:
        message = f"confidence of {query.id}: expected a number, got {type(confidence).__name__}"
        raise InputError(str(error) if isinstance(error, InputError) else message) from error


def _type_name(value: object) -> str:
    """The type of a value; of a tuple, the types of its entries."""
    if isinstance(value, tuple):
        return f"({', '.join(type(entry).__name__ for entry in value)})"
    return type(value).__name__
