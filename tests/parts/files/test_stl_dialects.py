"""STL files as they occur: any case, any line ends, marks, long headers, comments; what is no STL is named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from kit1000.dataset.mesh_files import stl_bytes
from kit1000.errors import MeshRefused
from kit1000.mesh import Mesh
from kit1000.parts.files.sources import read_mesh
from tests.samples.foreign_files import readable_bodies

BOX = trimesh.creation.box((40, 20, 10))
BINARY = stl_bytes(Mesh(BOX.vertices * 1e-3, BOX.faces))
TEXT = str(BOX.export(file_type="stl_ascii"))
FAR = str(trimesh.Trimesh(BOX.vertices + [60, 0, 0], BOX.faces, process=False).export(file_type="stl_ascii"))

DIALECTS: dict[str, Callable[[], bytes]] = {
    "upper": lambda: TEXT.upper().encode(),
    "mixed": lambda: TEXT.replace("facet", "Facet").replace("vertex", "VerTex").encode(),
    "carriage returns": lambda: TEXT.replace("\n", "\r").encode(),
    "crlf": lambda: TEXT.replace("\n", "\r\n").encode(),
    "mark": lambda: b"\xef\xbb\xbf" + TEXT.encode(),
    "mark and crlf": lambda: b"\xef\xbb\xbf" + TEXT.replace("\n", "\r\n").encode(),
    "blank lines": lambda: ("\n \n\t" + TEXT.replace("\n", "\n\n")).encode(),
    "tabs": lambda: TEXT.replace(" ", "\t").encode(),
    "long header": lambda: TEXT.replace("solid", "solid " + "x" * 20_000, 1).encode(),
    "header of keywords": lambda: TEXT.replace("solid", "solid facet normal outer loop vertex", 1).encode(),
    "header of another encoding": lambda: TEXT.encode().replace(b"solid", b"solid Geh\xe4use", 1),
    "comment after the end": lambda: (TEXT + "\n; made by facet tools\n# vertex 1 2 3\n").encode(),
    "comment of keywords": lambda: (TEXT + "\n# of facet normal, outer loop and vertex 1 2 3\n").encode(),
    "end in two words": lambda: TEXT.replace("endsolid", "END SOLID").encode(),
    "end without a space": lambda: TEXT.replace("endsolid ", "endsolid").encode(),
    "zeros to the end of the block": lambda: TEXT.encode() + b"\0" * 300,
    "note between facets": lambda: TEXT.replace("endfacet", "endfacet # note", 1).encode(),
    "comment before": lambda: ("# exported\n" + TEXT).encode(),
    "one line": lambda: " ".join(TEXT.split()).encode(),
    "no end": lambda: TEXT.rpartition("endsolid")[0].encode(),
    "control z": lambda: TEXT.encode() + b"\x1a",
    "exponents": lambda: TEXT.replace("20.0", "2.0E+01").encode(),
}


def written(folder: Path, data: bytes, name: str = "part.stl") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("name", DIALECTS)
def test_a_dialect_of_text_is_the_same_part(name: str, tmp_path: Path) -> None:
    reading = read_mesh(written(tmp_path, DIALECTS[name]()))
    assert reading.mesh.volume * 1e9 == pytest.approx(8000)
    assert np.allclose(reading.mesh.extents * 1e3, (40, 20, 10), atol=1e-4)
    assert reading.notes == ()


@pytest.mark.parametrize("between", ["", "\n", "\ncomment: vertex 1 2 3\n"])
def test_several_solids_are_several_bodies(between: str, tmp_path: Path) -> None:
    bodies = readable_bodies(written(tmp_path, (TEXT + between + FAR).encode()))
    assert [body.mesh.volume * 1e9 for body in bodies] == pytest.approx([8000, 8000])


def test_facets_after_the_end_of_a_solid_are_read_without_a_header(tmp_path: Path) -> None:
    path = written(tmp_path, (TEXT + FAR.partition("\n")[2]).encode())
    assert [body.mesh.volume * 1e9 for body in readable_bodies(path)] == pytest.approx([8000, 8000])


@pytest.mark.parametrize("end", ["f", "facet", "Facet nor"])
def test_a_text_that_ends_within_the_word_facet_is_cut_short(end: str, tmp_path: Path) -> None:
    with pytest.raises(MeshRefused, match="cut short: ends within the facet after number 12"):
        read_mesh(written(tmp_path, (TEXT.rpartition("endsolid")[0] + end).encode()))


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:%s\nsize 684\n" % (b"0" * 64)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (TEXT.encode("utf-16"), "text in UTF-16 or UTF-32, expected ASCII or UTF-8: save it in UTF-8$"),
        (TEXT.encode("utf-16-le"), "text in UTF-16 or UTF-32"),
        (TEXT.encode("utf-16-be"), "text in UTF-16 or UTF-32"),
        (LFS, "a Git LFS pointer instead of the file itself: run git lfs pull$"),
        (b"<!DOCTYPE html><html>not found</html>", "a web page instead of a mesh: download the file itself$"),
        (b"PK\x03\x04" + bytes(100), "a zip archive instead of a mesh: unpack it first$"),
        (b"\x1f\x8b" + bytes(100), "compressed by gzip instead of a mesh: unpack it first$"),
        (BINARY[:80] + bytes(4) + BINARY[84:], "its header declares 0 triangles, but 12 follow: export it again$"),
        (BINARY[:80] + b"\x08\0\0\0" + BINARY[84:], "its header declares 8 triangles, but 12 follow"),
        (TEXT.upper()[:-120].encode(), r"cut short: ends within the facet after number 11$"),
        (TEXT.rpartition("outer loop")[0].encode(), r"cut short: the facet in line \d+ has 0 corners$"),
        (
            TEXT.replace("endloop", "vertex 1 2 3\nendloop", 1).encode(),
            "the facet in line 2 has 1 loops and 4 corners, expected 1 loop of 3$",
        ),
        (TEXT.replace("outer loop", "", 1).encode(), "the facet in line 2 has 0 loops and 3 corners"),
        (b"SOLID NOTHING\r\nENDSOLID NOTHING\r\n", "holds no triangles$"),
        (b"solid a\nvertex 1 2 3\nendsolid a\n", "holds no triangles$"),
    ],
)
def test_what_is_no_whole_stl_is_named(data: bytes, reason: str, tmp_path: Path) -> None:
    with pytest.raises(MeshRefused, match=reason) as caught:
        read_mesh(written(tmp_path, data))
    assert "\n" not in caught.value.reason


@pytest.mark.parametrize("suffix", ["obj", "ply", "off", "glb", "gltf", "3mf", "step"])
def test_a_pointer_of_git_lfs_is_named_in_every_format(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(MeshRefused, match=r"a Git LFS pointer instead of the file itself: run git lfs pull$"):
        read_mesh(written(tmp_path, LFS, f"part.{suffix}"))
