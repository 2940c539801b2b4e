"""The check of a submission: every fault has its code and line, and no path leads out of the folder."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kit1000.cli import main
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.submission import (
    HEADER,
    Predictions,
    check,
    read_manifest,
    read_predictions,
    read_submission,
    write_predictions,
)
from kit1000.submission.faults import MOST_KEPT, MOST_PRINTED
from tests.samples.broken_submissions import (
    BROKEN,
    BROKEN_MANIFESTS,
    GOOD,
    HEAD,
    MANIFEST,
    MANIFEST_WARNINGS,
    READ_WITHOUT_FAULT,
    SNAP_ONLY,
    WARNINGS,
    as_bytes,
    field,
    row,
)
from tests.samples.foreign_files import cases


def submitted(folder: Path, manifest: str | bytes = MANIFEST, predictions: str | bytes = GOOD) -> Path:
    folder.mkdir()
    (folder / "manifest.toml").write_bytes(as_bytes(manifest))
    (folder / "predictions.csv").write_bytes(as_bytes(predictions))
    return folder


@pytest.mark.parametrize("case", [*BROKEN, *WARNINGS])
def test_a_broken_file_gives_one_fault_and_is_not_read(case: str, tmp_path: Path) -> None:
    content, code, line = (BROKEN | WARNINGS)[case]
    path = tmp_path / "predictions.csv"
    path.write_bytes(as_bytes(content))
    report = check(path)
    expected = {(code, line), ("no-line-end", 5)} if case == "cut off" else {(code, line)}
    assert {(fault.code, fault.line) for fault in report.faults} == expected
    assert code != "header" or HEAD in report.errors[0].expected
    assert report.good == (case in WARNINGS)
    if report.good or case == "header alone":
        assert len(read_predictions(path)) == (4 if report.good else 0)
        return
    with pytest.raises(InputError) as caught:
        read_predictions(path)
    assert str(caught.value).startswith(f"{report.errors[0]} (")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("case", READ_WITHOUT_FAULT)
def test_files_of_spreadsheets_and_of_other_computers_are_read(case: str, tmp_path: Path) -> None:
    path, plain = tmp_path / "p.csv", tmp_path / "plain.csv"
    path.write_bytes(as_bytes(READ_WITHOUT_FAULT[case]))
    plain.write_text(GOOD)
    assert check(path).faults == ()
    read, expected = read_predictions(path), read_predictions(plain)
    assert read.query_ids == expected.query_ids
    assert np.array_equal(read.motions.xyz, expected.motions.xyz)


def test_all_faults_of_a_file_are_reported_in_order(tmp_path: Path) -> None:
    path = tmp_path / "predictions.csv"
    lines = [HEAD, "a,1,0,0,nan,0,0,0,2,-3", "", "b,1", "a,x,0,0,0,0,0,,0,0", "c,1,1,1,1,0,0,0,0,0", "d,1,0"]
    path.write_text("\n".join(lines))
    expected = [
        (2, "confidence-range"), (2, "not-a-number"), (2, "seconds-range"), (4, "fields"),
        (5, "duplicate-id"), (5, "not-a-number"), (5, "not-a-number"), (6, "quaternion-norm"), (7, "fields"),
        (7, "no-line-end"),
    ]  # fmt: skip
    assert [(fault.line, fault.code) for fault in check(path).faults] == expected


@pytest.mark.parametrize("case", [*BROKEN_MANIFESTS, *MANIFEST_WARNINGS])
def test_a_broken_manifest_is_reported_and_not_read(case: str, tmp_path: Path) -> None:
    manifest, code, line = (BROKEN_MANIFESTS | MANIFEST_WARNINGS)[case]
    folder = submitted(tmp_path / "mine", manifest)
    report = check(folder)
    fault = next(fault for fault in report.faults if fault.code == code)
    assert fault.line == line
    assert report.good == (case in MANIFEST_WARNINGS)
    if not report.good:
        with pytest.raises(InputError) as caught:
            read_manifest(folder / "manifest.toml")
        assert str(fault).removeprefix("manifest.toml") in str(caught.value)


def test_a_valid_submission_has_no_faults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = submitted(tmp_path / "a b\u00e9\n", field("date", "2026-01-31"))  # a day of TOML, without quotes
    assert check(folder).faults == ()
    assert main(["check", str(folder / "predictions.csv")]) == 0
    out, err = capsys.readouterr()
    assert all(fact in out for fact in (": 4 rows", "format only", "--data", "no faults\n"))
    assert err == ""


def test_the_command_prints_all_faults_and_exits_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = submitted(tmp_path / "mine", predictions=row(3, "qw", "abc"))
    assert main(["check", str(folder)]) == 1
    out, err = capsys.readouterr()
    first, last = out.splitlines()
    assert first.startswith('predictions.csv:3: qw = "abc": expected a finite number')
    assert (last.endswith(": 1 error, 0 warnings"), err) == (True, "")
    assert main(["check", str(folder), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert (report["good"], report["errors"], report["rows"], report["against_data"]) == (False, 1, 4, False)
    assert report["faults"][0]["line"] == 3


NOT_SUBMISSIONS: dict[str, tuple[Callable[[Path], object], str]] = {
    "nothing there": (lambda p: None, "missing-file"),
    "empty folder": (lambda p: p.mkdir(), "missing-file"),
    "folder for a file": (lambda p: (p / "predictions.csv").mkdir(parents=True), "folder"),
    "link to nowhere": (lambda p: (p.mkdir(), (p / "predictions.csv").symlink_to("none")), "missing-file"),
    "link to itself": (lambda p: p.symlink_to(p), "unreadable"),
    "link in a circle": (lambda p: (p.mkdir(), (p / "predictions.csv").symlink_to("predictions.csv")), "unreadable"),
    "pipe": (lambda p: os.mkfifo(p), "not-a-file"),
}


@pytest.mark.parametrize("case", NOT_SUBMISSIONS)
def test_anything_but_a_submission_is_reported(case: str, tmp_path: Path) -> None:
    make, code = NOT_SUBMISSIONS[case]
    make(tmp_path / "mine")
    assert code in {fault.code for fault in check(tmp_path / "mine").errors}


def test_any_path_is_reported(tmp_path: Path) -> None:
    for path in ("\x00", "\udcff", "x" * 5000, "/dev/zero", "/dev/null"):
        report = check(path)
        assert not report.good
        str(report).encode("ascii" if path.isascii() else "utf-8")
    (fault,) = check(submitted(tmp_path / "mine") / "manifest.toml").faults
    assert fault.code == "manifest-only"


def test_a_file_without_read_permission_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = submitted(tmp_path / "mine")

    def refuse(path: Path, *_: object) -> int:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(os, "open", refuse)
    faults = check(folder).faults
    assert [fault.code for fault in faults] == ["unreadable", "unreadable"]
    assert "Permission denied" in faults[0].actual


@pytest.mark.parametrize(("scale", "good"), [(1, True), (1e3, False), (1e2, False)])
def test_positions_have_a_unit_unless_only_rotations_are_predicted(scale: float, good: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    motions = Pose.from_rotvec(rng.normal(size=(9, 3)), scale * rng.normal(0, 0.2, (9, 3)))
    ids = tuple(f"test-s{i:04d}-p0-snap" for i in range(9))
    folder = submitted(tmp_path / "a", SNAP_ONLY)
    write_predictions(folder / "predictions.csv", Predictions(ids, motions, np.ones(9), np.ones(9)))
    assert [fault.code for fault in check(folder).faults] == ([] if good else ["unit-suspected"])
    (folder / "manifest.toml").write_text(SNAP_ONLY.replace('"pose"', '"rotation"'))
    assert check(folder).good


def test_the_shared_cases_are_refused_in_one_line() -> None:
    folder = cases()
    if folder is None:
        pytest.skip("the folder of cases is absent")
    (fault,) = check(folder / "sep-line.csv").faults
    assert (fault.code, fault.line) == ("header", 1)
    assert ",".join(HEADER) in str(fault)
    assert "delete this line" in str(fault)


SECRET = "secret-of-another-user"
FILES = ("manifest.toml", "predictions.csv")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "secret").write_text(f"{SECRET}\n")
    return submitted(tmp_path / "mine")


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
