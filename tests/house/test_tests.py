"""The rules of the tests: their tree mirrors the code, they use public names, and quick ones are told from others."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.samples.checkout import ROOT
from tests.samples.sources import PACKAGES, imports, loaded, tree

TESTS = ROOT / "tests"
OF_NO_PACKAGE = {"house", "outside", "samples"}  # rules and documents; bench/outside; what tests share
OURS = {*PACKAGES, "bench"}
OF_NAMED_TUPLES = {"_replace", "_asdict", "_fields", "_make"}  # public in spite of the underscore
FILES = sorted(TESTS.rglob("*.py"))
FOLDERS = sorted({path.parent.relative_to(TESTS).as_posix() for path in TESTS.rglob("test_*.py")} - {"."})


def package_of(folder: str) -> str:
    """The package that a folder of tests is about."""
    return folder if folder.split("/")[0] in PACKAGES else f"kit1000/{folder}"


@pytest.mark.parametrize("folder", [name for name in FOLDERS if name not in OF_NO_PACKAGE])
def test_a_folder_of_tests_is_a_package_and_its_tests_import_it(folder: str) -> None:
    package = package_of(folder)
    assert (ROOT / package / "__init__.py").is_file()
    name = package.replace("/", ".")
    for path in sorted((TESTS / folder).glob("test_*.py")):
        assert any(f"{target}.".startswith(f"{name}.") for target in imports(path)), f"{path.name} imports no {name}"


def test_folders_of_tests_hold_tests_and_samples_hold_none() -> None:
    assert {folder.split("/")[0] for folder in FOLDERS} >= OF_NO_PACKAGE - {"samples"}
    assert not list((TESTS / "samples").rglob("test_*.py"))
    strays = [path for path in FILES if not path.name.startswith("test_") and path.parent != TESTS / "samples"]
    assert strays == [TESTS / "conftest.py"]


def private_names(path: Path) -> Iterator[str]:
    """Names with an underscore that a file imports from ours, reads off something, or writes down to replace."""
    nodes = list(ast.walk(tree(path)))
    foreign = {
        alias.asname or alias.name.partition(".")[0]
        for node in nodes
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
        if (node.module or "" if isinstance(node, ast.ImportFrom) else alias.name).partition(".")[0] not in OURS
    }
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names if (node.module or "").partition(".")[0] in {*OURS, "tests"}]
        elif isinstance(node, ast.Attribute):
            names = [] if _root(node) in {*foreign, "self", "cls"} else [node.attr]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            names = re.findall(rf"^(?:(?:{'|'.join(OURS)})[\w.]*\.)?(_[a-z]\w*)$", node.value)
        else:
            names = []
        line = getattr(node, "lineno", 0)
        yield from (f"{line}: {name}" for name in names if re.match(r"_[^_]", name) and name not in OF_NAMED_TUPLES)


def _root(node: ast.expr) -> str | None:
    while isinstance(node, ast.Attribute):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


def test_no_test_uses_a_private_name() -> None:
    found = {str(path.relative_to(TESTS)): list(private_names(path)) for path in FILES}
    assert not {path: names for path, names in found.items() if names}


@pytest.mark.parametrize(
    "line",
    [
        "from kit1000.pose import _sinc",
        "value._hidden()",
        'patch.setattr(module, "_write", None)',
        'patch.setattr("kit1000.files._write", None)',
    ],
)
def test_a_private_name_would_be_noticed(line: str, tmp_path: Path) -> None:
    file = tmp_path / "test_it.py"
    file.write_text(line)
    assert len(list(private_names(file))) == 1


def test_what_a_file_loads_is_known_without_loading_it() -> None:
    """So `make check` skips what needs torch; not what imports it in a function."""
    learned = loaded(TESTS / "baselines/snapnet/test_method.py")
    assert {"torch", "baselines.snapnet.rotation", "kit1000.pose", "numpy"} <= learned
    plain = loaded(TESTS / "kits/test_seating.py")
    assert {"kit1000.kits.seating", "numpy", "manifold3d"} <= plain
    assert not {"torch", "playwright", "kit1000.generation.build"} & plain


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_an_unknown_area_is_answered_with_the_known_ones() -> None:
    done = subprocess.run(["make", "-n", "test", "AREA=kit"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert re.fullmatch(r".*no tests of kit: AREA is one of .*\bkits labelling metrics\b.*\n", done.stderr)
    known = done.stderr.partition("one of ")[2].rstrip(". Stop\n").split()
    assert known == FOLDERS


def test_every_long_test_is_there() -> None:
    named = [tuple(line.split("::")) for line in (TESTS / "long.txt").read_text(encoding="utf-8").split()]
    found = {
        (path.relative_to(ROOT).as_posix(), name)
        for path in FILES
        for node in tree(path).body
        for name in ([node.name] if isinstance(node, ast.FunctionDef) else _assigned(node))
    }
    assert not [name for name in named if name[:2] not in found]


def _assigned(node: ast.stmt) -> list[str]:
    """The names that a statement assigns, such as the test case of a state machine."""
    return (
        [target.id for target in node.targets if isinstance(target, ast.Name)] if isinstance(node, ast.Assign) else []
    )
