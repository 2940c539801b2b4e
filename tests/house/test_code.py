"""Rules of the code and of the tests: short files, names after things, a tree of tests that mirrors the code."""

from __future__ import annotations

import ast
import importlib
import re
import shutil
import subprocess
import sys
from typing import Any

import pytest
import tomli

import kit1000
from tests.samples.checkout import ROOT
from tests.samples.sources import DOCUMENTS, PACKAGES, modules, python_files

LONGEST_FILE = 700
NAMED_AFTER_NOTHING = {"utils", "util", "common", "helpers", "helper", "core", "base", "manager", "misc"}
NOT_ON_IMPORT = ("numpy", "scipy", "numba", "trimesh", "manifold3d", "pybullet", "open3d", "torch", "viser")


def test_files_are_short() -> None:
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in python_files()}
    source = {str(path): n for path, n in lengths.items() if not path.is_relative_to(ROOT / "tests")}
    assert not {path: n for path, n in source.items() if n > LONGEST_FILE}


def test_modules_are_named_after_a_thing() -> None:
    named = [path.relative_to(ROOT).with_suffix("") for path in python_files()]
    assert not [path for path in named if NAMED_AFTER_NOTHING & {*path.parts}]


def test_importing_the_library_loads_nothing_heavy() -> None:
    script = f"import kit1000, sys; print(*[name for name in {NOT_ON_IMPORT!r} if name in sys.modules])"
    printed = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert printed.stdout.split() == []


def test_public_names_resolve() -> None:
    assigned = re.compile(r"^__all__\b", re.MULTILINE)
    for name, path in modules().items():
        if assigned.search(path.read_text(encoding="utf-8")):
            module = importlib.import_module(name)
            assert not [public for public in module.__all__ if getattr(module, public, None) is None], name


@pytest.mark.parametrize("name", ["kit1000", "kit1000.parts"])
def test_type_checkers_see_the_same_public_names_as_users(name: str) -> None:
    package = importlib.import_module(name)
    stub = ast.parse((ROOT / name.replace(".", "/") / "__init__.pyi").read_text())
    lines = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    seen = {alias.name: f"{name}.{node.module}" for node in lines for alias in node.names}
    assert sorted(seen) == sorted(package.__all__)
    for public, module in seen.items():
        assert getattr(package, public) is getattr(importlib.import_module(module), public)


def test_no_file_names_a_place_on_someones_machine() -> None:
    place = re.compile(r"(?<![\w.~$}*/])/(work|root|home|tmp|Users)/")
    written = [*python_files(), *DOCUMENTS, ROOT / "Makefile", ROOT / "pyproject.toml", ROOT / ".ci/run"]
    assert not [path for path in written if place.search(path.read_text(encoding="utf-8"))]


def project() -> dict[str, Any]:
    return tomli.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_version_stands_everywhere_the_same() -> None:
    assert f"\nversion: {kit1000.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## {kit1000.__version__} (" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_hosted_workflow_runs_the_same_command_on_the_oldest_and_newest_python() -> None:
    workflow = (ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8")
    assert "      - run: .ci/run\n" in workflow
    promised = [line.rpartition(" ")[2] for line in project()["classifiers"] if re.search(r"3\.\d+$", line)]
    assert f'python: ["{promised[0]}", "{promised[-1]}"]' in workflow


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
