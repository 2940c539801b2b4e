"""The scripts in examples/ and the Python of README and guides: short, runnable, and built on public names."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from kit1000 import Dataset
from kit1000.testing import check_predictor
from tests.samples.checkout import ROOT
from tests.samples.mini import l_shape, write_stl

SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
LONGEST = 75
"""Lines of a script."""
PUBLIC = (
    "kit1000",
    "kit1000.dataset.torch",
    "kit1000.export",
    "kit1000.gym",
    "kit1000.parts",
    "kit1000.testing",
    "kit1000.voxels",
)
"""Where a script may import names of the library from; the applications are public as a whole."""


@pytest.fixture
def tiny(mini: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the dataset `tiny` in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny").symlink_to(mini)
    return tmp_path


def run(name: str, *arguments: str) -> None:
    """Run a script as its command line does."""
    kept, sys.argv = sys.argv, [f"examples/{name}.py", *arguments]
    try:
        runpy.run_path(str(ROOT / "examples" / f"{name}.py"), run_name="__main__")
    finally:
        sys.argv = kept


def test_reading_a_dataset_prints_a_query_and_its_ground_truth(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("read_dataset", "tiny")
    printed = capsys.readouterr().out
    assert f"dataset {Dataset('tiny').id}" in printed
    assert re.search(r"query val-s0000-p\d-snap: depth image \(720, 1280\), [1-9]\d+ points", printed)
    assert re.search(r"rotated by \d+\.\d degrees from its goal", printed)


def test_a_query_is_drawn_with_its_part_guess_and_goal(tiny: Path) -> None:
    run("draw_query", "tiny", "--out", "query.png")
    colours = {colour for _, colour in Image.open("query.png").convert("RGB").getcolors(1 << 16) or ()}
    assert {(232, 114, 42), (60, 120, 200), (40, 160, 80)} <= colours


def test_the_submission_is_valid_and_scores_as_the_guess(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("submit_and_score", "tiny", "--out", "my-submission")
    printed = capsys.readouterr().out
    assert re.search(r"position \d+\.\d mm, rotation \d+\.\d degrees", printed)
    assert "the submission is in my-submission" in printed
    assert (tiny / "my-submission/predictions.csv").is_file()


def test_a_network_is_trained(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    run("train_network", "tiny", "--epochs", "2")
    assert re.search(r"validation: \d+\.\d mm left on \d queries", capsys.readouterr().out)


def test_a_kit_is_made_for_an_stl_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("kit_for_stl", str(write_stl(tmp_path / "corner.stl", l_shape())), "--out", str(tmp_path / "kit"))
    assert "corner.stl, read in mm: 40 x 30 x 24 mm" in capsys.readouterr().out
    assert {"kit.stl", "part.stl", "preview.png"} <= {path.name for path in (tmp_path / "kit").iterdir()}


@pytest.mark.parametrize("name", ["own_family", "own_sensor", "own_method"])
def test_an_extension_passes_its_check(name: str, tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(name, *(["tiny"] if name != "own_family" else []))
    assert capsys.readouterr().out


def test_an_environment_scores_the_true_motion(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("gymnasium")
    run("gym_snap", "tiny", "--episodes", "1")
    assert re.search(r"truth: reward 1, 0\.0 mm off", capsys.readouterr().out)


def test_a_scene_settles_in_mujoco(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco")
    run("mujoco_scene", "tiny")
    assert re.search(r"parts moved by 0\.\d+ mm", capsys.readouterr().out)


def imported(script: Path) -> set[str]:
    """The modules of ours that a script imports from."""
    nodes = ast.walk(ast.parse(script.read_text(encoding="utf-8")))
    names = {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    return {name for name in names if name.partition(".")[0] == "kit1000"}


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_is_short_and_uses_public_names(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    assert text.startswith(f'"""python examples/{script.name}')  # the command to type
    assert len(text.splitlines()) <= LONGEST
    assert imported(script) <= set(PUBLIC)


def test_the_page_lists_every_script() -> None:
    page = (ROOT / "docs/guides/examples.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^\| `(\w+\.py)`", page, re.MULTILINE)) == [script.name for script in SCRIPTS]


def test_the_code_of_the_readme_runs(tiny: Path) -> None:
    names: dict[str, Any] = {}
    for block in blocks("README.md"):
        exec(block, names)
    assert names["part"].any()
    assert names["kits"].any()
    check_predictor(names["predict"], Dataset("tiny").split("val").queries("snap"))


@pytest.mark.parametrize("name", ["calibration", "completion", "restoration", "segmentation"])
def test_the_code_of_methods_runs(name: str, tiny: Path) -> None:
    track = "snap" if name == "completion" else "snap-d415"
    names: dict[str, Any] = {"query": next(Dataset("tiny").split("val").queries(track))}
    shown = blocks(f"docs/methods/{name}.md")
    assert shown
    for block in shown:
        exec(block, names)


def blocks(page: str) -> list[str]:
    """The Python blocks of a page that need a dataset."""
    return re.findall(r"^```py\n(.*?)^```", (ROOT / page).read_text(encoding="utf-8"), re.M | re.S)


def test_the_network_of_the_guide_learns(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    exec(blocks("docs/guides/write-a-method.md")[0], {})
    losses = [float(line.split()[2]) for line in capsys.readouterr().out.splitlines()]
    assert losses[0] > 15  # [mm] about the error of the guess
    assert losses[-1] < losses[0] / 2
