"""The list of `make mutants` fits the code: each change has one place, and tests; survivors are named."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

from bench.outside import mutants
from bench.outside.mutants import LEAST_SHARE, MUTANTS, Mutant, is_killed, main
from tests.samples.checkout import ROOT

MODULE = "def half(x):\n    return x / 2\n"
TEST = "from half import half\n\n\ndef test_half():\n    assert half(4) == 2\n"


@cache
def syntax(source: str) -> str:
    """The syntax of a module, the same for any comments; what two mutants share is read once."""
    return ast.dump(ast.parse(source))


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_a_change_has_one_place_and_makes_another_valid_module(mutant: Mutant) -> None:
    source = (ROOT / mutant.file).read_text(encoding="utf-8")
    assert source.count(mutant.old) == 1
    changed = source.replace(mutant.old, mutant.new)
    assert syntax(changed) != syntax(source)
    assert all((ROOT / name).is_file() for name in mutant.test_files)


def test_tests_are_named_by_folder_and_module() -> None:
    mutant = Mutant("kit1000/kits/seating.py", "3", "4", "kits/seating stated_numbers")
    assert mutant.test_files == ["tests/kits/test_seating.py", "tests/test_stated_numbers.py"]


def test_every_change_is_listed_once() -> None:
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS) >= 60


@pytest.fixture
def small_tree(tmp_path: Path) -> Path:
    """A module and its test, as in a copy of the tree."""
    tree = tmp_path / "tree"
    (tree / "tests").mkdir(parents=True)
    (tree / "half.py").write_text(MODULE)
    (tree / "tests/test_half.py").write_text(TEST)
    return tree


@pytest.mark.slow
@pytest.mark.parametrize(("old", "new", "killed"), [("x / 2", "x / 3", True), ("x / 2", "x * 0.5", False)])
def test_a_change_dies_when_a_test_fails_and_is_undone(old: str, new: str, killed: bool, small_tree: Path) -> None:
    assert is_killed(Mutant("half.py", old, new, "half"), small_tree) == killed
    assert (small_tree / "half.py").read_text() == MODULE


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("x", "y", "expected once in half.py, found otherwise: x"),
        ("def half", "def third", "neither passed nor failed"),
    ],
)
def test_a_change_that_cannot_be_judged_stops_the_run(old: str, new: str, message: str, small_tree: Path) -> None:
    with pytest.raises(SystemExit, match=message):
        is_killed(Mutant("half.py", old, new, "half"), small_tree)


@pytest.mark.parametrize(("survivors", "status"), [(0, 0), (1, 0), (2, 1)])
def test_the_exit_status_says_whether_enough_die(
    survivors: int, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert LEAST_SHARE == 0.95
    changes = tuple(Mutant("a.py", f"line {i}", "other", "a") for i in range(20))
    monkeypatch.setattr(mutants, "MUTANTS", changes)
    monkeypatch.setattr(mutants, "copy_tree", lambda tree: None)
    monkeypatch.setattr(mutants, "pytest_status", lambda tree, test_files: (0, ""))
    monkeypatch.setattr(mutants, "is_killed", lambda mutant, tree: mutant not in changes[:survivors])
    assert main([]) == status
    printed = capsys.readouterr().out
    assert f"{20 - survivors} of 20 died" in printed
    assert printed.count("survived: a.py: line") == survivors


def test_tests_that_fail_without_a_change_stop_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutants, "copy_tree", lambda tree: None)
    monkeypatch.setattr(mutants, "pytest_status", lambda tree, test_files: (1, "1 failed"))
    with pytest.raises(SystemExit, match="the tests fail without any change\n1 failed"):
        main(["pivots"])
    with pytest.raises(SystemExit, match="no mutant has a name with nothing"):
        main(["nothing"])
