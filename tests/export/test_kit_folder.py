"""The folder of a kit is new, or of an earlier run: nobody's file is ever overwritten or deleted."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from kit1000.cli import main
from kit1000.errors import InputError
from kit1000.export.own_part import KitOptions, make_kit_from_file, make_kits
from kit1000.pictures import previews
from tests.samples.mini import file_hashes, l_shape, write_stl

NAMES = ("kit.stl", "part.stl", "seated.glb", "preview.png", "report.json")


@pytest.fixture(scope="module", autouse=True)
def _picture() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(previews, "kit_preview", lambda *_: b"picture")
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    make_kit_from_file(write_stl(folder / "corner.stl", l_shape()), folder / "out")
    return folder


def test_the_part_itself_is_never_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    part = write_stl(tmp_path / "part.stl", l_shape())
    before = part.read_bytes()
    monkeypatch.chdir(tmp_path)
    for out in (".", str(tmp_path), "../" + tmp_path.name):
        assert main(["kit", "part.stl", "--out", out]) == 2
        assert "part.stl: is not of an earlier run" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["part.stl"]
    assert part.read_bytes() == before


@pytest.mark.parametrize("name", [*NAMES, "notes.txt", "01/kit.stl"])
@pytest.mark.parametrize("beside_a_kit", [False, True])
def test_a_file_of_another_origin_stays(
    name: str, beside_a_kit: bool, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    if beside_a_kit:
        shutil.copytree(made / "out", out)
    (out / name).parent.mkdir(parents=True, exist_ok=True)
    (out / name).write_text('{"mine": 1}')
    before = file_hashes(out)
    assert main(["kit", str(made / "corner.stl"), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "is not of an earlier run of this command: it stays; choose another --out" in said
    assert said.count("\n") == 1
    assert file_hashes(out) == before


def test_a_report_that_was_changed_is_not_of_a_run(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "out", tmp_path / "out")
    path = tmp_path / "out/report.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"note": "mine"}))
    assert main(["kit", str(made / "corner.stl"), "--out", str(tmp_path / "out")]) == 2


def test_the_folder_of_an_earlier_run_is_written_again(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(made / "out", out)
    (out / ".DS_Store").write_text("of the system")
    report = make_kit_from_file(made / "corner.stl", out, KitOptions(2e-3))
    assert json.loads((out / "report.json").read_bytes()) == report
    assert sorted(file_hashes(out)) == sorted([*NAMES, ".DS_Store"])
    make_kit_from_file(made / "corner.stl", out, KitOptions(preview=False))
    assert not (out / "preview.png").exists()  # that of the earlier run would show another kit


@pytest.mark.parametrize("bodies", [None, "each"])
def test_reports_of_several_kits_replace_their_own_alone(bodies, made: Path, tmp_path: Path) -> None:
    files = [made / "corner.stl"] * (1 if bodies else 2)
    for _ in range(2):
        list(make_kits(files, tmp_path, KitOptions(bodies=bodies), 1))
    (tmp_path / "report.json").write_text('{"mine": 1}')
    with pytest.raises(InputError, match=r"report\.json: is not of an earlier run"):
        list(make_kits(files, tmp_path, KitOptions(bodies=bodies), 1))
    assert (tmp_path / "report.json").read_text() == '{"mine": 1}'
