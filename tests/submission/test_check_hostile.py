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


BAD_ROWS = {  # by description: the row number i, and how many errors each has
    "not numbers": ("test-s{i}-p0-snap,a,b,c,d,e,f,g,h,i", 9),
    "too short": ("test-s{i}-p0-snap,1,0", 1),
    "one id": ("test-s0-p0-snap,1,0,0,0,0,0,0,1,1", 1),
    "out of range": ("test-s{i}-p0-snap,2,0,0,0,1e9,0,0,7,-3", 4),
    "no id": (",1,0,0,0,0,0,0,1,1", 1),
}


@pytest.mark.parametrize("case", BAD_ROWS)
def test_many_faults_are_counted_and_few_are_printed(
    case: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pattern, each = BAD_ROWS[case]
    n = 3 * MOST_KEPT
    rows = [pattern.format(i=i) for i in range(n)]
    (folder / "predictions.csv").write_text("\n".join([HEAD, *rows, ""]))
    report = check(folder)
    wrong = n * each - (case == "one id")  # of equal ids the first is right
    assert 0 <= report.error_count - wrong <= 4  # and of the file, such as quaternions far from 1
    assert len(report.errors) == MOST_KEPT
    assert main(["check", str(folder)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == MOST_PRINTED + 1
    assert f"{report.error_count} errors, " in lines[-1]
    assert lines[-1].endswith(f"; the first {MOST_PRINTED} are listed")
    assert main(["check", str(folder), "--json"]) == 1
    described = json.loads(capsys.readouterr().out)
    assert described["errors"] == report.error_count
    assert len(described["faults"]) == len(report.faults) <= 2 * MOST_KEPT
