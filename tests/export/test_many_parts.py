"""Tests of kits for many files: a folder for each, one report for all, and no bad file that stops the others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kit1000.cli import main
from kit1000.export.own_part import KitJob, folder_names, make_kits_from_files
from tests.samples.mini import l_shape, write_stl


def test_folders_are_named_after_files_and_numbered_where_equal() -> None:
    paths = [Path(name) for name in ("a/arm.stl", "b/arm.stl", "arm-2.obj", "leg.stl")]
    assert folder_names(paths) == ["arm", "arm-2", "arm-2-2", "leg"]


def test_each_file_gets_a_kit_and_a_bad_one_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good, large = write_stl(tmp_path / "good.stl", l_shape()), write_stl(tmp_path / "large.stl", l_shape(60))
    (tmp_path / "bad.stl").write_bytes(b"\0" * 100)
    strange = write_stl(tmp_path / "strange.stl", l_shape())
    original = KitJob.run

    def run(job: KitJob):
        if job.path == strange:
            monkeypatch.setattr("kit1000.export.own_part.make_kit_from_file", lambda *_: 1 / 0)
        else:
            monkeypatch.undo()
        return original(job)

    paths = [good, tmp_path / "bad.stl", large]
    made = list(make_kits_from_files(paths, tmp_path / "out", workers=1, preview=False))
    reports = {name: report for each in made for name, report in each.items()}
    assert json.loads((tmp_path / "out/report.json").read_text()) == reports
    assert "bad.stl" in reports["bad"]
    assert isinstance(reports["bad"], str)
    for name in ("good", "large"):
        report = reports[name]
        assert isinstance(report, dict)
        assert report["part"] == f"{name}.stl"
        names = sorted(path.name for path in (tmp_path / "out" / name).iterdir())
        assert names == ["kit.stl", "part.stl", "report.json", "seated.glb"]
    assert "bug" in run(KitJob(strange, tmp_path / "out/strange"))["strange"]


def test_the_command_takes_many_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [str(write_stl(tmp_path / f"{name}.stl", l_shape(size))) for name, size in (("one", 40), ("two", 50))]
    (tmp_path / "text.stl").write_text("no mesh")
    line = ["--no-preview", "--workers", "1", "--unit", "mm"]
    assert main(["kit", *paths, "--out", str(tmp_path / "each"), *line, "--bodies", "each"]) == 0
    assert (tmp_path / "each/one/01/kit.stl").is_file()
    capsys.readouterr()
    assert main(["kit", str(tmp_path / "text.stl"), *paths, "--out", str(tmp_path / "out"), *line]) == 1
    out, err = capsys.readouterr()
    assert out.count("files      ") == 2
    assert "text.stl: not a mesh: text file" in err


def test_a_kit_without_preview_leaves_no_old_one(tmp_path: Path) -> None:
    path, out = write_stl(tmp_path / "good.stl", l_shape()), tmp_path / "out"
    assert main(["kit", str(path), "--out", str(out), "--unit", "mm"]) == 0
    assert (out / "preview.png").is_file()
    assert main(["kit", str(path), "--out", str(out), "--no-preview", "--unit", "mm"]) == 0
    assert sorted(file.name for file in out.iterdir()) == ["kit.stl", "part.stl", "report.json", "seated.glb"]
