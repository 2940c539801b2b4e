"""Faces of any number of corners, also not convex, in OFF, OBJ and PLY, in the dialects of other programs."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.errors import MeshRefused
from kit1000.parts.files.polygons import triangles_of
from kit1000.parts.files.sources import read_mesh

OUTLINE = np.array([(0, 0), (40, 0), (40, 8), (25, 8), (20, 15), (8, 15), (8, 30), (0, 30)], dtype=float)
N = len(OUTLINE)
VERTICES = np.concatenate([np.column_stack([OUTLINE, np.full(N, z)]) for z in (0, 10)])
AREA = 0.5 * abs(np.dot(OUTLINE[:, 0], np.roll(OUTLINE[:, 1], -1)) - np.dot(OUTLINE[:, 1], np.roll(OUTLINE[:, 0], -1)))
FACES = [list(range(N))[::-1], list(range(N, 2 * N)), *([k, (k + 1) % N, (k + 1) % N + N, k + N] for k in range(N))]


def off(header: str = "OFF\n", tail: str = "", counts: str = " 24") -> str:
    rows = [f"{len(VERTICES)} {len(FACES)}{counts}", *(f"{x} {y} {z}{tail}" for x, y, z in VERTICES)]
    return header + "\n".join([*rows, *(f"{len(face)} {' '.join(map(str, face))}" for face in FACES)]) + "\n"


def wrapped(text: str, words: int, colour: str = "") -> str:
    """The vertices and faces of an OFF file over lines of at most so many words; a colour ends each face."""
    header, counts, *rows = text.splitlines()
    lines = []
    for number, row in enumerate(rows):
        pieces = [" ".join(row.split()[k : k + words]) for k in range(0, len(row.split()), words)]
        pieces[-1] += colour if number >= len(VERTICES) else ""
        lines += pieces
    return "\n".join([header, counts, *lines]) + "\n"


def obj(corner: str = "{}", relative: bool = False) -> str:
    points = "".join(f"v {x} {y} {z}\n" for x, y, z in VERTICES)
    rows = ["f " + " ".join(corner.format(i - len(VERTICES) if relative else i + 1) for i in face) for face in FACES]
    return points + "vt 0 0\nvn 0 0 1\n" + "\n".join(rows) + "\n"


PLY_HEADER = (
    "ply\nformat {form} 1.0\ncomment made\nelement vertex 16\nproperty float x\nproperty float y\nproperty float z\n"
    "property uchar red\nelement face 10\nproperty list uchar int vertex_indices\nproperty uchar flag\nend_header\n"
)


def ply_text() -> bytes:
    rows = [*(f"{x} {y} {z} 255" for x, y, z in VERTICES)]
    rows += [f"{len(face)} {' '.join(map(str, face))} 1" for face in FACES]
    return (PLY_HEADER.format(form="ascii") + "\n".join(rows) + "\n").encode()


def ply_binary(order: str) -> bytes:
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    body = b"".join(struct.pack(f"{order}fffB", *row, 255) for row in VERTICES)
    body += b"".join(struct.pack(f"{order}B{len(face)}iB", len(face), *face, 1) for face in FACES)
    return PLY_HEADER.format(form=form).encode() + body


FILES = {
    "a.off": off().encode(),
    "colours.off": off("COFF\n", " 0.5 0.5 0.5 1").encode(),
    "header.off": off("# made\nOFF ").encode(),
    "short.off": off(counts="").encode(),
    "bare.off": off("").encode(),
    "crlf.off": off().replace("\n", "\r\n").encode(),
    "cr.off": off().replace("\n", "\r").encode(),
    "mark.off": b"\xef\xbb\xbf" + off().encode(),
    "comments.off": off().replace("\n", " # here\n").encode(),
    "wrapped.off": wrapped(off(), 5).encode(),
    "word.off": wrapped(off(), 1).encode(),
    "wrapped-normals.off": wrapped(off("NOFF\n", " 0 0 1"), 4).encode(),
    "wrapped-all.off": wrapped(off("STCNOFF\n", " 0 0 1 0.5 0.5 0.5 1 0 0"), 7).encode(),
    "wrapped-colours.off": wrapped(off(), 5, " 0.5 0.5 0.5").encode(),
    "a.obj": obj().encode(),
    "texture.obj": obj("{}/1").encode(),
    "normal.obj": obj("{}//1").encode(),
    "both.obj": obj("{}/1/1").encode(),
    "relative.obj": obj(relative=True).encode(),
    "crlf.obj": obj().replace("\n", "\r\n").encode(),
    "cr.obj": obj().replace("\n", "\r").encode(),
    "mark.obj": b"\xef\xbb\xbf" + obj().encode(),
    "continued.obj": obj().replace(" 4 ", " \\\n4 ").encode(),
    "a.ply": ply_text(),
    "crlf.ply": ply_text().replace(b"\n", b"\r\n"),
    "little.ply": ply_binary("<"),
    "big.ply": ply_binary(">"),
}


def written(folder: Path, name: str, data: bytes) -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("name", FILES)
def test_faces_of_any_number_of_corners_are_read(name: str, tmp_path: Path) -> None:
    reading = read_mesh(written(tmp_path, name, FILES[name]), "mm")
    assert reading.mesh.volume * 1e9 == pytest.approx(10 * AREA, rel=1e-6)
    assert reading.mesh.area * 1e6 == pytest.approx(
        2 * AREA + 10 * np.linalg.norm(np.roll(OUTLINE, -1, axis=0) - OUTLINE, axis=1).sum(), rel=1e-6
    )  # no triangle lies outside of its face
    assert reading.notes == ()


def test_indices_from_the_back_count_from_where_they_stand(tmp_path: Path) -> None:
    pieces = []
    for k in range(4):
        corners = [(0, 0, 0), (30, 0, 0), (0, 30, 0), (0, 0, 30)]
        face = [corners[i] for i in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))[k]]
        pieces += [f"v {x} {y} {z}" for x, y, z in face] + ["f -3 -2 -1"]
    reading = read_mesh(written(tmp_path, "a.obj", "\n".join(pieces).encode()), "mm")
    assert reading.mesh.volume * 1e9 == pytest.approx(4500)


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("a.off", off("OFF BINARY\n"), "not readable as OFF: binary"),
        ("a.off", off("4OFF\n"), "not readable as OFF: .*not of three dimensions"),
        ("a.off", off().replace("16 10", "16 11"), "not readable as OFF: 16 vertices and 11 faces in 26 lines"),
        ("a.off", off().replace("4 7 0 8 15", "4 7 0 8"), "a face with fewer corners than it says"),
        ("a.off", off().replace("4 7 0 8 15", "4 7 0 8 16"), "not readable as OFF: faces name vertex 16 of 16"),
        ("a.off", off().replace("40.0", "4O.0"), "not readable as OFF: a coordinate is not a number"),
        ("a.off", wrapped(off(), 5)[:-9], "not readable as OFF: "),
        ("a.off", wrapped(off(), 5, " 1 1 1 1 1"), "not readable as OFF: "),
        ("a.off", wrapped(off(), 5).replace("4 7 0 8 15", "99 7 0 8 15"), "not readable as OFF: "),
        ("a.obj", obj().replace("f 8 1", "f 0 1"), "not readable as OBJ: faces name vertex -1 of 16"),
        ("a.obj", obj().replace("f 8 1", "f x 1"), "not readable as OBJ: a corner of a face is not a whole number"),
        ("a.obj", obj() + "v 1 2\n", "not readable as OBJ: line 29 has fewer than 3 coordinates"),
        ("a.obj", obj() + "cstype bspline\nsurf 0 1 0 1 1 2 3 4\n", "holds curved surfaces"),
        ("a.obj", obj().encode("utf-16"), "text in UTF-16"),
        ("a.ply", ply_text()[:-60], "cut short or damaged: fewer than the declared 10 of element face"),
        ("a.ply", ply_binary("<")[:-9], "cut short or damaged: fewer than the declared 10 of element face"),
        ("a.ply", ply_text().replace(b"list uchar int", b"list uchar word"), "'property list uchar word"),
        ("a.ply", ply_text().replace(b"float x", b"float u"), "vertices without x, y and z"),
        ("a.ply", ply_text().replace(b"ascii", b"utf8"), "format 'utf8'"),
        ("a.ply", ply_text().replace(b"element face", b"element tristrips"), "strips of triangles"),
    ],
)
def test_a_damaged_file_is_refused_with_the_place(name: str, data: str | bytes, reason: str, tmp_path: Path) -> None:
    with pytest.raises(MeshRefused, match=reason) as caught:
        read_mesh(written(tmp_path, name, data.encode() if isinstance(data, str) else data))
    assert "\n" not in caught.value.reason


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
    triangles = triangles_of(vertices, [list(range(corners))])
    first, second = (vertices[triangles[:, k]] - vertices[triangles[:, 0]] for k in (1, 2))
    normals = np.cross(first, second)
    ahead = np.roll(flat, -1, axis=0)
    area = 0.5 * (flat[:, 0] * ahead[:, 1] - flat[:, 1] * ahead[:, 0]).sum()
    direction = np.cross(vertices, np.roll(vertices, -1, axis=0)).sum(0)
    assert len(triangles) == corners - 2
    assert 0.5 * np.linalg.norm(normals, axis=1).sum() == pytest.approx(area)
    assert (normals @ direction > -1e-12).all()


def test_corners_on_a_line_stay_in_the_triangles() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 2, 0], [1, 2, 0], [0, 2, 0]], dtype=float)
    triangles = triangles_of(vertices, np.array([[0, 1, 2, 3, 4, 5]]))
    edges = {tuple(sorted(edge)) for a, b, c in triangles.tolist() for edge in ((a, b), (b, c), (c, a))}
    assert {(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (0, 5)} <= edges
    first, second = (vertices[triangles[:, k]] - vertices[triangles[:, 0]] for k in (1, 2))
    normals = np.cross(first, second)
    assert normals[:, 2].sum() == pytest.approx(8)


def test_polygons_of_mixed_lengths_keep_all_their_triangles() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    triangles = triangles_of(vertices, [[0, 1], [0, 1, 2, 3], [0, 1, 2], [3]])
    assert triangles.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]
