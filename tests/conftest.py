"""Fixtures of all tests: the optional folder of real CAD parts."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def _folders() -> list[Path]:
    """The folder that KIT1000_REAL_PARTS names, else shared/parts/real beside the checkout, or none."""
    beside = Path(__file__).resolve().parents[2] / "shared/parts/real"
    folder = Path(os.environ.get("KIT1000_REAL_PARTS") or beside)
    return [folder] if (folder / "manifest.csv").is_file() else []


@pytest.fixture(scope="session", params=_folders(), ids=lambda folder: folder.name)
def real_parts(request: pytest.FixtureRequest) -> Path:
    """A folder of STL files with a manifest.csv that says which are closed; tests that ask for it need it."""
    return request.param
