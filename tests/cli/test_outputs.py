"""What commands do with the places that they write to: full and closed outputs, odd names, files of other people."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from kit1000.cli import main
from kit1000.errors import InputError, shown
from kit1000.export import export
from tests.samples.checkout import ROOT
from tests.samples.mini import l_shape, write_stl

COMMAND = [sys.executable, "-m", "kit1000"]


def run(shell: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """A line of bash in a folder, with the command as `$KIT1000`."""
    known = {**os.environ, "PYTHONPATH": str(ROOT), "KIT1000": " ".join(COMMAND), **environment}
    return subprocess.run(["bash", "-c", shell], cwd=folder, env=known, capture_output=True, check=False)


@pytest.mark.parametrize(
    ("redirected", "reason"),
    [("> /dev/full", b"cannot write the results: No space left"), (">&-", b"standard output is closed")],
)
@pytest.mark.parametrize("words", ["info MINI", "--help", "--version"])
def test_a_full_or_closed_output_is_one_line(
    words: str, redirected: str, reason: bytes, mini: Path, tmp_path: Path
) -> None:
    done = run(f"$KIT1000 {words.replace('MINI', str(mini))} {redirected}", tmp_path)
    assert done.returncode == 2
    assert done.stderr.count(b"\n") == 1
    assert reason in done.stderr


def test_an_output_that_ends_early_is_no_error(mini: Path, tmp_path: Path) -> None:
    done = run(f"$KIT1000 info {mini} | head -1; exit ${{PIPESTATUS[0]}}", tmp_path)
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_closed_error_output_leaves_the_results_alone(
    mini: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done = run(f"$KIT1000 info {mini} 2>&-", tmp_path)
    assert done.returncode == 0
    assert main(["info", str(mini)]) == 0
    assert done.stdout.decode() == capsys.readouterr().out


@pytest.fixture
def odd_file(tmp_path: Path) -> Path:
    """A mesh file with a name that is no UTF-8."""
    return write_stl(tmp_path / "a.stl", l_shape()).rename(tmp_path / os.fsdecode(b"Geh\xe4use.stl"))


@pytest.mark.parametrize("encoding", ["utf-8", "ascii", "latin-1"])
def test_an_output_of_any_encoding_gets_odd_names_escaped(
    encoding: str, odd_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written, said = io.BytesIO(), io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding, "strict"))
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(said, encoding, "strict"))
    assert main(["kit", str(odd_file), "--out", str(odd_file.parent / "k"), "--no-preview"]) == 0
    assert (b"Geh\\udce4use.stl" in written.getvalue(), said.getvalue()) == (True, b"")


def test_a_line_feed_in_a_name_keeps_the_message_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["kit", str(tmp_path / "two\nlines.stl"), "--out", str(tmp_path / "k")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert shown("a\tb\udce4ä\n") == "a\\tb\\udce4ä\\n"


@pytest.mark.parametrize("name", ["x.jpg", "x.JPEG", "x.mcap", "x.svg"])
def test_a_picture_of_another_format_is_refused(
    name: str, mini: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["show", str(mini), "--out", str(tmp_path / name), "--count", "1"]) == 2
    assert "name a file .png" in capsys.readouterr().err
    assert not (tmp_path / name).exists()


@pytest.mark.usefixtures("quick_pictures")
@pytest.mark.parametrize("name", ["x.png", "test-s0000.mcap"])
def test_a_picture_or_recording_of_mine_stays(
    name: str, mini: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    line = ["show", str(mini), "--out", str(path), "--count", "1"]
    if name.endswith("mcap"):
        line = ["export", str(mini), "--out", str(tmp_path), "--format", "mcap", "--ids", "test-s0000"]
    path.write_bytes(b"\x89PNG mine")
    assert main(line) == 2
    assert str(path) in capsys.readouterr().err
    assert path.read_bytes() == b"\x89PNG mine"
    path.unlink()
    for _ in range(2):  # its own is replaced
        assert main(line) == 0


@pytest.mark.parametrize("format", ["stl"])
def test_an_export_replaces_only_what_is_equal(format: str, mini: Path, tmp_path: Path) -> None:
    export(mini, format, tmp_path, ("test-0000",))
    export(mini, format, tmp_path, ("test-0000",))
    path = tmp_path / f"test-0000.{format}"
    path.write_bytes(b"mine")
    with pytest.raises(InputError, match=str(path)):
        export(mini, format, tmp_path, ("test-0000",))
    assert path.read_bytes() == b"mine"
