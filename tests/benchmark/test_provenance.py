"""The commit and the evaluator hash over exactly the sources that scoring imports; the cache of results by these."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmark import provenance, quantities
from benchmark import provenance as module
from benchmark.evaluate import PerQuery
from benchmark.provenance import BENCHMARK, LIBRARY, ResultCache, cache_key, evaluator, evaluator_modules
from benchmark.report import json_text
from benchmark.score import score
from kit1000 import Dataset
from kit1000.pose import Pose
from kit1000.submission import Predictions
from tests.samples.submissions import ground_truth, predicted, predictions

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


IDS = ("test-s0000-p0-snap", "test-s0001-p0-snap")
MOTIONS = (Pose.identity(), Pose.from_rotvec((0.1, 0.2, 0.3), (1, 2, 3)))


def key(given: Predictions | None = None, id: str = "abc", checksum: str | None = "123", **options: Any) -> str:
    dataset: Any = SimpleNamespace(id=id, summary={"checksum": checksum})
    defaults = {"split": "test", "tracks": ("snap",), "rotation_only": False, "exact": "near"}
    return cache_key(given or predictions(IDS, MOTIONS), dataset, **defaults | options)


def rows(n: int = 3) -> PerQuery:
    names = {*PerQuery.__dataclass_fields__, *(quantity.key for quantity in quantities.per_query())}
    numbers = {name: np.arange(n) / 7 for name in names}
    texts = {
        name: np.array([f"{name}{i}" for i in range(n)]) for name in ("query_id", "track", "assembly_id", "part_id")
    }
    return PerQuery.of_columns(numbers | texts | {"seated": np.arange(n) > 1})


def never() -> PerQuery:
    raise AssertionError("a cached result must not be measured again")


def test_an_entry_is_returned_as_it_was_measured(tmp_path: Path) -> None:
    cache, made = ResultCache(tmp_path / "cache"), rows()
    assert cache.rows(key(), lambda: made) is made
    found = cache.rows(key(), never)
    for name, column in made.columns().items():
        assert np.array_equal(found.columns()[name], column), name
        assert found.columns()[name].dtype == column.dtype, name


def test_scores_from_the_cache_are_fresh_ones_to_the_byte(mini: Path, tmp_path: Path) -> None:
    dataset = Dataset(mini)
    submission = predicted(tmp_path / "truth", dataset, ground_truth)
    fresh = score(submission, dataset)
    cache = ResultCache(tmp_path / "cache")
    for _ in range(2):
        assert json_text(score(submission, dataset, cache=cache).summary) == json_text(fresh.summary)
    assert len(list((tmp_path / "cache").iterdir())) == 1


def test_every_change_changes_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    nudged = Pose(MOTIONS[1].wxyz, MOTIONS[1].xyz + (0, 0, 1e-12))
    rotated = Pose.from_rotvec((0.1, 0.2, 0.3 + 1e-12), MOTIONS[1].xyz)
    others = [
        predictions(IDS, (MOTIONS[0], nudged)),
        predictions(IDS, (MOTIONS[0], rotated)),
        predictions(IDS, MOTIONS, confidence=0.75),
        predictions((IDS[0], "test-s0002-p0-snap"), MOTIONS),
        predictions(IDS[:1], MOTIONS[:1]),
    ]
    keys = [key(), *map(key, others), key(id="abd"), key(checksum="124"), key(checksum=None)]
    keys += [key(split="val"), key(exact="all"), key(tracks=("snap", "place")), key(rotation_only=True)]
    monkeypatch.setattr(module, "evaluator", lambda: "another")
    keys.append(key())
    assert len(set(keys)) == len(keys)


def test_the_same_predictions_have_the_same_key() -> None:
    assert key() == key(predictions(IDS, MOTIONS))


@pytest.mark.parametrize("cut", [0, 10, 500, -1])
def test_a_damaged_entry_is_measured_again(cut: int, tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    cache.rows(key(), rows)
    (entry,) = tmp_path.iterdir()
    entry.write_bytes(entry.read_bytes()[:cut])
    assert len(cache.rows(key(), lambda: rows(5))) == 5
    assert len(cache.rows(key(), never)) == 5


def test_an_entry_that_was_altered_is_measured_again(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    cache.rows(key(), rows)
    (entry,) = tmp_path.iterdir()
    data = bytearray(entry.read_bytes())
    data[len(data) // 2] ^= 0xFF
    entry.write_bytes(bytes(data))
    assert len(cache.rows(key(), lambda: rows(5))) in (3, 5)  # 3 where the byte stood in no array


def test_a_result_that_cannot_be_cached_is_returned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    made = rows()
    assert ResultCache(tmp_path / "file").rows(key(), lambda: made) is made
    assert capsys.readouterr().err.startswith("note: the result is not cached: cannot write")
