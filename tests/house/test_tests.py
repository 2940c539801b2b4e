"""Rules of the tests: their tree mirrors the code, and `make test AREA=` knows it."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from tests.samples.checkout import ROOT
from tests.samples.sources import PACKAGES

TESTS = ROOT / "tests"
OF_NO_PACKAGE = {"house", "outside", "samples"}  # rules and documents; bench/outside; what tests share
FOLDERS = sorted({path.parent.relative_to(TESTS).as_posix() for path in TESTS.rglob("test_*.py")} - {"."})


@pytest.mark.parametrize("folder", sorted({*FOLDERS} - OF_NO_PACKAGE))
def test_a_folder_of_tests_is_a_package(folder: str) -> None:
    package = folder if folder.split("/")[0] in PACKAGES else f"kit1000/{folder}"
    assert (ROOT / package / "__init__.py").is_file()


def test_folders_of_tests_hold_tests_and_samples_hold_none() -> None:
    strays = [path for path in TESTS.rglob("*.py") if not path.name.startswith("test_")]
    assert {path for path in strays if path.parent != TESTS / "samples"} == {TESTS / "conftest.py"}
    assert not list((TESTS / "samples").rglob("test_*.py"))


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_an_unknown_area_is_answered_with_the_known_ones() -> None:
    done = subprocess.run(["make", "-n", "test", "AREA=kit"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert re.search(r"no tests of kit: .*\bkits known_shapes labelling metrics\b", done.stderr)
    assert done.stderr.partition("one of ")[2].rstrip(". Stop\n").split() == FOLDERS
