"""Checking a submission without a dataset: every fault is reported with its location, for any content of the files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kit1000.cli import main
from kit1000.errors import InputError
from kit1000.submission import HEADER, Manifest, check, read_predictions, write_manifest
from tests.samples.broken_submissions import (
    BROKEN,
    BROKEN_MANIFESTS,
    GOOD,
    HEAD,
    MANIFEST,
    MANIFEST_WARNINGS,
    QW_COLUMN,
    ROWS,
    SNAP_ONLY,
    VALID_FOR_READERS,
    WARNINGS,
    as_bytes,
    field,
    row,
)


@pytest.mark.parametrize("case", [*BROKEN, *WARNINGS])
def test_a_broken_file_is_diagnosed(case: str, tmp_path: Path) -> None:
    content, code, line, column, message = (BROKEN | WARNINGS)[case]
    path = tmp_path / "predictions.csv"
    path.write_bytes(as_bytes(content))
    report = check(path)
    fault = next(fault for fault in report.faults if fault.code == code)
    assert (fault.line, fault.column) == (line, column)
    assert message in str(fault)
    assert fault.severity == ("error" if case in BROKEN else "warning")
    assert report.good == (case in WARNINGS)


@pytest.mark.parametrize("case", [*BROKEN, *WARNINGS])
def test_the_reader_refuses_what_the_check_reports_as_an_error(case: str, tmp_path: Path) -> None:
    path = tmp_path / "predictions.csv"
    path.write_bytes(as_bytes((BROKEN | WARNINGS)[case][0]))
    if case in WARNINGS or case in VALID_FOR_READERS:
        assert len(read_predictions(path)) == (0 if case in VALID_FOR_READERS else len(ROWS))
    else:
        with pytest.raises(InputError, match="`kit1000 check` lists all faults"):
            read_predictions(path)


def test_one_mistake_gives_one_fault(tmp_path: Path) -> None:
    path = tmp_path / "predictions.csv"
    for case in ("text", "NaN", "double", "too few fields", "utf-16", "cut off", "semicolons", "European sheet"):
        path.write_bytes(as_bytes(BROKEN[case][0]))
        allowed = {"cut off": 2, "European sheet": 2}.get(case, 1)  # and no line ending; separator and decimal comma
        assert len(check(path).faults) == allowed, case


def test_all_faults_of_a_file_are_reported_in_order(tmp_path: Path) -> None:
    path = tmp_path / "predictions.csv"
    lines = [HEAD, "a,1,0,0,nan,0,0,0,2,-3", "", "b,1", "a,x,0,0,0,0,0,,0,0", "c,1,1,1,1,0,0,0,0,0", "d,1,0"]
    path.write_text("\n".join(lines))
    reported = [(fault.line, fault.code) for fault in check(path).faults]
    expected = [
        (None, "unusual-ids"), (2, "nan"), (2, "confidence-range"), (2, "seconds-range"), (3, "empty-line"),
        (4, "too-few-fields"), (5, "duplicate-id"), (5, "text"), (5, "empty-field"), (6, "quaternion-norm"),
        (7, "missing-line-ending"), (7, "truncated"),
    ]  # fmt: skip
    assert reported == expected


def test_a_valid_file_has_no_faults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "predictions.csv"
    path.write_text(GOOD)
    assert check(path).faults == ()
    assert main(["check", str(path)]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"{path}: 4 rows")
    assert all(fact in out for fact in ("format only", "--data", "no faults\n"))
    assert err == ""


def submitted(folder: Path, manifest: str | bytes = MANIFEST, predictions: str | bytes = GOOD) -> Path:
    folder.mkdir()
    (folder / "manifest.toml").write_bytes(as_bytes(manifest))
    (folder / "predictions.csv").write_bytes(as_bytes(predictions))
    return folder


@pytest.mark.parametrize("case", [*BROKEN_MANIFESTS, *MANIFEST_WARNINGS])
def test_a_broken_manifest_is_diagnosed(case: str, tmp_path: Path) -> None:
    manifest, code, line, message = (BROKEN_MANIFESTS | MANIFEST_WARNINGS)[case]
    report = check(submitted(tmp_path / "mine", manifest))
    fault = next(fault for fault in report.faults if fault.code == code)
    assert fault.line == line
    assert message in str(fault)
    assert report.good == (case in MANIFEST_WARNINGS)


def test_a_toml_date_is_accepted(tmp_path: Path) -> None:
    assert check(submitted(tmp_path / "mine", field("date", "2026-01-31"))).faults == ()


def test_a_valid_folder_has_no_faults_under_any_name(tmp_path: Path) -> None:
    assert check(submitted(tmp_path / "mine")).faults == ()
    assert check(submitted(tmp_path / "a b\u00e9\n")).faults == ()


NOT_SUBMISSIONS: dict[str, tuple[Callable[[Path], object], str, str]] = {
    "nothing there": (lambda p: None, "missing-file", "does not exist"),
    "empty folder": (lambda p: p.mkdir(), "missing-file", "predictions.csv: does not exist"),
    "folder for a file": (lambda p: (p / "predictions.csv").mkdir(parents=True), "folder", "is a folder"),
    "another name": (lambda p: submitted(p).joinpath("predictions.csv").rename(p / "Predictions.CSV"), "missing-file",
                     "rename Predictions.CSV"),
    "link to nowhere": (
        lambda p: (p.mkdir(), (p / "predictions.csv").symlink_to("none")), "broken-link", "link to a missing file",
    ),
    "link to itself": (lambda p: p.symlink_to(p), "link-loop", "symbolic link to itself"),
    "link in a circle": (lambda p: (p.mkdir(), (p / "predictions.csv").symlink_to("predictions.csv")), "link-loop",
                         "symbolic link to itself"),
    "pipe": (lambda p: os.mkfifo(p), "not-a-file", "not a regular file"),
}  # fmt: skip


@pytest.mark.parametrize("case", NOT_SUBMISSIONS)
def test_anything_but_a_submission_is_diagnosed(case: str, tmp_path: Path) -> None:
    make, code, message = NOT_SUBMISSIONS[case]
    make(tmp_path / "mine")
    report = check(tmp_path / "mine")
    assert not report.good
    assert any(fault.code == code and message in str(fault) for fault in report.faults)


def test_any_path_is_diagnosed(tmp_path: Path) -> None:
    for path in ("\x00", "\udcff", "x" * 5000, "/dev/zero", "/dev/null"):
        report = check(path)
        assert not report.good
        str(report).encode("ascii" if path.isascii() else "utf-8")


def test_a_file_without_read_permission_is_diagnosed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = submitted(tmp_path / "mine")

    def refuse(path: Path, *_: object) -> int:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(os, "open", refuse)
    assert [fault.code for fault in check(folder).faults] == ["no-permission", "no-permission"]


def test_a_manifest_alone_is_not_a_submission(tmp_path: Path) -> None:
    report = check(submitted(tmp_path / "mine") / "manifest.toml")
    assert [fault.code for fault in report.faults] == ["manifest-only"]


def test_the_command_prints_all_faults_and_exits_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = submitted(tmp_path / "mine", predictions=row(3, "qw", "abc"))
    assert main(["check", str(folder)]) == 1
    out, err = capsys.readouterr()
    assert err == ""
    first, last = out.splitlines()
    assert first.startswith(f'predictions.csv:3:{QW_COLUMN}: qw = "abc": expected a number')
    assert last.endswith(": 1 error, 0 warnings")
    assert main(["check", str(folder), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert (report["good"], report["errors"], report["rows"], report["against_data"]) == (False, 1, 4, False)
    assert report["faults"][0]["line"] == 3


def test_a_file_saved_by_a_spreadsheet_is_valid(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    wxyz = rng.standard_normal((200, 4))
    numbers = np.column_stack([wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True), rng.normal(0, 1e-4, (200, 3))])

    def cell(value: float) -> str:  # 15 digits, exponents of two digits in capitals
        return f"{value:.15G}"

    lines = [f'"{i}"' for i in (",".join(HEADER).split(","))]
    rows = [
        ",".join([f'"test-s{i:04d}-p0-snap"', *map(cell, values), "1", "-1"])
        for i, values in enumerate(numbers.tolist())
    ]
    path = tmp_path / "predictions.csv"
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join([",".join(lines), *rows, ""]).encode())
    assert {fault.code for fault in check(path).faults} == {"byte-order-mark", "line-endings"}
    read = read_predictions(path)
    assert np.abs(np.column_stack([read.motions.wxyz, read.motions.xyz]) - numbers).max() < 1e-14


def many(n: int, wxyz: np.ndarray, xyz: np.ndarray) -> str:
    rows = zip(wxyz.tolist(), xyz.tolist(), strict=True)
    lines = [f"test-s{i:04d}-p0-snap,{','.join(map(repr, [*q, *t]))},1,-1" for i, (q, t) in enumerate(rows)]
    return "\n".join([HEAD, *lines[:n], ""])


def motions(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Motions as on a table: any yaw, some tilt, about 0.3 m."""
    rng = np.random.default_rng(n)
    yaw = rng.uniform(-np.pi, np.pi, n)
    wxyz = np.column_stack([np.cos(yaw / 2), rng.normal(0, 0.2, (n, 2)), np.sin(yaw / 2)])
    return wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True), rng.normal(0, 0.2, (n, 3))


def test_implausible_rows_are_suspected(tmp_path: Path) -> None:
    q, t = motions(100)
    angles = np.random.default_rng(0).uniform(-180, 180, (100, 4))
    path = tmp_path / "predictions.csv"
    for wxyz, xyz, name in (
        (q, t, None),
        (q, t * 1e3, "millimetres-suspected"),
        (q, t * 1e2, "centimetres-suspected"),
        (q, t * 10, "centimetres-suspected"),
        (np.roll(q, -1, axis=1), t, "scalar-last-suspected"),
        (np.tile([0.0, 0, 0, 1], (100, 1)), t, "scalar-last-suspected"),
        (np.tile([1.0, 0, 0, 0], (100, 1)), t, None),
        (angles, t, "angles-suspected"),
    ):
        path.write_text(many(100, wxyz, xyz))
        names = {fault.code for fault in check(path).faults if fault.line is None}
        assert names == ({name} if name else set())


def test_positions_of_rotation_only_predictions_have_no_unit(tmp_path: Path) -> None:
    q, t = motions(100)
    manifest = field("predicts", '"rotation"').replace('"snap", "place"', '"snap"')
    assert "millimetres-suspected" in {
        f.code for f in check(submitted(tmp_path / "a", SNAP_ONLY, many(9, q, t * 1e3))).faults
    }
    assert check(submitted(tmp_path / "b", manifest, many(9, q, t * 1e3))).good


def test_a_written_manifest_has_no_faults(tmp_path: Path) -> None:
    folder = submitted(tmp_path / "mine")
    manifest = Manifest(
        method='with "quotes" \\ and é',
        authors=("A. Name",),
        description="two\nlines\tand a tab",
        date="2026-01-31",
        dataset_id="0123456789abcdef",
        tracks=("snap", "place"),
        learned=False,
        uses_true_geometry=True,
        hardware="a processor",
        reproduce="python -m method",
    )
    write_manifest(folder / "manifest.toml", manifest)
    assert check(folder).faults == ()
