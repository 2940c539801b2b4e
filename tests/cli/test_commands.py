"""Tests of the command line: results on stdout, errors as one line on stderr, exit status as documented."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import MISSING, fields
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import kit1000
from kit1000.cli import COMMANDS, main
from kit1000.cli.summaries import summary_text
from kit1000.export import own_part
from kit1000.generation import build, scene_files
from kit1000.generation.build import generate
from kit1000.generation.presets import preset
from kit1000.kits.kit import design_kit
from kit1000.kits.kit_trials import NOT_SEATED, Attempt
from kit1000.mesh import Mesh
from kit1000.parts.family import part_of_mesh
from tests.samples.checkout import ROOT
from tests.samples.mini import MINI, fake_scene, file_hashes, l_shape, l_shape_sources, write_stl

WIDTHS = (20, 24, 28, 33)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished dataset with fake scenes."""
    folder = tmp_path_factory.mktemp("data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_files, "make_scene", fake_scene)
        generate(MINI, folder / "data", workers=1, sources=l_shape_sources(folder / "files"))
    return folder / "data"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Valid and invalid mesh files."""
    folder = tmp_path_factory.mktemp("files")
    mesh = l_shape()
    good = write_stl(folder / "good.stl", mesh).read_bytes()
    (folder / "empty.stl").touch()
    (folder / "text.stl").write_text("Dear all, please find attached")
    (folder / "nan.stl").write_bytes(good.replace(np.float32(40).tobytes(), np.float32(np.nan).tobytes()))
    write_stl(folder / "flat.stl", Mesh(mesh.vertices * (1, 1, 1e-4), mesh.faces))
    write_stl(folder / "open.stl", Mesh(mesh.vertices, mesh.faces[3:]))
    (folder / "folder.stl").mkdir()
    return folder


def command(*arguments: object, **options) -> subprocess.Popen[str]:
    """The command in its own process and process group."""
    return subprocess.Popen(
        [sys.executable, "-m", "kit1000", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        start_new_session=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # tests run in the background ignore Ctrl-C
        **options,
    )


INTERRUPTED = "kit1000: interrupted; run the same command again to continue\n"
WRONG = {  # by what is typed: facts of the answer
    "": "{generate, kit, info, show, verify, export|kit1000 --help",
    "genrate tiny": "'genrate'|did you mean generate?|kit, info",
    "generate": "PRESET|--out|kit1000 generate --help",
    "generate tiny": "--out",
    "generate tiny --out": "--out|value",
    "generate tiny --ot {tmp}/out": "--out|--ot ",
    "generate tiny --out {tmp}/out --worker 2": "--worker, 2|--workers N",
    "generate tiny small --out {tmp}/out": "small|kit1000 generate --help",
    "generate tiny --out {tmp}/out --workers two": "--workers|int|'two'",
    "generate tiny --out {tmp}/out --workers 0": "--workers: expected 1 or more, got 0",
    "generate tiny --out {tmp}/out --seed -1": "--seed: expected 0 or more, got -1",
    "generate tiny --out {tmp}/out --seed=1.5": "--seed|int|'1.5'",
    "generate tiny --out {tmp}/out --seed " + "9" * 50: "root seed: expected 0 <= number < 2**128",
    "generate tyni --out {tmp}/out": "no preset 'tyni'|did you mean tiny?|small, kit1000, paper",
    "generate tiny --out {tmp}/out --parts {tmp}/none": "{tmp}/none: does not exist|a mesh file, a folder",
    "generate tiny --out {tmp}/out --parts {tmp}": "{tmp}: no mesh files inside; looked for .stl .obj",
    "generate tiny --out {tmp}/out --parts {files}/empty.stl": "none of 1 mesh files can be a part: 1x empty file (",
    "generate tiny --out {tmp}/out --unit mm": "--unit: |--parts",
    "generate tiny --out {tmp}/out --address auto": "--address: |--engine ray",
    "generate tiny --out {tmp}/out --withhold {tmp}/out": "--withhold: expected a folder outside --out {tmp}/out",
    "generate tiny --out {tmp}/out --withhold {tmp}/w --seed 7": "--seed: 7 can be guessed",
    "generate tiny --out {data} --withhold {tmp}/w": "{data} contains a full dataset|--out",
    "generate tiny --out {tmp}/w --withhold {data}": "--withhold: {data} |seed 7|can be guessed",
    "generate tiny --out {files}/good.stl": "cannot write to {files}/good.stl: Not a directory",
    "generate tiny --out {files}": "{files} is not empty|no dataset|--out",
    "kit --out {tmp}/out": "PARTS",
    "kit {files}/none.stl --out {tmp}/out": "{files}/none.stl: cannot be read: no such file or directory",
    "kit {files}/empty.stl --out {tmp}/out": "{files}/empty.stl: empty file",
    "kit {files}/text.stl --out {tmp}/out": "{files}/text.stl: not a mesh: text file",
    "kit {files}/nan.stl --out {tmp}/out": "{files}/nan.stl: NaN or infinite vertices: ",
    "kit {files} --out {tmp}/out": "{files}: is a folder, expected a mesh file",
    "kit {files}/folder.stl --out {tmp}/out": "{files}/folder.stl: is a folder, expected a mesh file",
    "kit {files}/flat.stl --out {tmp}/out": "{files}/flat.stl: zero thickness",
    "kit {files}/open.stl --out {tmp}/out": "{files}/open.stl: not closed: ",
    "kit {files}/good.stl --out {files}/good.stl": "cannot write to {files}/good.stl: Not a directory",
    "kit {files}/good.stl --out {tmp}/out --unit inches": "--unit|'inches'|'inch'",
    "kit {files}/good.stl --out {tmp}/out --clearance-mm 0": "--clearance-mm: expected 0.05 to 1000, got 0",
    "kit {files}/good.stl --out {tmp}/out --clearance-mm nan": "--clearance-mm: expected 0.05 to 1000, got nan",
    "kit {files}/good.stl --out {tmp}/out --fit_mm -4": "--fit-mm: expected 0.05 to 1000, got -4",
    "kit {files}/good.stl --out {tmp}/out --bodies all": "--bodies|'all'|'union', 'largest'",
    "info {tmp}": "{tmp}: no dataset (no dataset.json in it)",
    "info {tmp}/none": "{tmp}/none: no dataset (there is no such folder)",
    "show {tmp}": "{tmp}: no dataset (no dataset.json in it)",
    "show {data} --count 0": "--count: expected 1 or more, got 0",
    "show {data} --what part": "--what|'part'|'parts', 'kits', 'assemblies'",
    "show {data} --ids train-0000 x --out {tmp}/a.png": "{data}: no 'x' among 4 assemblies (test-0000,",
    "show {data} --count 1 --out {files}": "{files}|a folder",
    "show {data} --what kits --ids x": "no 'x' among",
    "show {data} --count 1 --out {files}/good.stl/sheet.png": "a file exists where a folder is needed",
    "show {data} --count 1 --out {files}/folder.stl": "--out {files}/folder.stl: |.png",
    "verify {tmp}": "{tmp}: no dataset (no dataset.json in it)",
    "verify {data} --sample -1": "--sample: expected 0 or more, got -1",
    "export {tmp} --out {tmp}/out": "{tmp}: no dataset (no dataset.json in it)",
    "export {data} --out {tmp}/out --truth": "--truth|--format mcap",
    "export {data} --out {tmp}/out --format mcap": "--ids",
}


@pytest.mark.usefixtures("quick_pictures")
@pytest.mark.parametrize("line", WRONG)
def test_wrong_usage_is_one_line(
    line: str, data: Path, files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {"{tmp}": str(tmp_path), "{data}": str(data), "{files}": str(files)}

    def placed(text: str) -> str:
        for name, path in places.items():
            text = text.replace(name, path)
        return text

    assert main(placed(line).split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("kit1000: ")
    assert all(placed(fact) in err for fact in WRONG[line].split("|"))
    assert err.count("\n") == 1
    assert not any(path.name != ".lock" and path.is_file() for path in tmp_path.rglob("*"))


def test_an_internal_error_is_one_line_with_its_source_line_and_another_status(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(own_part, "attempts", lambda *_: 1 / 0)
    assert main(["kit", str(files / "good.stl"), "--out", str(tmp_path)]) == 3
    err = capsys.readouterr().err
    assert err.startswith("kit1000: kit: ZeroDivisionError: division by zero (own_part.py:")
    assert err.count("\n") == 1


def test_the_report_of_a_kit_is_printed(files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["kit", str(files / "good.stl"), "--out", str(tmp_path / "out"), "--unit", "mm"]) == 0
    out, err = capsys.readouterr()
    assert "good.stl: 40.0 x 30.0 x 24.0 mm (as given)" in out
    assert "(requested 2.5)" in out
    assert out.endswith(f"files      {tmp_path / 'out'}\n")
    assert err == ""


def test_an_inexact_kit_ends_with_status_1_and_one_line(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    refused = Attempt(design_kit(part_of_mesh("good", l_shape())), None, NOT_SEATED)
    monkeypatch.setattr(own_part, "attempts", lambda *_: [refused])
    assert main(["kit", str(files / "good.stl"), "--out", str(tmp_path / "out"), "--unit", "mm"]) == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"kit1000: {files}/good.stl: the part does not seat at a goal of its kit; nothing is written")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("fake_scenes")
def test_generate_and_info_print_the_same_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    l_shape_sources(tmp_path / "files", (24, 30))
    line = ["generate", "tiny", "--out", f"{tmp_path}/out", "--parts", f"{tmp_path}/files", "--workers", "1"]
    assert main(line) == 0
    built = capsys.readouterr()
    assert "train      1 parts and kits,     1 assemblies,     1 scenes" in built.out
    assert built.err == ""
    assert main(["info", f"{tmp_path}/out"]) == 0
    assert capsys.readouterr().out == built.out
    assert main(line) == 0
    assert capsys.readouterr() == (built.out, f"{tmp_path}/out is complete: nothing to do\n")


@pytest.mark.usefixtures("quick_pictures")
@pytest.mark.parametrize("what", ["parts", "kits", "assemblies"])
def test_show_draws_every_kind(what: str, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / f"{what}.png"
    assert main(["show", str(data), "--out", str(picture), "--what", what, "--split", "train", "--count", "2"]) == 0
    assert capsys.readouterr() == (f"{picture}\n", "")
    with Image.open(picture) as image:
        assert image.size[0] > 2 * 400


def test_an_unfinished_dataset_is_named_as_such(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    l_shape_sources(tmp_path / "files", (24,))
    monkeypatch.setattr(build, "write_summary", interrupt)
    line = ["generate", "tiny", "--out", f"{tmp_path}/out", "--parts", f"{tmp_path}/files", "--workers", "1"]
    assert main(line) == 130
    assert capsys.readouterr().err == INTERRUPTED
    assert main(["info", f"{tmp_path}/out"]) == 2
    assert "not finished: run the same `kit1000 generate` again" in capsys.readouterr().err


TINY = preset("tiny")


def wait_for(folder: Path, pattern: str, run: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 240  # on busy cores
    while not any(folder.glob(pattern)):
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.usefixtures("fake_scenes")  # in this process: the command is interrupted before it makes one
@pytest.mark.parametrize("how", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_an_interrupted_generate_ends_in_one_line_and_can_be_continued(how: signal.Signals, tmp_path: Path) -> None:
    sources, out = l_shape_sources(tmp_path / "files", WIDTHS), tmp_path / "out"
    line = ["generate", "tiny", "--out", out, "--parts", tmp_path / "files", "--workers", "2"]
    run = command(*line)
    wait_for(out, ".build/parts/*.json", run)
    os.killpg(run.pid, how) if how == signal.SIGINT else run.send_signal(how)  # a terminal signals the whole group
    assert run.communicate(timeout=30) == ("", INTERRUPTED)
    assert run.returncode == 130
    assert not (out / "dataset.json").exists()
    generate(TINY, out, workers=1, sources=sources)
    generate(TINY, tmp_path / "whole", workers=1, sources=sources)
    assert file_hashes(out) == file_hashes(tmp_path / "whole")


def test_an_interrupted_kit_ends_in_one_line(files: Path, tmp_path: Path) -> None:
    pipe = tmp_path / "part.stl"
    os.mkfifo(pipe)
    run = command("kit", pipe, "--out", tmp_path / "out")
    writer = os.open(pipe, os.O_WRONLY)  # opens when the command has begun to read
    os.killpg(run.pid, signal.SIGINT)
    assert run.communicate(timeout=30) == ("", INTERRUPTED)
    os.close(writer)
    assert run.returncode == 130
    assert not (tmp_path / "out").exists()


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    run = command("--version")
    assert run.communicate(timeout=30) == (f"kit1000 {kit1000.__version__}\n", "")
    assert run.returncode == 0
    assert main(["-V"]) == 0
    assert capsys.readouterr().out == f"kit1000 {kit1000.__version__}\n"


def options_of(command: type) -> list[str]:
    """The options of a command."""
    optional = [field.name for field in fields(command) if field.default is not MISSING]
    return [f"--{name.replace('_', '-')}" for name in optional]


@pytest.mark.parametrize("line", [["--help"], *([name, "--help"] for name in COMMANDS)])
def test_help_names_every_command_and_option(line: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line) == 0
    out = capsys.readouterr().out
    assert "['None']" not in out
    assert "--no-" not in out.replace("--no-preview", "")
    options = options_of(COMMANDS[line[0]]) if line[1:] else COMMANDS
    assert all(word in out for word in options)


def test_help_loads_no_heavy_package() -> None:
    ask = "import kit1000.cli, sys; print(*sys.modules)"
    answer = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True, cwd=ROOT)
    heavy = {"scipy", "numba", "trimesh", "manifold3d", "PIL", "tqdm", "kit1000.mesh", "concurrent.futures.process"}
    assert heavy.isdisjoint(answer.stdout.split())


def test_the_text_of_a_summary_does_not_depend_on_its_order() -> None:
    counts = {split: {"parts": 1, "assemblies": 2, "scenes": 3} for split in ("test", "train", "val")}
    head = {"preset": "p", "dataset_id": "d", "seed": 1, "data_version": "v", "licence": "l"}
    redraws = {"parts": {"b": 1, "a": 1, "c": 2}, "scenes": {}}
    refused = {"refused": {"x.stl": "empty file"}, "refused_scenes": {"val-s0000": "no room"}}
    text = summary_text(head | {"counts": counts, "redraws": redraws} | refused)
    assert [line.split()[0] for line in text.splitlines()[1:4]] == ["train", "val", "test"]
    assert "redraws of parts: 2x c, 1x a, 1x b" in text
    assert "redraws of scenes: none" in text
    assert "refused x.stl: empty file" in text
    assert "refused val-s0000: no room" in text
    assert text.endswith("\n  3 of 4 mesh files taken as parts; the others: 1x empty file")
    assert "(seed withheld, " in summary_text(head | {"counts": counts, "redraws": {}, "seed": None} | refused)


def test_a_plate_beyond_a_usual_bed_is_noted(files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["kit", str(files / "good.stl"), "--out", str(tmp_path / "out"), "--unit", "mm", "--no-preview", "--fit-mm"]
    assert main([*line, "300"]) == 0
    note = "note       the plate is larger than the bed of a usual printer, 250 mm\n"
    assert note in capsys.readouterr().out
    assert main([*line, "200"]) == 0
    assert note not in capsys.readouterr().out
