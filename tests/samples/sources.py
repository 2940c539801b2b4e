"""The source files and the pages of the checkout."""

from __future__ import annotations

from functools import cache
from itertools import chain
from pathlib import Path

from tests.samples.checkout import ROOT

PACKAGES = ("kit1000", "benchmark", "baselines")  # the library and the two applications
PYTHON_FOLDERS = (*PACKAGES, "bench", "examples", "tests", "docs")
DOCUMENTS = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))


@cache
def modules() -> dict[str, Path]:
    """The files of the library and the applications, by the dotted names of their modules."""
    found: dict[str, Path] = {}
    for path in sorted(chain.from_iterable((ROOT / package).rglob("*.py") for package in PACKAGES)):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def python_files() -> tuple[Path, ...]:
    """All Python files of the checkout."""
    return tuple(chain.from_iterable(sorted((ROOT / folder).rglob("*.py")) for folder in PYTHON_FOLDERS))
