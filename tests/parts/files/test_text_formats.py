"""STL, OBJ and PLY in the dialects of other programs: each is read exactly, or refused with its place."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.dataset.mesh_files import stl_bytes
from kit1000.errors import MeshRefused
from kit1000.mesh import Mesh
from kit1000.parts.files.read import read_mesh, read_triangles
from kit1000.parts.files.triangles import decimal_step, polygons_as_triangles
from tests.samples.foreign_files import written

BOX = trimesh.creation.box((40, 20, 10))
BINARY = stl_bytes(Mesh(BOX.vertices * 1e-3, BOX.faces))
TEXT = str(BOX.export(file_type="stl_ascii"))
FAR = str(trimesh.Trimesh(BOX.vertices + [60, 0, 0], BOX.faces, process=False).export(file_type="stl_ascii"))
MARK = b"\xef\xbb\xbf"


def with_attributes(*sizes: int) -> bytes:
    """The box as a binary STL with bytes of data after each facet, as their counts say."""
    facets = [bytearray(BINARY[84 + 50 * k : 134 + 50 * k]) for k in range(12)]
    for number, facet in enumerate(facets):
        size = sizes[number % len(sizes)]
        facet[48:50] = size.to_bytes(2, "little")
        facet += b"\x7f" * size
    return BINARY[:84] + b"".join(facets)


STL = {
    "upper case": TEXT.upper().encode(),
    "mixed case": TEXT.replace("facet", "Facet").replace("vertex", "VerTex").encode(),
    "carriage returns": TEXT.replace("\n", "\r").encode(),
    "mark and crlf": MARK + TEXT.replace("\n", "\r\n").encode(),
    "blank lines": ("\n \n\t" + TEXT.replace("\n", "\n\n")).encode(),
    "tabs": TEXT.replace(" ", "\t").encode(),
    "long header": TEXT.replace("solid", "solid " + "x" * 20_000, 1).encode(),
    "header of keywords": TEXT.replace("solid", "solid facet normal outer loop vertex", 1).encode(),
    "header of another encoding": TEXT.encode().replace(b"solid", b"solid Geh\xe4use", 1),
    "comment after the end": (TEXT + "\n; made by facet tools\n# vertex 1 2 3\n").encode(),
    "end in two words": TEXT.replace("endsolid", "END SOLID").encode(),
    "end without a space": TEXT.replace("endsolid ", "endsolid").encode(),
    "zeros to the end of the block": TEXT.encode() + b"\0" * 300,
    "note between facets": TEXT.replace("endfacet", "endfacet # note", 1).encode(),
    "comment before": ("# exported\n" + TEXT).encode(),
    "one line": " ".join(TEXT.split()).encode(),
    "no end": TEXT.rpartition("endsolid")[0].encode(),
    "control z": TEXT.encode() + b"\x1a",
    "exponents": TEXT.replace("20.0", "2.0E+01").encode(),
    "binary that begins with solid": b"solid" + BINARY[5:],
    "binary with colours": BINARY[:132] + b"\x12\x34" + BINARY[134:],
}


@pytest.mark.parametrize("name", STL)
def test_a_dialect_of_stl_is_the_same_part(name: str, tmp_path: Path) -> None:
    reading = read_mesh(written(tmp_path / "part.stl", STL[name]))
    assert reading.mesh.volume * 1e9 == pytest.approx(8000)
    assert np.allclose(reading.mesh.extents * 1e3, (40, 20, 10), atol=1e-4)
    assert reading.notes == ()


@pytest.mark.parametrize("between", ["", "\n", "\n# vertex 1 2 3\n"])
def test_several_solids_are_several_bodies(between: str, tmp_path: Path) -> None:
    for text in (TEXT + between + FAR, " ".join((TEXT + FAR).split()), TEXT + FAR.partition("\n")[2]):
        reading = read_mesh(written(tmp_path / "two.stl", text.encode()), choice="largest")
        assert reading.mesh.volume * 1e9 == pytest.approx(8000)
        assert "kept the largest of 2 bodies" in reading.notes[-1]


OUTLINE = np.array([(0, 0), (40, 0), (40, 8), (25, 8), (20, 15), (8, 15), (8, 30), (0, 30)], dtype=float)
N = len(OUTLINE)
VERTICES = np.concatenate([np.column_stack([OUTLINE, np.full(N, z)]) for z in (0, 10)])
AREA = 0.5 * abs(np.dot(OUTLINE[:, 0], np.roll(OUTLINE[:, 1], -1)) - np.dot(OUTLINE[:, 1], np.roll(OUTLINE[:, 0], -1)))
FACES = [list(range(N))[::-1], list(range(N, 2 * N)), *([k, (k + 1) % N, (k + 1) % N + N, k + N] for k in range(N))]

TRIANGLES = polygons_as_triangles(VERTICES, FACES)


def obj(corner: str = "{}", relative: bool = False) -> str:
    points = "".join(f"v {x} {y} {z}\n" for x, y, z in VERTICES)
    rows = ["f " + " ".join(corner.format(i - len(VERTICES) if relative else i + 1) for i in face) for face in FACES]
    return points + "vt 0 0\nvn 0 0 1\n" + "\n".join(rows) + "\n"


PLY_HEADER = (
    "ply\nformat {form} 1.0\ncomment made\nelement vertex 16\nproperty float x\nproperty float y\nproperty float z\n"
    "property uchar red\nelement face 28\nproperty list uchar int vertex_indices\nproperty uchar flag\nend_header\n"
)


def ply_text() -> bytes:
    rows = [*(f"{x} {y} {z} 255" for x, y, z in VERTICES)]
    rows += [f"3 {a} {b} {c} 1" for a, b, c in TRIANGLES.tolist()]
    return (PLY_HEADER.format(form="ascii") + "\n".join(rows) + "\n").encode()


def ply_binary(order: str) -> bytes:
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    body = b"".join(struct.pack(f"{order}fffB", *row, 255) for row in VERTICES)
    body += b"".join(struct.pack(f"{order}B3iB", 3, *face, 1) for face in TRIANGLES.tolist())
    return PLY_HEADER.format(form=form).encode() + body


POLYGONS = {
    "a.obj": obj().encode(),
    "texture.obj": obj("{}/1").encode(),
    "normal.obj": obj("{}//1").encode(),
    "relative.obj": obj(relative=True).encode(),
    "crlf.obj": obj().replace("\n", "\r\n").encode(),
    "cr.obj": obj().replace("\n", "\r").encode(),
    "mark.obj": MARK + obj().encode(),
    "continued.obj": obj().replace(" 4 ", " \\\n4 ").encode(),
    "a.ply": ply_text(),
    "crlf.ply": ply_text().replace(b"\n", b"\r\n"),
    "little.ply": ply_binary("<"),
    "big.ply": ply_binary(">"),
}


@pytest.mark.parametrize("name", POLYGONS)
def test_polygons_of_obj_and_triangles_of_ply_are_read(name: str, tmp_path: Path) -> None:
    reading = read_mesh(written(tmp_path / name, POLYGONS[name]), "mm")
    walls = 10 * np.linalg.norm(np.roll(OUTLINE, -1, axis=0) - OUTLINE, axis=1).sum()
    assert reading.mesh.volume * 1e9 == pytest.approx(10 * AREA, rel=1e-6)
    assert reading.mesh.area * 1e6 == pytest.approx(2 * AREA + walls, rel=1e-6)  # no triangle lies outside of its face
    assert reading.notes == ()


def test_indices_from_the_back_count_from_where_they_stand(tmp_path: Path) -> None:
    pieces = []
    for k in range(4):
        corners = [(0, 0, 0), (30, 0, 0), (0, 30, 0), (0, 0, 30)]
        face = [corners[i] for i in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))[k]]
        pieces += [f"v {x} {y} {z}" for x, y, z in face] + ["f -3 -2 -1"]
    reading = read_mesh(written(tmp_path / "a.obj", "\n".join(pieces).encode()), "mm")
    assert reading.mesh.volume * 1e9 == pytest.approx(4500)


BINARY_OR_TEXT = ("stl", "obj", "ply", "glb", "3mf", "step")
LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:%s\nsize 684\n" % (b"0" * 64)
REFUSED: list[tuple[str, str | bytes, tuple[str, ...]]] = [  # (suffix, contents, facts)
    ("stl", TEXT.encode("utf-16"), ("UTF-16", "save it in UTF-8")),
    ("stl", TEXT.encode("utf-16-be"), ("UTF-16", "UTF-8")),
    ("stl", b"<!DOCTYPE html><html>not found</html>", ("a web page", "download the file")),
    ("stl", b"PK\x03\x04" + bytes(100), ("a zip archive", "unpack it")),
    ("stl", b"\x1f\x8b" + bytes(100), ("gzip", "unpack it")),
    ("stl", BINARY[:80] + bytes(4) + BINARY[84:], ("declares 0 triangles", "12 follow", "export it again")),
    ("stl", BINARY[:80] + b"\x08\0\0\0" + BINARY[84:], ("declares 8 triangles", "12 follow")),
    ("stl", BINARY[:-77], ("cut short", "12 triangles declared", "room for 10")),
    *(
        ("stl", data, ("attributes", "export it without"))
        for data in (with_attributes(4), with_attributes(4, 6), BINARY + b"table")
    ),
    ("stl", TEXT.rpartition("outer loop")[0], ("cut short", "has no end")),
    ("stl", TEXT.rpartition("endsolid")[0] + "Facet nor", ("cut short", "has no end")),
    ("stl", TEXT.replace("endloop", "vertex 1 2 3\nendloop", 1), ("line 2", "one loop of 3 corners")),
    ("stl", TEXT.replace("outer loop", "", 1), ("line 2",)),
    ("stl", TEXT.replace("outer loop", "a note", 1), ("line 2",)),
    ("stl", TEXT.replace("20.0", "2O.O", 1), ("line 4", "'-2o.o'", "no number")),
    ("stl", TEXT.replace(".", ","), ("line 4", "a decimal comma", "decimal points")),
    ("stl", b"SOLID NOTHING\r\nENDSOLID NOTHING\r\n", ("holds no triangles",)),
    ("stl", b"solid a\nvertex 1 2 3\nendsolid a\n", ("holds no triangles",)),
    ("stl", b"Dear all, please find attached\n" * 9, ("not a mesh: text file",)),
    ("obj", obj().replace("f 8 1", "f 0 1"), ("vertex -1 of 16",)),
    ("obj", obj().replace("f 8 1", "f x 1"), ("'f x 1 9 16'", "not whole")),
    ("obj", obj() + "v 1 2\n", ("'v 1 2'", "fewer than 3 coordinates")),
    ("obj", obj().replace("40.0", "40,0"), ("line 2", "a decimal comma")),
    ("obj", obj()[:-20], ("not closed",)),
    ("obj", obj() + "cstype bspline\nsurf 0 1 0 1 1 2 3 4\n", ("curved surfaces", "export it as polygons")),
    ("obj", obj().encode("utf-16"), ("UTF-16",)),
    ("ply", ply_text()[:-60], ("cut short", "export it as triangles")),
    ("ply", ply_text().replace(b"\n3 ", b"\n4 0 ", 1), ("faces of more than three corners",)),
    ("ply", ply_text().replace(b"element face", b"element tristrips"), ("strips of triangles", "as triangles")),
    *(
        ("ply", data, ("not readable as PLY",))
        for data in (
            ply_binary("<")[:-9],
            ply_text().replace(b"40.0", b"40,0"),
            ply_text().replace(b"list uchar int", b"list uchar word"),
            ply_text().replace(b"float x", b"float u"),
            ply_text().replace(b"ascii", b"utf8"),
            ply_text().replace(b"vertex_indices", b"corners"),
            ply_text().replace(b"\n3 ", b"\n3 99", 1),
        )
    ),
    *((suffix, LFS, ("a Git LFS pointer", "git lfs pull")) for suffix in BINARY_OR_TEXT),
]


@pytest.mark.parametrize(("suffix", "data", "facts"), REFUSED)
def test_what_is_no_whole_file_is_refused_with_its_place(
    suffix: str, data: str | bytes, facts: tuple[str, ...], tmp_path: Path
) -> None:
    with pytest.raises(MeshRefused) as caught:
        read_mesh(written(tmp_path / f"part.{suffix}", data.encode() if isinstance(data, str) else data), "mm")
    assert all(fact in caught.value.reason for fact in facts), caught.value.reason
    assert "\n" not in caught.value.reason


@pytest.mark.parametrize(
    ("name", "step"),
    [
        ("far.stl", 2.0**-1),  # float32 between 2^22 and 2^23
        ("near.stl", 2.0**-19),
        ("digits.obj", 0.01),
        ("grid.obj", 0.0),
    ],
)
def test_the_step_of_coordinates_is_that_of_the_file(name: str, step: float, tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(2, 20)
    offset = 5e6 if name == "far.stl" else 0.0
    moved = trimesh.Trimesh(ball.vertices + [offset, 0, 0], ball.faces, process=False)
    if name.endswith("stl"):
        data = bytes(moved.export(file_type="stl"))  # type: ignore[arg-type]
    else:
        shape = BOX if name == "grid.obj" else moved
        rows = [f"v {x:.2f} {y:.2f} {z:.2f}" for x, y, z in shape.vertices]
        data = "\n".join([*rows, *(f"f {a} {b} {c}" for a, b, c in shape.faces + 1)]).encode()
    assert read_triangles(written(tmp_path / name, data)).step == pytest.approx(step)


def test_many_decimals_are_as_exact_as_numbers_in_memory() -> None:
    assert decimal_step(np.random.default_rng(0).random((100, 3))) == 0.0


@given(st.integers(0, 10_000), st.integers(4, 12))
@settings(max_examples=80)
def test_the_triangles_of_a_polygon_cover_it_once(seed: int, corners: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, corners)) + np.arange(corners) * 1e-3
    radii = rng.uniform(0.2, 1, corners)
    flat = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(corners)])
    if np.diff(np.append(angles, angles[0] + 2 * np.pi)).max() > np.pi - 0.1:
        return  # the centre lies outside: perhaps no simple polygon
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    vertices = flat @ turn.T
    triangles = polygons_as_triangles(vertices, [list(range(corners))])
    first, second = (vertices[triangles[:, k]] - vertices[triangles[:, 0]] for k in (1, 2))
    normals = np.cross(first, second)
    ahead = np.roll(flat, -1, axis=0)
    area = 0.5 * (flat[:, 0] * ahead[:, 1] - flat[:, 1] * ahead[:, 0]).sum()
    direction = np.cross(vertices, np.roll(vertices, -1, axis=0)).sum(0)
    assert len(triangles) == corners - 2
    assert 0.5 * np.linalg.norm(normals, axis=1).sum() == pytest.approx(area)
    assert (normals @ direction > -1e-12).all()


def test_corners_on_a_line_and_polygons_of_mixed_lengths_keep_all_their_triangles() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 2, 0], [1, 2, 0], [0, 2, 0]], dtype=float)
    triangles = polygons_as_triangles(vertices, [[0, 1, 2, 3, 4, 5]])
    edges = {tuple(sorted(edge)) for a, b, c in triangles.tolist() for edge in ((a, b), (b, c), (c, a))}
    assert {(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (0, 5)} <= edges
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    mixed = polygons_as_triangles(square, [[0, 1], [0, 1, 2, 3], [0, 1, 2], [3]])
    assert mixed.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]
