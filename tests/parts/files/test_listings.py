"""Lists of mesh files as editors save them, and scripts that would run themselves again in every process."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from kit1000.errors import InputError
from kit1000.parts.files.sources import mesh_files

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
