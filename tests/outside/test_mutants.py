"""The program of `make mutants` changes one place of a module at a time, and counts the changes that tests notice."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from bench.outside import mutants
from bench.outside.mutants import LEAST_SHARE, MODULES, Mutant, Options, changed, is_killed, main, places, sampled
from tests.samples.checkout import ROOT

MODULE = "def half(x: int | None) -> float:\n    return x / 2 if x > 0 and x == x else 0.0\n"
TEST = "from half import half\n\n\ndef test_half():\n    assert half(4) == 2\n"


def test_every_operator_comparison_and_number_has_a_change_but_no_annotation() -> None:
    found = [changed(MODULE, k) for k in range(len(places(ast.parse(MODULE))))]
    ends = {change.partition(" -> ")[2] for _, change in found}
    assert ends == {"x > 0 or x == x", "x * 2", "x <= 0", "x != x", "3", "1", "1.0"}
    assert len({ast.dump(ast.parse(source)) for source, _ in found} | {ast.dump(ast.parse(MODULE))}) == len(found) + 1


def test_the_sample_is_of_scored_modules_and_the_same_for_a_seed() -> None:
    some = sampled(Options(count=20))
    assert some == sampled(Options(count=20)) != sampled(Options(count=20, seed=1))
    assert {mutant.file for mutant in sampled(Options(("metrics/volumes",)))} == {"kit1000/metrics/volumes.py"}
    assert all((ROOT / name).exists() for tests in MODULES.values() for name in tests)
    with pytest.raises(SystemExit, match="no file has a name with nothing"):
        main(Options(("nothing",)))


@pytest.mark.slow
def test_a_change_dies_when_a_test_fails_and_is_undone(tmp_path: Path) -> None:
    (tmp_path / "half.py").write_text(MODULE)
    (tmp_path / "test_half.py").write_text(TEST)
    killed = [
        is_killed(Mutant("half.py", k, ("test_half.py",)), tmp_path) for k in range(len(places(ast.parse(MODULE))))
    ]
    survivors = {name.partition(" -> ")[2] for died, name in killed if not died}
    assert survivors == {"x > 0 or x == x", "1", "1.0"}
    assert (tmp_path / "half.py").read_text() == MODULE


@pytest.mark.parametrize(("died", "status"), [(20, 0), (16, 0), (15, 1)])
def test_the_exit_status_says_whether_enough_die(
    died: int, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert LEAST_SHARE == 0.8
    monkeypatch.setattr(mutants, "sampled", lambda _: [Mutant("a.py", k, ("a",)) for k in range(20)])
    monkeypatch.setattr(mutants, "copy_tree", lambda tree: None)
    monkeypatch.setattr(mutants, "pytest_status", lambda tree, tests: (0, ""))
    monkeypatch.setattr(mutants, "is_killed", lambda mutant, tree: (mutant.place < died, f"a.py:{mutant.place}"))
    assert main(Options()) == status
    printed = capsys.readouterr().out
    assert f"{died} of 20 died" in printed
    assert printed.count("SURVIVED a.py:") == 20 - died
    monkeypatch.setattr(mutants, "pytest_status", lambda tree, tests: (1, "1 failed"))
    with pytest.raises(SystemExit, match="the tests fail without any change\n1 failed"):
        main(Options())
