"""Compilation of array loops with numba, cached on disk where a cache folder is writable."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile on the first call and cache the result on disk, or in memory where no folder is writable."""
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # raised when neither the package nor the user's cache folder is writable
        return njit(**options)(function)
