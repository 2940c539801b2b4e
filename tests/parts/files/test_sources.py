"""Reading mesh files: formats and units agree, damaged files are refused with one line, a bad file stops no run."""

from __future__ import annotations

import csv
import os
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kit1000.errors import InputError, MeshRefused
from kit1000.mesh import defect_float32, z_up
from kit1000.parts.files import formats, sources
from kit1000.parts.files.refusals import refusal_counts
from kit1000.parts.files.sources import USER_UNITS, MeshReading, Refusal, mesh_files, read_all, read_mesh


def exported(mesh: trimesh.Trimesh, kind: str = "stl") -> bytes:
    data = mesh.export(file_type=kind)
    assert isinstance(data, bytes | str)
    return data.encode() if isinstance(data, str) else data


BOX = trimesh.creation.box((40, 20, 10))
STL = exported(BOX)
ASCII_STL = exported(BOX, "stl_ascii")
OPEN = exported(trimesh.Trimesh(BOX.vertices, BOX.faces[2:], process=False))
APART = np.array([BOX.triangles, BOX.triangles + [60, 0, 0]]).reshape(-1, 3, 3)
TWO = exported(trimesh.Trimesh(**trimesh.triangles.to_kwargs(APART), process=False))
NAN = STL[:84] + STL[84:].replace(struct.pack("<f", 20.0), struct.pack("<f", np.nan))
PLY_HEADER = b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n"
POINT = b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n"
TETRAHEDRON = b"v 0 0 0\nv %s 0 0\nv 0 30 0\nv 0 0 30\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n"


def _needing_version(archive: bytes, version: int) -> bytes:
    """A zip archive whose entries ask for a reader of some version, in tenths."""
    changed, entry = bytearray(archive), archive.find(b"PK\1\2")
    changed[entry + 6 : entry + 8] = version.to_bytes(2, "little")
    return bytes(changed)


REFUSED = {  # name -> (bytes, what the reason begins with)
    "empty.stl": (b"", r"empty file$"),
    "text.stl": (b"Dear all, please find attached\n" * 9, r"not a mesh: text file$"),
    "short.stl": (STL[:40], r"not a mesh: 40 bytes"),
    "header.stl": (STL[:84], r"cut short or not an STL: 12 triangles declared, room for 0$"),
    "cut.stl": (STL[:-77], r"cut short or not an STL: 12 triangles declared, room for 10$"),
    "cut_text.stl": (ASCII_STL[: len(ASCII_STL) // 2], r"cut short|not closed"),
    "bad_text.stl": (
        ASCII_STL.replace(b"20.0", b"2O.O"),
        r"not readable as STL: a coordinate is not a number$",
    ),
    "noise.stl": (np.random.default_rng(0).bytes(5000), r"cut short or not an STL"),
    "none.stl": (b"\0" * 84, r"holds no triangles$"),
    "none_text.stl": (b"solid nothing\nendsolid nothing\n", r"holds no triangles$"),
    "nan.stl": (NAN, r"NaN or infinite vertices: \d+ of 36$"),
    "open.stl": (OPEN, r"not closed: 4 open edges in one hole of 40 mm"),
    "two.stl": (TWO, r"2 separate bodies \(50%, 50% of the volume\)$"),
    "points.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", r"holds no triangles$"),
    "point.obj": (POINT, r"zero thickness"),
    "index.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", r"not readable as OBJ: "),
    "noise.obj": (np.random.default_rng(1).bytes(3000), r"not a mesh: binary data"),
    "infinite.obj": (TETRAHEDRON % b"1e400", r"NaN or infinite vertices: 1 of 4$"),
    "astronomic.obj": (TETRAHEDRON % b"1e300", r"longest side 1e\+297 m when read in mm"),
    "huge.ply": (PLY_HEADER, r"damaged: 4,000,000,000 elements .*\d+ bytes$"),
    "huge.off": (b"OFF\n4000000000 4000000000 0\n0 0 0\n", r"not readable as OFF: "),
    "text.ply": (b"hello", r"not readable as PLY: "),
    "cut.glb": (exported(BOX, "glb")[:-200], r"not readable as GLB: "),
    "noise.glb": (np.random.default_rng(2).bytes(3000), r"not readable as glTF: its JSON part is damaged$"),
    "huge.gltf": (b'{"accessors": [{"count": 4000000000}]}', r"holds no triangles$"),
    "newer.3mf": (
        _needing_version(exported(BOX, "3mf"), 99),
        r"not readable as 3MF: its zip archive needs a newer reader; save it again$",
    ),
    "noise.3mf": (np.random.default_rng(3).bytes(3000), r"not readable as 3MF: not a zip archive$"),
    "part.sldprt": (b"proprietary", r"not a mesh format: \.sldprt; known are "),
    "part": (b"nameless", r"not a mesh format: no suffix; known are "),
}


def written(folder: Path, name: str, data: bytes) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def scaled(factor: float, suffix: str = "stl") -> bytes:
    return exported(trimesh.Trimesh(BOX.vertices * factor, BOX.faces, process=False), suffix)


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_cannot_be_a_part_is_refused_with_one_line(name: str, tmp_path: Path) -> None:
    data, reason = REFUSED[name]
    with pytest.raises(MeshRefused, match=reason) as caught:
        read_mesh(written(tmp_path, name, data))
    assert "\n" not in caught.value.reason
    assert str(tmp_path) not in caught.value.reason


@given(
    st.integers(0, len(STL) - 1),
    st.integers(0, 255),
    st.sampled_from([".stl", ".ply", ".off", ".obj", ".glb"]),
)
@example(99, 127, ".stl")  # a signalling NaN
@settings(max_examples=150)
def test_a_damaged_byte_never_raises_another_exception(tmp_path_factory, place: int, byte: int, suffix: str) -> None:
    data = bytearray(STL if suffix == ".stl" else scaled(1, suffix[1:]))
    data[place % len(data)] = byte
    path = written(tmp_path_factory.getbasetemp(), f"damaged{suffix}", bytes(data))
    outcomes = read_all([path])
    assert [len(outcome) for outcome in outcomes] in ([1, 0], [0, 1])
    assert all(defect_float32(reading.mesh) is None for reading in outcomes[0])


def test_memory_does_not_depend_on_the_declared_count(tmp_path: Path) -> None:
    path = written(tmp_path, "huge.stl", b"\0" * 80 + struct.pack("<I", 4_000_000_000) + b"\0" * 500)
    tracemalloc.start()
    with pytest.raises(MeshRefused, match="4,000,000,000 triangles declared, room for 10"):
        read_mesh(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e6


def test_too_many_triangles_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(formats, "MAX_FACES", 11)
    with pytest.raises(MeshRefused, match=r"^12 triangles, more than 11"):
        read_mesh(written(tmp_path, "box.stl", STL))


def test_folders_missing_files_and_unreadable_files_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(MeshRefused, match="is a folder"):
        read_mesh(tmp_path / "folder.stl")
    with pytest.raises(MeshRefused, match="cannot be read: no such file or directory"):
        read_mesh(tmp_path / "missing.stl")

    def locked(_: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    path = written(tmp_path, "locked.stl", STL)
    monkeypatch.setattr(Path, "read_bytes", locked)
    with pytest.raises(MeshRefused, match="cannot be read: permission denied"):
        read_mesh(path)


@pytest.mark.parametrize("suffix", ["stl", "stl_ascii", "obj", "ply", "off", "3mf", "glb"])
def test_every_format_gives_the_same_part(suffix: str, tmp_path: Path) -> None:
    rod = trimesh.creation.cylinder(6, 30, sections=20)
    rod.apply_transform(trimesh.transformations.rotation_matrix(0.3, (1, 2, 3)))
    path = written(tmp_path, f"rod.{suffix.partition('_')[0]}", exported(rod, suffix))
    reading = read_mesh(path, "mm")
    corners = z_up(rod.vertices) if suffix == "glb" else rod.vertices  # glTF is y up
    assert reading.mesh.volume == pytest.approx(rod.volume * 1e-9, rel=1e-5)
    assert np.abs(reading.mesh.bounds - np.array([corners.min(0), corners.max(0)]) * 1e-3).max() < 1e-8
    assert reading.notes == ()
    assert (reading.unit, reading.unit_guessed, reading.path) == ("mm", False, path)


def test_bytes_after_the_last_triangle_are_ignored_and_noted(tmp_path: Path) -> None:
    reading = read_mesh(written(tmp_path, "box.stl", STL + b"a colour table"))
    assert reading.notes == ("ignored 14 bytes after the last triangle",)


def test_a_binary_stl_may_begin_with_solid(tmp_path: Path) -> None:
    assert read_mesh(written(tmp_path, "box.stl", b"solid" + STL[5:])).mesh.volume == pytest.approx(8e-6)


def test_a_part_far_from_its_origin_keeps_its_shape(tmp_path: Path) -> None:
    vertices = b"".join(b"v %.6f %.6f %.6f\n" % (x + 1e6, y, z) for x, y, z in BOX.vertices)
    faces = b"".join(b"f %d %d %d\n" % tuple(face + 1) for face in BOX.faces)
    reading = read_mesh(written(tmp_path, "far.obj", vertices + faces))
    assert reading.mesh.volume == pytest.approx(8e-6, rel=1e-6)
    assert reading.notes == ("moved to the origin from 1000 m away",)


@given(st.floats(1e-2, 1e5))
@settings(max_examples=60)
def test_a_guessed_unit_gives_a_plausible_size_if_any_unit_does(tmp_path_factory, longest: float) -> None:
    path = written(tmp_path_factory.getbasetemp(), "guess.stl", scaled(longest / 40))
    plausible = [unit for unit, metres in USER_UNITS.items() if 0.0051 < longest * metres < 0.499]
    readings, refusals = read_all([path])
    for reading in readings:
        assert reading.unit_guessed
        assert reading.mesh.extents.max() == pytest.approx(longest * USER_UNITS[reading.unit], rel=1e-5)
        assert not plausible or 0.005 <= reading.mesh.extents.max() * (1 + 1e-6) <= 0.50001
        assert "override with the unit option (mm, cm, m, inch)" in reading.unit_reason
    assert not (refusals and plausible)


@pytest.mark.parametrize(
    ("longest", "unit"), [(40, "mm"), (490, "mm"), (0.04, "m"), (0.3, "m"), (1.57, "inch"), (4, "inch")]
)
def test_the_most_frequent_plausible_unit_is_guessed(longest: float, unit: str, tmp_path: Path) -> None:
    assert read_mesh(written(tmp_path, "part.stl", scaled(longest / 40))).unit == unit


@pytest.mark.parametrize("unit", USER_UNITS)
def test_a_given_unit_is_used_for_any_size(unit: str, tmp_path: Path) -> None:
    reading = read_mesh(written(tmp_path, "part.stl", scaled(0.02)), unit)
    assert reading.mesh.extents.max() == pytest.approx(0.8 * USER_UNITS[unit], rel=1e-5)
    assert (reading.unit, reading.unit_guessed) == (unit, False)


@pytest.mark.parametrize(
    ("longest", "unit", "way_out"),
    [
        (40, "m", "as --unit mm it would be 40 mm"),
        (0.04, "mm", "as --unit m it would be 40 mm"),
        (900, "m", "and no --unit makes it plausible: scale the file"),
    ],
)
def test_a_size_out_of_range_is_refused_with_the_unit_that_would_do(
    longest: float, unit: str, way_out: str, tmp_path: Path
) -> None:
    with pytest.raises(MeshRefused, match=f"when read in {unit}; expected 0.0001 to 10 m, {way_out}$"):
        read_mesh(written(tmp_path, "part.stl", scaled(longest / 40)), unit)


def test_several_holes_are_counted_and_the_widest_measured(tmp_path: Path) -> None:
    box = trimesh.creation.box((40, 20, 10))
    ends = np.abs(box.face_normals[:, 1]) > 0.9
    tube = exported(trimesh.Trimesh(box.vertices, box.faces[~ends], process=False))
    with pytest.raises(MeshRefused, match=r"not closed: 8 open edges in 2 holes.* 40 mm"):
        read_mesh(written(tmp_path, "tube.stl", tube))


def test_refusals_are_counted_by_kind() -> None:
    reasons = [
        "empty file",
        "not closed: 4 open edges in one hole of 20 mm",
        "not closed: 8 open edges",
        "2 separate bodies (50%, 50% of the volume)",
        "13 separate bodies (9%, ... of the volume)",
        "near-duplicate of bracket-2.stl",
        "near-duplicate of lever.stl",
        "not closed: 14 open edges",
        "longest side 40 m when read in m; expected 0.0001 to 10 m",
        "12 triangles, more than 11",
    ]
    counted = "3x not closed, 2x near-duplicate, 2x separate bodies, 1x empty file, 1x longest side N m, 1x triangles"
    assert refusal_counts(reasons) == counted
    assert refusal_counts([]) == ""


def test_a_unit_stated_in_the_file_is_used(tmp_path: Path) -> None:
    glb = read_mesh(written(tmp_path, "part.glb", scaled(1e-4, "glb")))
    assert (glb.unit, glb.unit_guessed) == ("m", False)
    assert glb.mesh.extents.max() == pytest.approx(0.004)
    threemf = read_mesh(written(tmp_path, "part.3mf", scaled(0.01, "3mf")))
    assert (threemf.unit, threemf.unit_guessed) == ("mm", False)
    assert threemf.mesh.extents.max() == pytest.approx(0.0004)


def test_an_unknown_unit_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    for ask in (lambda path: read_mesh(path, "furlong"), lambda path: read_all([path], "furlong")):
        with pytest.raises(InputError, match="'furlong': expected one of mm, cm, m, inch"):
            ask(written(tmp_path, "box.stl", STL))


def test_a_folder_is_searched_deeply_in_order(tmp_path: Path) -> None:
    abc = [f"0000/0000000{i}/0000000{i}_{'ab' * 12}_trimesh_000.obj" for i in (2, 1)]
    for name in (*abc, "z.STL", "a.ply", "notes.md", ".hidden.stl", ".git/x.stl"):
        written(tmp_path, name, STL)
    found = [str(path.relative_to(tmp_path)) for path in mesh_files(tmp_path)]
    assert found == [abc[1], abc[0], "a.ply", "z.STL"]


def test_a_list_may_contain_files_and_folders(tmp_path: Path) -> None:
    inside = written(tmp_path, "more/b.stl", STL)
    listing = written(tmp_path, "list.txt", b"# mine\n\na.stl\nmore\n")
    assert mesh_files(listing) == [tmp_path / "a.stl", inside]
    readings, refusals = read_all(mesh_files(listing))
    assert [reading.path for reading in readings] == [inside]
    assert refusals == [Refusal(tmp_path / "a.stl", "cannot be read: no such file or directory")]


def test_a_single_file_is_itself(tmp_path: Path) -> None:
    path = written(tmp_path, "box.stl", STL)
    assert mesh_files(path) == mesh_files(str(path)) == [path]


def test_nothing_to_read_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        mesh_files(tmp_path / "missing")
    with pytest.raises(InputError, match="no mesh files inside"):
        mesh_files(tmp_path)
    with pytest.raises(InputError, match="cannot be read as a list of paths"):
        mesh_files(written(tmp_path, "list.txt", b"\xff\xfe\x00"))


def test_bad_files_stop_no_run_and_workers_change_nothing(tmp_path: Path) -> None:
    files = [written(tmp_path, name, data) for name, (data, _) in list(REFUSED.items())[:4]]
    files[2:2] = [written(tmp_path, f"good{i}.stl", scaled(1 + i)) for i in range(2)]
    readings, refusals = read_all(files)
    assert [reading.path for reading in readings] == files[2:4]
    assert [refusal.path for refusal in refusals] == files[:2] + files[4:]
    parallel, again = read_all(files, workers=2)
    assert again == refusals
    for one, other in zip(readings, parallel, strict=True):
        assert np.array_equal(one.mesh.vertices, other.mesh.vertices)
        assert (one.path, one.unit_reason, one.notes) == (other.path, other.unit_reason, other.notes)


def read_or_die(path: Path) -> Refusal:
    """A reader that ends its process, as a segmentation fault does."""
    if path.name == "crashing":
        os._exit(1)
    return Refusal(path, "harmless")


def test_a_file_that_crashes_its_reader_is_refused_and_the_others_are_read() -> None:
    files = [Path("a"), Path("crashing"), Path("b")]
    outcomes = list(sources.read_parallel(read_or_die, files, workers=2))
    assert outcomes == [
        Refusal(Path("a"), "harmless"),
        Refusal(Path("crashing"), "its reader crashed"),
        Refusal(Path("b"), "harmless"),
    ]


def test_real_parts_are_accepted_with_their_volumes(real_parts: Path) -> None:
    with (real_parts / "manifest.csv").open(encoding="utf-8", newline="") as rows:
        truth = {row["file"]: row for row in csv.DictReader(rows)}
    files = mesh_files(real_parts)[::6]  # all of them take half a minute
    readings, refusals = read_all(files)
    closed = {name for name, row in truth.items() if row["watertight"] == "True"} & {file.name for file in files}
    accepted: dict[str, MeshReading] = {reading.path.name: reading for reading in readings}
    assert len(closed & accepted.keys()) >= 0.95 * len(closed)
    assert all(refusal.reason and "\n" not in refusal.reason for refusal in refusals)
    for name in closed & accepted.keys():
        metres = USER_UNITS[accepted[name].unit]
        assert accepted[name].mesh.volume == pytest.approx(float(truth[name]["volume"]) * metres**3, rel=5e-3)
        assert defect_float32(accepted[name].mesh) is None
    stated = [name for name in accepted if truth[name]["units"] in USER_UNITS]
    assert np.mean([accepted[name].unit == truth[name]["units"] for name in stated]) >= 0.95
