"""The exceptions of the package, suggestions for misspelt words, and the check of array arguments.

A message is one line: what is wrong, where, and what was expected instead.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from types import EllipsisType

import numpy as np
from numpy.typing import ArrayLike, DTypeLike


class Kit1000Error(Exception):
    """Base class of the exceptions of this package."""


class InputError(Kit1000Error):
    """Invalid input; a command prints the message and exits with status 2."""


class ShapeError(InputError, ValueError):
    """An array of the wrong shape or type, or with non-finite values."""


class MeshRefused(InputError):
    """A mesh that cannot be a part; `reason` says which property it lacks."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class Redraw(Kit1000Error):
    """A random draw that is rejected and drawn again; `reason` is short, so that equal reasons can be counted."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class InternalError(Kit1000Error):
    """A bug of this package and not a mistake of its user, described in one line."""


def internal_error(action: str, error: BaseException) -> InternalError:
    """An unexpected exception as an InternalError: the action, the message, and the line of this package."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if Path(__file__).parent in Path(frame.filename).parents]
    where = f" ({Path(ours[-1].filename).name}:{ours[-1].lineno})" if ours else ""
    message = " ".join(str(error).split())
    cause = f"{type(error).__name__}: {message or 'no message'}{where}"
    return InternalError(f"{action}: {cause}; please report this bug of kit1000")


def failure_text(error: BaseException) -> str:
    """An unexpected exception of a user's code as one line: its type, its message, and the line of that code."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "<frozen" not in frame.filename]
    own = [frame for frame in frames if "site-packages" not in frame.filename]
    place = f" ({Path(own[-1].filename).name}:{own[-1].lineno})" if own else ""
    if isinstance(error, SyntaxError) and error.filename:
        place = f" ({Path(error.filename).name}:{error.lineno})"
    if isinstance(error, SystemExit):
        return f"it ends the process by sys.exit({'' if error.code is None else repr(error.code)}){place}"
    message = error.msg if isinstance(error, SyntaxError) else " ".join(str(error).split())
    return f"{type(error).__name__}: {message or 'no message'}{place}"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The hint "did you mean x? " for a message about an unknown word; empty when no known word is similar."""
    matches = get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f"did you mean {matches[0]}? " if matches else ""


def shown(text: object) -> str:
    """A name or message in one line that any output can print: control characters and odd bytes are escaped."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(text))


Shape = tuple[int | str | EllipsisType, ...]


def checked(name: str, array: ArrayLike, shape: Shape, dtype: DTypeLike = np.float64) -> np.ndarray:
    """Return a read-only, C-contiguous copy of an array after checking its shape and values.

    Args:
        name: name of the argument; begins every message.
        array: numbers, nested sequences of numbers, or an array.
        shape: expected sizes. An int is exact, a string names a free size (the same string twice means equal sizes),
            and `...` as the first entry means any leading axes: `(..., "n", 3)`.
        dtype: expected type. Floats must be finite; the cast to integers and bools must be exact.

    Returns:
        The copy, of the expected dtype; writing to it raises.

    Raises:
        ShapeError: states the name, the expected and the actual shape.
    """
    try:
        source = np.asarray(array)
    except ValueError:
        raise _shape_error(name, shape, dtype, "rows of unequal length") from None
    if source.dtype.kind not in "biuf":  # text, objects
        raise _shape_error(name, shape, dtype, f"{source.dtype} of shape {source.shape}")
    if not _matches(source.shape, shape):
        raise _shape_error(name, shape, dtype, f"shape {source.shape}")
    if source.dtype == dtype:
        copy = np.array(source, order="C", copy=True)
    else:
        with np.errstate(invalid="ignore", over="ignore"):  # a lossy cast raises below instead of warning
            copy = np.array(source, dtype=dtype, order="C", copy=True)
    valid = np.isfinite(copy) if copy.dtype.kind == "f" else copy == source
    if not valid.all():
        first = tuple(int(i) for i in np.argwhere(~valid)[0])
        why = "which is not finite" if copy.dtype.kind == "f" else f"which is no {copy.dtype.name}"
        raise _shape_error(name, shape, dtype, f"shape {source.shape} with {source[first]} at {first}, {why}")
    copy.setflags(write=False)
    return copy


def _shape_error(name: str, shape: Shape, dtype: DTypeLike, got: str) -> ShapeError:
    return ShapeError(f"{name}: expected {np.dtype(dtype).name} of shape {_shape_text(shape)}, got {got}")


def _matches(actual: tuple[int, ...], shape: Shape) -> bool:
    """Whether the actual sizes match the expected ones, where equal names mean equal sizes."""
    trailing = shape
    if shape and shape[0] is Ellipsis:
        trailing = shape[1:]
        actual = actual[max(len(actual) - len(trailing), 0) :]
    named: dict[str, int] = {}
    return actual == trailing or (
        len(actual) == len(trailing)
        and all(
            named.setdefault(expected, size) == size if isinstance(expected, str) else expected == size
            for expected, size in zip(trailing, actual, strict=True)
        )
    )


def _shape_text(shape: Shape) -> str:
    """The shape as text: (..., n, 3)."""
    sizes = ["..." if size is Ellipsis else str(size) for size in shape]
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"
