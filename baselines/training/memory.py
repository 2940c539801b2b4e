"""Makes the C library keep freed memory instead of returning it to the system after every step."""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, MMAP_MAX = -1, -4  # names of glibc's mallopt


def keep_memory() -> bool:
    """Make glibc keep freed memory; returns whether it could be set.

    Tensors of more than 32 MB are otherwise mapped anew each time, and touching their fresh pages costs more than the
    arithmetic of a small network: a step takes up to half as long again. It holds for the whole process.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # other C libraries have none
    return mallopt is not None and bool(mallopt(MMAP_MAX, 0) and mallopt(TRIM_THRESHOLD, 2**31 - 1))
