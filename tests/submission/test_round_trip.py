"""Submissions: written values are read back bit for bit, and values that could not be read are never written."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.errors import InputError
from kit1000.pose import Pose, random_quaternions
from kit1000.submission import (
    Predictions,
    check,
    read_manifest,
    read_predictions,
    read_submission,
    write_manifest,
    write_predictions,
    write_submission,
)
from kit1000.values import Prediction
from tests.samples.submissions import manifest

MANIFEST = manifest("0123456789abcdef", authors=("A. Name", "B. Name"), tracks=("snap",), uses_true_geometry=False)
NUMBERS = st.floats(-1e5, 1e5, allow_subnormal=True)


def random_predictions(n: int = 20, seed: int = 0) -> Predictions:
    rng = np.random.default_rng(seed)
    motions = Pose(random_quaternions(rng, n), rng.normal(0, 0.3, (n, 3)))
    ids = tuple(f"test-s{i:04d}-p0-snap" for i in range(n))
    return Predictions(ids, motions, rng.uniform(size=n), rng.exponential(size=n))


def same(a: Predictions, b: Predictions) -> bool:
    """Equal to the last bit, the sign of zero included."""
    pairs = ((a.motions.wxyz, b.motions.wxyz), (a.motions.xyz, b.motions.xyz), (a.confidence, b.confidence))
    bits = all(x.tobytes() == y.tobytes() for x, y in (*pairs, (a.seconds, b.seconds)))
    return bits and a.query_ids == b.query_ids


@given(st.integers(0, 2**32 - 1), st.lists(NUMBERS, min_size=3, max_size=3), st.floats(0, 1), st.floats(0, 1e300))
@settings(max_examples=100)
def test_numbers_come_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, seed: int, xyz: list[float], confidence: float, seconds: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "predictions.csv"
    motions = Pose(random_quaternions(np.random.default_rng(seed), 1), np.array([xyz]))
    written = Predictions(("a",), motions, np.array([confidence]), np.array([seconds]))
    write_predictions(path, written)
    assert same(read_predictions(path), written)


def test_a_folder_comes_back_as_it_was_written(tmp_path: Path) -> None:
    predictions = random_predictions()
    write_submission(tmp_path / "mine", MANIFEST, predictions)
    read = read_submission(tmp_path / "mine")
    assert (read.name, read.manifest, read.folder) == ("mine", MANIFEST, tmp_path / "mine")
    assert same(read.predictions, predictions)
    assert sorted(path.name for path in (tmp_path / "mine").iterdir()) == ["manifest.toml", "predictions.csv"]


def test_written_files_have_no_faults_and_equal_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_submission(tmp_path / name, replace(MANIFEST, control=True), random_predictions())
    assert check(tmp_path / "a").faults == ()
    data = (tmp_path / "a/predictions.csv").read_bytes()
    assert data == (tmp_path / "b/predictions.csv").read_bytes()
    assert (data.isascii(), b"\r" in data, data[-1:]) == (True, False, b"\n")


def test_single_predictions_can_be_collected(tmp_path: Path) -> None:
    predictions = random_predictions()
    rows = [
        Prediction(*row) for row in zip(predictions.query_ids, predictions.motions, predictions.confidence,
                                        predictions.seconds, strict=True)
    ]  # fmt: skip
    assert same(Predictions.of(rows), predictions)
    for some in (predictions, Predictions.of([])):
        write_predictions(tmp_path / "p.csv", iter(rows[: len(some)]))
        assert same(read_predictions(tmp_path / "p.csv"), some)


def test_a_prediction_is_found_by_its_query() -> None:
    predictions = random_predictions()
    assert [predictions.row(query_id) for query_id in predictions.query_ids] == list(range(len(predictions)))
    assert predictions.row("test-s9999-p0-snap") is None


@pytest.mark.parametrize(
    ("changes", "facts"),
    [
        ({"query_ids": ("a", "b", "a")}, ('"a"', "one per query")),
        ({"query_ids": ("a", "b", "c,d")}, ('"c,d"',)),
        ({"query_ids": ("a", "b", "")}, ('""',)),
        ({"query_ids": ("a", "b", "query_id")}, ('"query_id"',)),
        ({"query_ids": ("a", "b")}, ("confidence",)),
        ({"confidence": np.array([0, 1, 1.1])}, ("confidence of c", "0 to 1", "1.1")),
        ({"confidence": np.array([0, 1, np.nan])}, ("not finite",)),
        ({"seconds": np.array([0, -1, -2.0])}, ("seconds of c", "0 or more")),
        ({"motions": Pose.identity()}, ("motions", "3")),
        ({"motions": Pose.from_translation(np.full((3, 3), 1e7))}, ("x of a", "metres")),
    ],
)
def test_predictions_that_could_not_be_read_are_refused(changes: dict, facts: tuple[str, ...]) -> None:
    good = Predictions(("a", "b", "c"), Pose.identity((3,)), np.ones(3), np.zeros(3))
    with pytest.raises(InputError) as caught:
        replace(good, **changes)
    assert all(fact in str(caught.value) for fact in facts)


@pytest.mark.parametrize(
    "changes",
    [
        {"tracks": ("snap", "plaec")}, {"tracks": ()}, {"predicts": "position"}, {"date": "yesterday"}, {"learned": 1},
        {"method": ""}, {"authors": ("",)}, {"url": "ftp://example.org"}, {"camera_set": "none"},
    ],
)  # fmt: skip
def test_manifest_values_that_could_not_be_read_are_refused_by_name(changes: dict) -> None:
    with pytest.raises(InputError) as caught:
        replace(MANIFEST, **changes)
    assert f"manifest: {next(iter(changes))} = " in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_table_shows_the_label_or_the_name_of_the_method() -> None:
    assert MANIFEST.display_name == MANIFEST.method
    assert replace(MANIFEST, label="Short").display_name == "Short"


TEXT = st.text(st.characters(exclude_categories=["Cs", "Cc"]) | st.sampled_from("\n\t\\\"'#"), min_size=1, max_size=40)


@given(TEXT.filter(str.strip), TEXT, st.booleans())
@settings(max_examples=100)
def test_a_manifest_comes_back_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, description: str, training_data: str, learned: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "manifest.toml"
    written = replace(MANIFEST, description=description, training_data=training_data, learned=learned)
    write_manifest(path, written)
    assert read_manifest(path) == written


def test_the_reader_reports_the_first_fault_and_the_command_that_lists_all(tmp_path: Path) -> None:
    write_submission(tmp_path, MANIFEST, random_predictions(3))
    path = tmp_path / "predictions.csv"
    lines = path.read_text().split("\n")
    path.write_text("\n".join([*lines[:2], lines[2].replace("test", "te st"), lines[3] + ",1", ""]))
    with pytest.raises(InputError) as caught:
        read_submission(tmp_path)
    assert str(caught.value).startswith(f"{path}:3: query_id = ")
    assert str(caught.value).endswith("(`kit1000 check` lists all faults)")


def test_write_errors_have_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for write in (
        lambda: write_submission(tmp_path / "file", MANIFEST, random_predictions()),
        lambda: write_predictions(tmp_path / "file/p.csv", random_predictions()),
        lambda: write_manifest(tmp_path / "file/m.toml", MANIFEST),
    ):
        with pytest.raises(InputError, match="cannot write"):
            write()


def test_an_interrupted_write_leaves_no_complete_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_submission(tmp_path, MANIFEST, random_predictions())

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("kit1000.submission.folder.write_predictions", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_submission(tmp_path, MANIFEST, random_predictions(3))
    with pytest.raises(InputError, match="does not exist"):
        read_submission(tmp_path)


def test_reading_a_submission_does_not_import_the_dataset_reader() -> None:
    import subprocess

    ask = "import sys, kit1000.submission; print('kit1000.dataset.reader' in sys.modules, 'numba' in sys.modules)"
    answer = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    assert answer.stdout.split() == ["False", "False"]
