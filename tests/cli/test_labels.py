"""The command `label`: from an own scene to a score, and wrong usage in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from baselines.__main__ import main as baselines
from benchmark.__main__ import main as benchmark
from kit1000.cli import main
from kit1000.dataset.reader import Dataset
from kit1000.labelling.label_records import read_record
from tests.samples.labelled_scenes import SCENE, own_folder, shapes_folder


@pytest.mark.slow
def test_an_own_scene_is_labelled_confirmed_and_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = own_folder(tmp_path / "mine")
    shapes_folder(tmp_path / "shapes")
    status = main(["label", str(root), "--shapes", str(tmp_path / "shapes")])
    told = capsys.readouterr().out
    assert status == (0 if all(body.sure for body in read_record(root, SCENE).bodies) else 1)
    assert "kits: depths " in told
    assert f"labels/{SCENE}.png" in told
    assert main(["label", str(root), "--confirm", "all", "--by", "A. Person"]) == 0
    assert "without truth: none" in capsys.readouterr().out
    assert read_record(root, SCENE).confirmed
    assert baselines(["predict", "guess", "--data", str(root), "--out", str(tmp_path / "guess")]) == 0
    assert benchmark(["score", str(tmp_path / "guess"), "--data", str(root)]) == 0
    scores = json.loads((tmp_path / "guess/scores.json").read_text("utf-8"))
    assert scores["tracks"]["snap-d415"]["n"] == 1
    assert scores["dataset_id"] == Dataset(root).id


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "either --shapes FOLDER, or --kit FILE and --part FILE"),
        (["--kit", "kit.stl"], "--kit: needs --part FILE"),
        (["--shapes", "s", "--part", "p.stl"], "--part: is for --kit"),
        (["--kit", "k.stl", "--part", "p.stl", "--clearance-mm", "0"], "--clearance-mm: expected 0.05 to 100, got 0"),
        (["--scene", "test-s0009"], "no scene 'test-s0009'"),
        (["--confirm", "all", "--by", "A"], "no labels to confirm"),
        (["--confirm", "all", "--by", "A", "--kit", "k.stl"], "--kit: not allowed with --confirm"),
        (["--page"], "no file"),
    ],
)
def test_wrong_usage_is_one_line(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = own_folder(tmp_path)
    before = sorted(root.rglob("*"))
    assert main(["label", str(root), *options]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
    assert sorted(root.rglob("*")) == before


def test_a_generated_dataset_is_not_labelled(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = own_folder(tmp_path)
    (root / "plan.json").write_text("{}")
    assert main(["label", str(root), "--shapes", str(root)]) == 2
    assert "a generated dataset, whose truth is known" in capsys.readouterr().err
