"""Hostile submissions: links out of the folder, pipes and devices are not read; faults without end stay few."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from kit1000.cli import main
from kit1000.errors import InputError
from kit1000.submission import check, read_submission
from kit1000.submission.faults import MOST_KEPT, MOST_PRINTED
from tests.samples.broken_submissions import GOOD, HEAD, MANIFEST

SECRET = "secret-of-another-user"
FILES = ("manifest.toml", "predictions.csv")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/manifest.toml").write_text(MANIFEST)
    (tmp_path / "mine/predictions.csv").write_text(GOOD)
    (tmp_path / "secret").write_text(f"{SECRET}\n")
    return tmp_path / "mine"


def replace_by_link(path: Path, target: str) -> None:
    path.unlink()
    path.symlink_to(target)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("target", ["../secret", "{absolute}", "inner/secret", "../missing", "/dev/zero"])
def test_a_link_out_of_the_folder_is_refused_unread(
    name: str, target: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "inner").symlink_to(folder.parent)
    replace_by_link(folder / name, target.format(absolute=folder.parent / "secret"))
    (fault,) = [fault for fault in check(folder).faults if fault.severity == "error"]
    assert (fault.file, fault.code) == (name, "foreign-link")
    assert main(["check", str(folder)]) == 1
    assert main(["check", str(folder), "--json"]) == 1
    out, err = capsys.readouterr()
    assert SECRET not in out + err
    with pytest.raises(InputError, match=name):
        read_submission(folder)


@pytest.mark.parametrize("name", FILES)
def test_a_link_inside_the_folder_and_one_to_the_folder_are_followed(name: str, folder: Path) -> None:
    (folder / name).rename(folder / "v2")
    (folder / name).symlink_to("v2")
    (folder.parent / "alias").symlink_to("mine")
    assert check(folder).good
    assert check(folder.parent / "alias").good


@pytest.mark.parametrize("name", FILES)
def test_a_pipe_is_never_opened(name: str, folder: Path) -> None:
    (folder / name).unlink()
    os.mkfifo(folder / name)
    (fault,) = check(folder).errors
    assert (fault.file, fault.code) == (name, "not-a-file")
    (folder / name).rename(folder / "pipe")
    (folder / name).symlink_to("pipe")
    (fault,) = check(folder).errors
    assert (fault.file, fault.code) == (name, "not-a-file")


BAD_ROWS = (  # with the row number i
    "test-s{i}-p0-snap,a,b,c,d,e,f,g,h,i", "test-s{i}-p0-snap,1,0", "test-s0-p0-snap,1,0,0,0,0,0,0,1,1",
    "test-s{i}-p0-snap,2,0,0,0,1e9,0,0,7,-3",
)  # fmt: skip


@pytest.mark.parametrize("pattern", BAD_ROWS)
def test_of_many_faults_few_are_kept_and_fewer_printed(
    pattern: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [pattern.format(i=i) for i in range(3 * MOST_KEPT)]
    (folder / "predictions.csv").write_text("\n".join([HEAD, *rows, ""]))
    report = check(folder)
    assert len(report.errors) == MOST_KEPT
    assert main(["check", str(folder)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == MOST_PRINTED + 1
    assert f"{MOST_KEPT} errors or more, " in lines[-1]
    assert lines[-1].endswith(f"; the first {MOST_PRINTED} are listed")
    assert main(["check", str(folder), "--json"]) == 1
    described = json.loads(capsys.readouterr().out)
    assert MOST_KEPT <= len(described["faults"]) == len(report.faults) <= MOST_KEPT + 10
