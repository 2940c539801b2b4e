"""Compiling array loops with numba, on machines with and without a folder to keep the result in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile on the first call and keep the result on disk, or in memory where no folder can be written."""
    options = {"nogil": True, "error_model": "numpy"}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # raised when neither the package nor the user's cache folder is writable
        return njit(**options)(function)
