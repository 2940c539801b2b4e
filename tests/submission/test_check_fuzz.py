"""For any bytes, the check returns a report, and the reader a value or an error of one line.

KIT1000_FUZZ_S: for how many seconds files are mutated; 2 by default.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from kit1000.cli import main
from kit1000.errors import InputError
from kit1000.files import json_bytes
from kit1000.submission import Report, check, read_manifest, read_predictions, write_manifest, write_predictions
from tests.samples.broken_submissions import BROKEN, BROKEN_MANIFESTS, GOOD, MANIFEST, READ_WITHOUT_FAULT, as_bytes

SECONDS = float(os.environ.get("KIT1000_FUZZ_S", "2"))
TOKENS = (
    b",", b";", b"\t", b" ", b'"', b'""', b"\n", b"\r\n", b"\r", b"\x00", b"\xff", b"\xef\xbb\xbf", b"#", b"-", b"_",
    b"nan", b"inf", b"1e999", b"-1", b"0,5", b"0.5", b"1_0", b"\xc2\xa0", b"\xd9\xa3", b"\xe2\x88\x92", b"query_id",
    b"qw", b"test-s0000-p0-snap", b"=", b"[", b"]", b"{", b"[[", b"'''", b'"""', b"\\u0000", b"\\", b"2026-01-31",
    b"1979-05-27T07:32:00Z", b"0x", b"1" * 400, b"\x1f\x8b", b"\xff\xfe", b"\xf0\x9f\x98\x80", b"\xed\xa0\x80",
    b"tracks", b"\x85", b"\x1c",
)  # fmt: skip
PREDICTIONS = [as_bytes(content) for content, *_ in BROKEN.values()] + [GOOD.encode()] * 20
PREDICTIONS += map(as_bytes, READ_WITHOUT_FAULT.values())
MANIFEST_FILES = [as_bytes(content) for content, *_ in BROKEN_MANIFESTS.values()] + [MANIFEST.encode()] * 20


def mutated(rng: np.random.Generator, files: list[bytes]) -> bytes:
    """A file with bytes flipped, cut, repeated, spliced with another file, or with tokens inserted."""
    data = files[rng.integers(len(files))][:20_000]
    for _ in range(rng.geometric(0.4)):
        i, j = sorted(rng.integers(len(data) + 1, size=2).tolist())
        how = rng.integers(8)
        other = files[rng.integers(len(files))][:20_000]
        k = int(rng.integers(len(other) + 1))
        token, flip = TOKENS[rng.integers(len(TOKENS))], 1 << int(rng.integers(8))
        data = (
            data[:i] + rng.bytes(int(rng.integers(1, 4))) + data[i + 1 :],
            data[:i] + bytes(byte ^ flip for byte in data[i : i + 1]) + data[i + 1 :],
            data[:i],
            data[:i] + data[j:],
            data[:j] + data[i:],
            data[:i] + other[k:],
            data[:i] + token + data[i:],
            data[:i] + token + data[j:],
        )[how]
    return data if rng.random() < 0.97 else rng.bytes(int(rng.integers(1, 300)))


def files(seconds: float, seed: int) -> Iterator[tuple[int, bytes, bytes]]:
    """Numbered pairs of manifest and predictions until the time is over."""
    end, number = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        rng = np.random.default_rng((seed, number))
        yield number, mutated(rng, MANIFEST_FILES), mutated(rng, PREDICTIONS)
        number += 1


def check_refused(error: InputError, report: Report) -> None:
    """What the reader refuses, the check reports as an error."""
    assert (report.good, "\n" in str(error)) == (False, False)


def check_laws(folder: Path, again: Path, data: Path | None) -> None:
    """What holds for any folder."""
    report = check(folder, data)
    str(report).encode("ascii")
    json_bytes(report.as_json())
    assert all("\n" not in str(fault) for fault in report.faults)
    assert report.summary == str(report).split("\n")[-1]
    try:
        predictions = read_predictions(folder / "predictions.csv")
    except InputError as error:
        check_refused(error, report)
    else:
        write_predictions(again, predictions)
        back = read_predictions(again)
        assert back.query_ids == predictions.query_ids
        assert np.array_equal(back.motions.wxyz, predictions.motions.wxyz)
        assert np.array_equal(back.motions.xyz, predictions.motions.xyz)
    try:
        manifest = read_manifest(folder / "manifest.toml")
    except InputError as error:
        check_refused(error, report)
    else:
        write_manifest(again, manifest)
        assert read_manifest(again) == manifest


@pytest.mark.parametrize("against_data", [False, True])
def test_any_bytes_give_a_report(against_data: bool, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    data = request.getfixturevalue("mini") if against_data else None
    folder, again = tmp_path / "mine", tmp_path / "again"
    folder.mkdir()
    done = 0
    for number, manifest, predictions in files(SECONDS / 2, seed=int(against_data)):
        (folder / "manifest.toml").write_bytes(manifest)
        (folder / "predictions.csv").write_bytes(predictions)
        try:
            check_laws(folder, again, data)
        except Exception as error:
            raise AssertionError(f"file {number}: {manifest!r} {predictions!r}") from error
        done += 1
    print(f"{done} folders checked")
    assert done


def test_the_command_exits_with_0_or_1_for_any_bytes(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for number, manifest, predictions in files(SECONDS / 4, seed=2):
        (tmp_path / "manifest.toml").write_bytes(manifest)
        (tmp_path / "predictions.csv").write_bytes(predictions)
        assert main(["check", str(tmp_path)]) in (0, 1), number
        out, err = capfd.readouterr()
        assert (bool(out), err) == (True, "")
