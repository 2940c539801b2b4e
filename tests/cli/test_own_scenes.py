"""Commands on scenes without ground truth, and on a dataset.json that lacks something: one line, never a traceback."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from baselines.__main__ import main as baselines
from benchmark.__main__ import main as benchmark
from kit1000.cli import main
from kit1000.dataset.reader import Dataset
from kit1000.editor.scene import EditedScene
from kit1000.labelling.label_records import read_record
from kit1000.pose import Pose
from kit1000.submission import read_submission
from tests.samples.editing import desk
from tests.samples.labelled_scenes import SCENE, own_folder, shapes_folder

pytestmark = pytest.mark.usefixtures("quick_pictures")
TABLES = ("parts.json", "kits.json", "assemblies.json")


def linked(mini: Path, root: Path, keep: Callable[[Path], bool], summary: Any) -> Path:
    """A dataset folder with another dataset.json; keep: by path within the folder, which files it has."""
    for path in mini.rglob("*"):
        name = path.relative_to(mini)
        if path.is_file() and path.name not in ("dataset.json", ".lock") and keep(name):
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).symlink_to(path)
    root.mkdir(exist_ok=True)
    (root / "dataset.json").write_text(json.dumps(summary))
    return root


@pytest.fixture
def summary(mini: Path) -> dict[str, Any]:
    return json.loads((mini / "dataset.json").read_text())


@pytest.fixture
def own(mini: Path, tmp_path: Path, summary: dict[str, Any]) -> Path:
    """What a camera of one's own gives: images, masks and queries alone."""
    stated = {key: summary[key] for key in ("format", "dataset_id")}
    config = {"scale": 1.0, "curve_scenes": 0, "frames": 1, "tracks": summary["config"]["tracks"]}
    shards = {name: scenes for name, scenes in summary["shards"].items() if name.startswith("test/")}
    root = linked(
        mini,
        tmp_path / "own",
        lambda name: name.parts[0] == "test" and name.name == "0000.mcap",
        stated | {"config": config, "shards": shards},
    )
    for name in TABLES:
        (root / name).write_text("{}")
    return root


@pytest.fixture
def answers(own: Path, tmp_path: Path) -> Path:
    """A submission about the own scenes, by the page."""
    scene = EditedScene.open(Dataset(own), SCENE, "ideal", False)
    table = desk(scene, tmp_path / "answers", moves=True)
    part, plate = scene.parts[0], scene.plates[0]
    table.controller.place(part, Pose.from_translation(plate.point - scene.pivot(part)))
    table.controller.command("confirm")
    return tmp_path / "answers"


def lines_of(status: int, capsys: pytest.CaptureFixture[str], expected: int) -> list[str]:
    """The lines of stderr, without bars, of a command that ended as expected."""
    assert status == expected
    error = capsys.readouterr().err
    assert "Traceback" not in error
    assert "report" not in error
    return [line for line in error.splitlines() if "kit1000: " in line or "benchmark: " in line]


def test_own_scenes_are_edited_predicted_checked_shown_and_described(
    own: Path, answers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert read_submission(answers).manifest.dataset_checksum == ""
    assert (answers / "moves.json").is_file()
    assert main(["check", str(answers), "--data", str(own)]) in (0, 1)  # the other parts were not edited
    assert main(["info", str(own)]) == 0
    assert "1 scenes, no labels, clearance not stated, licence not stated" in capsys.readouterr().out
    assert main(["show", str(own), "--scene", SCENE, "--out", str(tmp_path / "scene.png")]) == 0
    method = ["predict", "registration-columns", "--data", str(own), "--out", str(tmp_path / "predicted")]
    assert main([*method, "--tracks", "snap", "--limit", "1", "--workers", "1"]) == 0
    assert len(read_submission(tmp_path / "predicted").predictions) == 1


def test_what_needs_ground_truth_says_in_one_line_that_there_is_none(
    own: Path, answers: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = ["run", str(own), "--predictions", str(answers), "--track", "snap"]
    for program, words in ((main, run), (benchmark, ["score", str(answers), "--data", str(own)])):
        (line,) = lines_of(program(words), capsys, 2)
        assert "without ground truth" in line
        assert "own camera" in line
    assert main(["verify", str(own)]) == 1
    said = capsys.readouterr().out
    assert "dataset.json: has no checksum" in said
    assert "without ground truth" in said


RARE = [pytest.param(key, marks=pytest.mark.slow) for key in ("files", "counts", "preset", "seed", "data_version")]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--part", "part.stl"], "--part: needs --kit FILE"),
        (["--kit", "kit.stl"], "--kit: needs --part FILE"),
        (["--shapes", "kit", "--kit", "kit.stl"], "either --shapes FOLDER, or --kit FILE and --part FILE"),
        (["--shapes", "kit", "--snap", "registration"], "--snap registration: reads no shapes"),
        (["--shapes", "kit", "--snap", "none"], "--snap none: reads no shapes"),
        (["--kit", "2"], "--kit: is for own depth images"),
    ],
)
def test_shapes_for_the_page_are_given_completely(
    options: list[str], message: str, own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (line,) = lines_of(main(["edit", str(own), *options]), capsys, 2)
    assert message in line


@pytest.mark.parametrize("key", ["checksum", "config", "shards", *RARE])
def test_a_missing_entry_is_one_line_or_no_matter(
    mini: Path, tmp_path: Path, summary: dict[str, Any], key: str, capsys: pytest.CaptureFixture[str]
) -> None:
    del summary[key]
    root = linked(mini, tmp_path / "data", lambda _: True, summary)
    for words in (
        ["info", str(root)],
        ["verify", str(root), "--sample", "1" if key in ("config", "seed") else "0"],
        ["show", str(root), "--scene", SCENE, "--out", str(tmp_path / "s.png")],
        ["predict", "registration-columns", "--data", str(root), "--out", str(tmp_path / "p"), "--limit", "1"]
        + ["--workers", "1", "--tracks", "snap"],
    ):
        status = main(words)
        assert status in (0, 1, 2)
        lines = lines_of(status, capsys, status)
        assert len(lines) == (status == 2)
        assert all("dataset.json" in line or str(root) in line for line in lines)


def test_a_dataset_without_scenes_has_nothing_to_check_or_score(
    mini: Path, tmp_path: Path, summary: dict[str, Any], answers: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    del summary["shards"]
    root = linked(mini, tmp_path / "data", lambda _: True, summary)
    for program, words in ((main, ["check"]), (benchmark, ["score"])):
        (line,) = lines_of(program([*words, str(answers), "--data", str(root)]), capsys, 2)
        assert str(root) in line


@pytest.mark.parametrize("key", ["config", "counts", "files", "shards"])
@pytest.mark.parametrize("value", [None, [1], 3, "x"])
def test_an_entry_of_another_kind_is_one_line(
    mini: Path, tmp_path: Path, summary: dict[str, Any], key: str, value: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    root = linked(mini, tmp_path / "data", lambda _: False, summary | {key: value})
    (line,) = lines_of(main(["info", str(root)]), capsys, 2)
    assert f"dataset.json: {key}: expected an object" in line


@pytest.mark.parametrize("text", ["[]", '{"test-0000": 3}', '{"test-0000": {}}', "{}", "3", ""])
def test_a_damaged_or_empty_table_is_one_line(
    mini: Path, tmp_path: Path, summary: dict[str, Any], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    root = linked(mini, tmp_path / "data", lambda name: name.name not in TABLES, summary)
    for name in TABLES:
        (root / name).write_text(text)
    (line,) = lines_of(main(["show", str(root), "--out", str(tmp_path / "a.png")]), capsys, 2)
    assert str(root) in line


@pytest.mark.slow
def test_an_own_scene_is_labelled_confirmed_and_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = own_folder(tmp_path / "mine")
    shapes_folder(tmp_path / "shapes")
    status = main(["label", str(root), "--shapes", str(tmp_path / "shapes")])
    told, sure = capsys.readouterr().out, [body.sure for body in read_record(root, SCENE).bodies]
    assert status == (0 if all(sure) else 1)
    assert told.count("; sure\n") == sum(sure)
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
