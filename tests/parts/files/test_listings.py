"""Lists of mesh files as editors save them, and scripts that would run themselves again in every process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from kit1000.errors import InputError
from kit1000.parts.files.sources import mesh_files
from tests.samples.checkout import ROOT

NAMES = ["b.stl", "a part.stl", "Gehäuse.stl"]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_list_may_have_any_line_ends_and_mark(encoding: str, end: str, tmp_path: Path) -> None:
    listing = tmp_path / "list.txt"
    listing.write_bytes(end.join(["# mine", "", *NAMES, ""]).encode(encoding))
    assert mesh_files(listing) == [tmp_path / name for name in NAMES]


def test_a_list_of_a_mac_in_utf_16_of_the_other_order(tmp_path: Path) -> None:
    listing = tmp_path / "list.txt"
    listing.write_bytes(b"\xfe\xff" + "\r".join(NAMES).encode("utf-16-be"))
    assert mesh_files(listing) == [tmp_path / name for name in NAMES]


def test_names_in_quotes_and_names_that_are_no_utf_8_are_found(tmp_path: Path) -> None:
    odd = os.fsencode(tmp_path) + b"/Geh\xe4use.stl"
    for name in (odd, os.fsencode(tmp_path) + b"/a part.stl"):
        Path(os.fsdecode(name)).write_bytes(b"x")
    listing = tmp_path / "list.txt"
    listing.write_bytes(b'"a part.stl"\nGeh\xe4use.stl\n')
    found = mesh_files(listing)
    assert all(path.is_file() for path in found)
    assert os.fsencode(found[1]) == odd


def test_a_list_of_wide_letters_without_a_mark_is_refused(tmp_path: Path) -> None:
    listing = tmp_path / "list.txt"
    listing.write_bytes("\n".join(NAMES).encode("utf-16-le"))
    with pytest.raises(InputError, match=r"cannot be read as a list of paths: .*UTF-16 without a mark"):
        mesh_files(listing)


CALLS = {
    "read_all": "from kit1000.parts.files.sources import read_all\nprint(read_all(['a.stl', 'b.stl'], workers=2))\n",
    "engine": "from kit1000.engines import local_engine\nwith local_engine(2) as m:\n    print(list(m(abs, [1])))\n",
}


@pytest.mark.parametrize("call", CALLS)
def test_a_script_without_a_guard_is_told_so_in_one_line(call: str, tmp_path: Path) -> None:
    script = tmp_path / "mine.py"
    script.write_text(CALLS[call])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, cwd=tmp_path, env=environment, check=False
    )
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode != 0
    assert (
        f'{script}: starts processes, which run this script again: put the call below `if __name__ == "__main__":`'
        in last
    )
    assert "crashed" not in done.stdout + done.stderr


@pytest.mark.parametrize("call", CALLS)
def test_a_script_with_a_guard_runs(call: str, tmp_path: Path) -> None:
    script = tmp_path / "mine.py"
    head, _, rest = CALLS[call].partition("\n")
    body = "\n".join(f"    {line}" for line in rest.splitlines())
    script.write_text(f'{head}\nif __name__ == "__main__":\n{body}\n')
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, cwd=tmp_path, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
