"""The commit and the evaluator hash over exactly the sources that scoring imports."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from benchmark import provenance
from benchmark.provenance import BENCHMARK, LIBRARY, evaluator, evaluator_modules

NOT_SCORING = ("pages/board.py", "curve_charts.py", "compare.py", "table1.py", "report.py", "__main__.py")


@pytest.fixture
def tree(tmp_path: Path) -> tuple[Path, Path]:
    """Copies of the two packages."""
    for package in (BENCHMARK, LIBRARY):
        ignored = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(package, tmp_path / package.name, ignore=ignored)
    return tmp_path / BENCHMARK.name, tmp_path / LIBRARY.name


def hash_of(tree: tuple[Path, Path]) -> str:
    evaluator.cache_clear()
    return evaluator(*tree)


def test_the_same_sources_have_the_same_hash_anywhere(tree: tuple[Path, Path]) -> None:
    assert hash_of(tree) == evaluator()
    assert len(evaluator()) == provenance.DIGITS


def test_a_change_of_any_module_that_scoring_imports_changes_the_hash(
    tree: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    hashes, found = {hash_of(tree)}, evaluator_modules(*tree)
    monkeypatch.setattr(provenance, "evaluator_modules", lambda *_: found)  # the changes add no import
    for path in found.values():
        path.write_text(path.read_text("utf-8") + "# changed\n", "utf-8")
        assert hash_of(tree) not in hashes, path
        hashes.add(hash_of(tree))
    protocol = next(tree[0].glob("protocols/*.json"))
    protocol.write_text(protocol.read_text("utf-8").replace("frozen", "draft"), "utf-8")
    assert hash_of(tree) not in hashes


def test_a_change_of_pages_charts_and_reports_does_not(tree: tuple[Path, Path]) -> None:
    before = hash_of(tree)
    for name in NOT_SCORING:
        path = tree[0] / name
        path.write_text(path.read_text("utf-8") + "# changed\n", "utf-8")
    shutil.rmtree(tree[1] / "generation")
    assert hash_of(tree) == before


def test_the_modules_are_all_that_scoring_loads() -> None:
    command = "import benchmark.score, sys; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, check=True, cwd=BENCHMARK.parent
    )
    loaded = {name for name in done.stdout.split() if name.partition(".")[0] in ("benchmark", "kit1000")}
    assert loaded <= set(evaluator_modules())


def test_imports_inside_functions_count_and_those_for_type_checkers_do_not(tmp_path: Path) -> None:
    for name, text in {
        "benchmark/__init__.py": "",
        "benchmark/score.py": "from typing import TYPE_CHECKING\n\n\ndef score():\n    from kit1000 import inner\n\n\n"
        "if TYPE_CHECKING:\n    from kit1000 import types_only\n",
        "kit1000/__init__.py": "",
        "kit1000/inner.py": "try:\n    import kit1000.pack.deep\nexcept ImportError:\n    pass\n",
        "kit1000/pack/__init__.py": "",
        "kit1000/pack/deep.py": "",
        "kit1000/types_only.py": "",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, "utf-8")
    assert set(evaluator_modules(tmp_path / "benchmark", tmp_path / "kit1000")) == {
        "benchmark",
        "benchmark.score",
        "kit1000",
        "kit1000.inner",
        "kit1000.pack",
        "kit1000.pack.deep",
    }


def test_the_commit_is_unknown_outside_a_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "BENCHMARK", tmp_path / "benchmark")
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert provenance.commit.__wrapped__() == "unknown"
