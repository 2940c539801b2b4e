"""The exceptions of the package, and the one check that every array from outside goes through.

A message is one line: what is wrong, where, and what was expected instead.
"""

from __future__ import annotations

import traceback
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


class Fault(Kit1000Error):
    """A mistake of this package and not of its user, said in one line that helps to find it."""


def fault(doing: str, error: BaseException) -> Fault:
    """An unforeseen exception as a Fault: what was being done, what went wrong, in which line of this package."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if Path(__file__).parent in Path(frame.filename).parents]
    where = f" ({Path(ours[-1].filename).name}:{ours[-1].lineno})" if ours else ""
    said = " ".join(str(error).split())
    return Fault(f"{doing}: {type(error).__name__}: {said or 'no message'}{where}; please report this fault of kit1000")


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
    wanted = f"{name}: expected {np.dtype(dtype).name} of shape {_written(shape)}"
    source = _as_numbers(array, wanted)
    if not _fits(source.shape, shape):
        raise ShapeError(f"{wanted}, got shape {source.shape}")
    with np.errstate(invalid="ignore", over="ignore"):  # a lossy cast is answered below, not by a warning
        copy = np.array(source, dtype=dtype, order="C", copy=True)
    bad = ~np.isfinite(copy) if copy.dtype.kind == "f" else copy != source
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        fault = "which is not finite" if copy.dtype.kind == "f" else f"which is no {copy.dtype.name}"
        raise ShapeError(f"{wanted}, got shape {source.shape} with {source[first]} at {first}, {fault}")
    copy.setflags(write=False)
    return copy


def _as_numbers(array: ArrayLike, wanted: str) -> np.ndarray:
    """Return the array as real numbers of any type; text, objects and ragged lists are refused."""
    try:
        source = np.asarray(array)
    except ValueError:
        raise ShapeError(f"{wanted}, got rows of unequal length") from None
    if source.dtype.kind not in "biuf":
        raise ShapeError(f"{wanted}, got {source.dtype} of shape {source.shape}")
    return source


def _fits(found: tuple[int, ...], shape: Shape) -> bool:
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


def _written(shape: Shape) -> str:
    """The shape as a reader writes it: (..., n, 3)."""
    sizes = ["..." if size is Ellipsis else str(size) for size in shape]
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"
