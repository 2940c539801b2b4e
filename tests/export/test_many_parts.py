"""Tests of kits for many files: a folder for each, one report for all, and no bad file that stops the others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kit1000.cli import main
from kit1000.export import own_part
from kit1000.export.own_part import KitOptions, folder_names, make_kits
from tests.samples.mini import l_shape, write_stl


def test_folders_are_named_after_files_and_numbered_where_equal() -> None:
    paths = [Path(name) for name in ("a/arm.stl", "b/arm.stl", "arm-2.obj", "leg.stl")]
    assert folder_names(paths) == ["arm", "arm-2", "arm-2-2", "leg"]


def test_each_file_gets_a_kit_and_a_bad_one_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good, large = write_stl(tmp_path / "good.stl", l_shape()), write_stl(tmp_path / "large.stl", l_shape(60))
    (tmp_path / "bad.stl").write_bytes(b"\0" * 100)
    strange = write_stl(tmp_path / "strange.stl", l_shape(50))
    original = own_part.read_mesh
    monkeypatch.setattr(own_part, "read_mesh", lambda path, *rest: 1 / 0 if path == strange else original(path, *rest))
    paths = [good, tmp_path / "bad.stl", large, strange]
    reports = dict(make_kits(paths, tmp_path / "out", KitOptions(preview=False), workers=1))
    assert json.loads((tmp_path / "out/report.json").read_text()) == reports
    assert "bad.stl" in reports["bad"]
    assert isinstance(reports["bad"], str)
    for name in ("good", "large"):
        report = reports[name]
        assert isinstance(report, dict)
        assert report["part"] == f"{name}.stl"
        names = sorted(path.name for path in (tmp_path / "out" / name).iterdir())
        assert names == ["kit.stl", "part.stl", "report.json", "seated.glb"]
    assert "bug" in str(reports["strange"])


def test_the_command_takes_many_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [str(write_stl(tmp_path / f"{name}.stl", l_shape(size))) for name, size in (("one", 40), ("two", 50))]
    (tmp_path / "text.stl").write_text("no mesh")
    line = ["--no-preview", "--workers", "1", "--unit", "mm"]
    assert main(["kit", str(tmp_path / "text.stl"), *paths, "--out", str(tmp_path / "out"), *line]) == 1
    out, err = capsys.readouterr()
    assert out.count("files      ") == 2
    assert "text.stl: not a mesh: text file" in err
