"""Compilation of array loops with numba, cached on disk where a cache folder is writable.

A file of the cache that cannot be read, as a full disk or a crash leaves it, is thrown away and made anew.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys


class _ForgivingCache(FunctionCache):
    """A cache on disk whose damage costs a compilation and nothing else."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            rtsys.initialize(target_context)  # all that is needed to run; numba's own loader takes 0.3 s more a process
            return self._load_overload(sig, target_context)
        except Exception:  # damaged bytes raise anything when they are unpickled
            with suppress(Exception):
                self.flush()  # an empty index
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(Exception):  # a full disk, a folder that has gone
            super().save_overload(sig, data)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile on the first call and cache the result on disk, or in memory where no folder is writable."""
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    dispatcher = njit(**options)(function)
    with suppress(RuntimeError):  # raised when neither the package nor the user's cache folder is writable
        dispatcher._cache = _ForgivingCache(function)  # pyright: ignore[reportAttributeAccessIssue]
    return dispatcher
