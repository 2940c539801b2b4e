"""The cache of results: what it hands back is what was measured, and every change of an answer is measured anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from answered import answered, predictions, the_truth

from benchmark import cache as module
from benchmark.cache import COLUMNS, ResultCache, key_of, user_folder
from benchmark.per_query import PerQuery
from benchmark.report import json_text
from benchmark.score import score
from kit1000 import Dataset
from kit1000.pose import Pose
from kit1000.submission import Predictions

IDS = ("test-s0000-p0-snap", "test-s0001-p0-snap")
MOTIONS = (Pose.identity(), Pose.from_rotvec((0.1, 0.2, 0.3), (1, 2, 3)))


def key(given: Predictions | None = None, dataset_id: str = "abc", split: str = "test", judge: str = "near") -> str:
    return key_of(given or predictions(IDS, MOTIONS), dataset_id, split, ("snap",), False, judge)


def rows(n: int = 3) -> PerQuery:
    numbers = {name: np.arange(n) / 7 for name in COLUMNS}
    texts = {name: np.array([f"{name}{i}" for i in range(n)]) for name in ("query_id", "track", "assembly_id")}
    return PerQuery(**numbers | texts | {"seated": np.arange(n) > 1})


def never() -> PerQuery:
    raise AssertionError("what is kept must not be measured again")


def test_what_is_kept_is_what_was_measured(tmp_path: Path) -> None:
    cache, made = ResultCache(tmp_path / "kept"), rows()
    assert cache.rows(key(), lambda: made) is made
    found = cache.rows(key(), never)
    for name, column in made.columns().items():
        assert np.array_equal(getattr(found, name), column), name
        assert getattr(found, name).dtype == column.dtype, name


def test_scores_from_the_cache_are_fresh_ones_to_the_byte(mini: Path, tmp_path: Path) -> None:
    dataset = Dataset(mini)
    submission = answered(tmp_path / "truth", dataset, the_truth)
    fresh = score(submission, dataset)
    cache = ResultCache(tmp_path / "kept")
    for _ in range(2):
        assert json_text(score(submission, dataset, cache=cache).summary) == json_text(fresh.summary)
    assert len(list((tmp_path / "kept").iterdir())) == 1


def test_every_change_changes_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    nudged = Pose(MOTIONS[1].wxyz, MOTIONS[1].xyz + (0, 0, 1e-12))
    turned = Pose.from_rotvec((0.1, 0.2, 0.3 + 1e-12), MOTIONS[1].xyz)
    others = [
        predictions(IDS, (MOTIONS[0], nudged)),
        predictions(IDS, (MOTIONS[0], turned)),
        predictions(IDS, MOTIONS, confidence=0.75),
        predictions((IDS[0], "test-s0002-p0-snap"), MOTIONS),
        predictions(IDS[:1], MOTIONS[:1]),
    ]
    keys = [key(), *map(key, others), key(dataset_id="abd"), key(split="val"), key(judge="all")]
    keys += [key_of(predictions(IDS, MOTIONS), "abc", "test", ("snap", "place"), False, "near")]
    keys += [key_of(predictions(IDS, MOTIONS), "abc", "test", ("snap",), True, "near")]
    monkeypatch.setattr(module, "evaluator", lambda: "another")
    keys.append(key())
    assert len(set(keys)) == len(keys)


def test_the_same_answers_have_the_same_key() -> None:
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


def test_a_result_that_cannot_be_kept_is_handed_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    made = rows()
    assert ResultCache(tmp_path / "file").rows(key(), lambda: made) is made
    assert capsys.readouterr().err.startswith("note: the result is not kept: cannot write")


def test_results_are_kept_where_the_user_keeps_such_things(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_folder() == tmp_path / "kit1000/scores"
