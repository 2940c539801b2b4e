"""The exceptions of the package, the near word for an unknown one, and the check of every array from outside.

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
    """Base of every exception that this package raises on purpose."""


class InputError(Kit1000Error):
    """Bad input of a user; a command answers with the message and exit status 2."""


class ShapeError(InputError, ValueError):
    """An array that has the wrong shape, holds the wrong kind of values, or is not finite."""


class MeshRefused(InputError):
    """A mesh that cannot be a part; `reason` says which property it lacks."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class Redraw(Kit1000Error):
    """A random draw that geometry rejects; `reason` is short, so that equal reasons can be counted."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class InternalError(Kit1000Error):
    """A mistake of this package and not of its user, said in one line that helps to find it."""


def internal_error(doing: str, error: BaseException) -> InternalError:
    """An unforeseen exception as a Fault: what was being done, what went wrong, in which line of this package."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if Path(__file__).parent in Path(frame.filename).parents]
    where = f" ({Path(ours[-1].filename).name}:{ours[-1].lineno})" if ours else ""
    said = " ".join(str(error).split())
    return InternalError(
        f"{doing}: {type(error).__name__}: {said or 'no message'}{where}; please report this fault of kit1000"
    )


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """What goes into a message about a word that is not known: "did you mean x? ", or nothing where none is alike."""
    found = get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f"did you mean {found[0]}? " if found else ""


Shape = tuple[int | str | EllipsisType, ...]


def checked(name: str, array: ArrayLike, shape: Shape, dtype: DTypeLike = np.float64) -> np.ndarray:
    """Return a read-only, C-contiguous copy of an array after checking its shape and values.

    Args:
        name: what the caller calls the array; opens every message.
        array: numbers, nested sequences of numbers, or an array.
        shape: wanted sizes. An int is exact, a string names a free size (the same string twice means
            equal sizes), and `...` as the first entry stands for any leading axes: `(..., "n", 3)`.
        dtype: wanted type. Floats must be finite; integers and bools must survive the cast unchanged.

    Returns:
        The copy, of the asked dtype; writing to it raises.

    Raises:
        ShapeError: states the name, the expected shape and the shape found.
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
        with np.errstate(invalid="ignore", over="ignore"):  # a lossy cast is answered below, not by a warning
            copy = np.array(source, dtype=dtype, order="C", copy=True)
    good = np.isfinite(copy) if copy.dtype.kind == "f" else copy == source
    if not good.all():
        first = tuple(int(i) for i in np.argwhere(~good)[0])
        why = "which is not finite" if copy.dtype.kind == "f" else f"which is no {copy.dtype.name}"
        raise _shape_error(name, shape, dtype, f"shape {source.shape} with {source[first]} at {first}, {why}")
    copy.setflags(write=False)
    return copy


def _shape_error(name: str, shape: Shape, dtype: DTypeLike, got: str) -> ShapeError:
    return ShapeError(f"{name}: expected {np.dtype(dtype).name} of shape {_shape_text(shape)}, got {got}")


def _matches(found: tuple[int, ...], shape: Shape) -> bool:
    """Whether the found sizes match the wanted ones, equal names standing for equal sizes."""
    trailing = shape
    if shape and shape[0] is Ellipsis:
        trailing = shape[1:]
        found = found[max(len(found) - len(trailing), 0) :]
    if len(found) != len(trailing):
        return False
    named: dict[str, int] = {}
    return all(
        named.setdefault(want, size) == size if isinstance(want, str) else want == size
        for want, size in zip(trailing, found, strict=True)
    )


def _shape_text(shape: Shape) -> str:
    """The shape as a reader writes it: (..., n, 3)."""
    sizes = ["..." if size is Ellipsis else str(size) for size in shape]
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"
