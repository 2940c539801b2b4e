"""Versions of the libraries that decide the bytes of a dataset: recorded beside its identity, and compared."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from kit1000.version import __version__

LIBRARIES = ("manifold3d", "mcap", "numba", "numpy", "pybullet", "scipy", "zstandard")
RECORD = "made_with"  # the entry of dataset.json
ABSENT = "absent"
SERIES = "3.5"  # of manifold3d, by which the datasets without a record were made


def library_versions() -> dict[str, str]:
    """Versions by name, of kit1000 and of Python too."""
    found = {"kit1000": __version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = ABSENT
    return found


def version_differences(summary: Mapping[str, Any]) -> list[str] | None:
    """The libraries that are of another version here than where a dataset was made: "numpy 2.2.0, here 2.4.6".

    None for a dataset that does not record them, unless manifold3d is of another series than any that made one.
    """
    recorded, here = summary.get(RECORD), library_versions()
    if not isinstance(recorded, Mapping):
        found = here["manifold3d"]
        return None if f"{found}.".startswith(f"{SERIES}.") else [f"manifold3d {SERIES}, here {found}"]
    pairs = [(name, recorded[name], here[name]) for name in LIBRARIES if name in recorded]
    return [f"{name} {before}, here {now}" for name, before, now in pairs if before != now]
