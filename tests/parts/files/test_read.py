"""Reading mesh files as parts: formats and units agree, files that are no part are refused with one line."""

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
from kit1000.parts.files import read
from kit1000.parts.files.read import USER_UNITS, MeshReading, mesh_files, read_mesh, refusal_counts
from tests.samples.foreign_files import cases, written


def exported(mesh: trimesh.Trimesh, kind: str = "stl") -> bytes:
    data = mesh.export(file_type=kind)
    assert isinstance(data, bytes | str)
    return data.encode() if isinstance(data, str) else data


BOX = trimesh.creation.box((40, 20, 10))
STL = exported(BOX)
OPEN = exported(trimesh.Trimesh(BOX.vertices, BOX.faces[2:], process=False))
TUBE = exported(trimesh.Trimesh(BOX.vertices, BOX.faces[np.abs(BOX.face_normals[:, 1]) < 0.9], process=False))
APART = np.array([BOX.triangles, BOX.triangles + [60, 0, 0]]).reshape(-1, 3, 3)
TWO = exported(trimesh.Trimesh(**trimesh.triangles.to_kwargs(APART), process=False))
NAN = STL[:84] + STL[84:].replace(struct.pack("<f", 20.0), struct.pack("<f", np.nan))
PLY_HEADER = b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n"
TETRAHEDRON = b"v 0 0 0\nv %s 0 0\nv 0 30 0\nv 0 0 30\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n"


def _needing_version(archive: bytes, version: int) -> bytes:
    """A zip archive whose entries ask for a reader of some version, in tenths."""
    changed, entry = bytearray(archive), archive.find(b"PK\1\2")
    changed[entry + 6 : entry + 8] = version.to_bytes(2, "little")
    return bytes(changed)


REFUSED: dict[str, tuple[bytes, str]] = {  # name -> (bytes, fact)
    "empty.stl": (b"", "empty file"),
    "short.stl": (STL[:40], "not a mesh: 40 bytes"),
    "header.stl": (STL[:84], "12 triangles declared, room for 0"),
    "noise.stl": (np.random.default_rng(0).bytes(5000), "cut short or not an STL"),
    "none.stl": (b"\0" * 84, "holds no triangles"),
    "nan.stl": (NAN, "NaN or infinite vertices: 18 of 36"),
    "open.stl": (OPEN, "not closed: 4 open edges in one hole of 40 mm"),
    "tube.stl": (TUBE, "not closed: 8 open edges in 2 holes, the widest 40 mm"),
    "two.stl": (TWO, "2 separate bodies (50%, 50% of the volume)"),
    "points.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "holds no triangles"),
    "point.obj": (b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "zero thickness"),
    "index.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "vertex 8 of 3"),
    "noise.obj": (np.random.default_rng(1).bytes(3000), "binary data"),
    "infinite.obj": (TETRAHEDRON % b"1e400", "NaN or infinite vertices: 1 of 4"),
    "astronomic.obj": (TETRAHEDRON % b"1e300", "longest side 1e+297 m when read in mm"),
    "huge.ply": (PLY_HEADER, "4,000,000,000 elements declared in"),
    "text.ply": (b"hello", "no header"),
    "cut.glb": (exported(BOX, "glb")[:-200], "cut short"),
    "noise.glb": (np.random.default_rng(2).bytes(3000), "its first bytes are not glTF"),
    "part.off": (b"OFF\n3 1 0\n", "not a mesh format: .off; known are .stl"),
    "newer.3mf": (_needing_version(exported(BOX, "3mf"), 99), "needs a newer reader; save it again"),
    "noise.3mf": (np.random.default_rng(3).bytes(3000), "not a zip archive"),
    "part.sldprt": (b"proprietary", "not a mesh format: .sldprt"),
    "part": (b"nameless", "not a mesh format: no suffix"),
}


def scaled(factor: float, suffix: str = "stl") -> bytes:
    return exported(trimesh.Trimesh(BOX.vertices * factor, BOX.faces, process=False), suffix)


def reading_or_reason(path: Path) -> MeshReading | str:
    try:
        return read_mesh(path)
    except MeshRefused as refused:
        return refused.reason


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_cannot_be_a_part_is_refused_with_one_line(name: str, tmp_path: Path) -> None:
    data, fact = REFUSED[name]
    reason = reading_or_reason(written(tmp_path / name, data))
    assert isinstance(reason, str)
    assert fact in reason
    assert "\n" not in reason
    assert str(tmp_path) not in reason


@given(st.integers(0, len(STL) - 1), st.none() | st.integers(0, 255), st.sampled_from([".stl", ".ply", ".obj", ".glb"]))
@example(99, 127, ".stl")  # a signalling NaN
@settings(max_examples=150)
def test_a_damaged_or_cut_file_raises_no_other_exception(
    tmp_path_factory, place: int, byte: int | None, suffix: str
) -> None:
    data = bytearray(STL if suffix == ".stl" else scaled(1, suffix[1:]))
    place %= len(data)
    data[place:] = b"" if byte is None else bytes([byte]) + data[place + 1 :]
    outcome = reading_or_reason(written(tmp_path_factory.getbasetemp() / f"damaged{suffix}", bytes(data)))
    assert isinstance(outcome, str) or defect_float32(outcome.mesh) is None


def test_memory_does_not_depend_on_the_declared_count(tmp_path: Path) -> None:
    path = written(tmp_path / "huge.stl", b"\0" * 80 + struct.pack("<I", 4_000_000_000) + b"\0" * 500)
    tracemalloc.start()
    reason = reading_or_reason(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "4,000,000,000 triangles declared, room for 10" in str(reason)
    assert peak < 1e6


def test_too_many_triangles_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(read, "MAX_FACES", 11)
    for suffix in ("stl", "stl_ascii", "obj", "ply", "glb", "3mf"):
        path = written(tmp_path / f"{suffix}.{suffix.partition('_')[0]}", exported(BOX, suffix))
        assert "more than 11" in str(reading_or_reason(path))


def test_folders_missing_files_and_unreadable_files_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "folder.stl").mkdir()
    path = written(tmp_path / "locked.stl", STL)
    assert "is a folder" in str(reading_or_reason(tmp_path / "folder.stl"))
    assert "no such file or directory" in str(reading_or_reason(tmp_path / "missing.stl"))

    def locked(_: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", locked)
    assert "permission denied" in str(reading_or_reason(path))


@pytest.mark.parametrize("suffix", ["stl", "stl_ascii", "obj", "ply", "3mf", "glb"])
def test_every_format_gives_the_same_part(suffix: str, tmp_path: Path) -> None:
    rod = trimesh.creation.cylinder(6, 30, sections=20)
    rod.apply_transform(trimesh.transformations.rotation_matrix(0.3, (1, 2, 3)))
    path = written(tmp_path / f"rod.{suffix.partition('_')[0]}", exported(rod, suffix))
    reading = read_mesh(path, "mm")
    corners = z_up(rod.vertices) if suffix == "glb" else rod.vertices  # glTF is y up
    assert reading.mesh.volume == pytest.approx(rod.volume * 1e-9, rel=1e-5)
    assert np.abs(reading.mesh.bounds - np.array([corners.min(0), corners.max(0)]) * 1e-3).max() < 1e-8
    assert reading.notes == ()
    assert (reading.unit, reading.unit_guessed, reading.path) == ("mm", False, path)


def test_a_part_far_from_its_origin_keeps_its_shape(tmp_path: Path) -> None:
    vertices = b"".join(b"v %.6f %.6f %.6f\n" % (x + 1e6, y, z) for x, y, z in BOX.vertices)
    faces = b"".join(b"f %d %d %d\n" % tuple(face + 1) for face in BOX.faces)
    reading = read_mesh(written(tmp_path / "far.obj", vertices + faces))
    assert reading.mesh.volume == pytest.approx(8e-6, rel=1e-6)
    assert reading.notes == ("moved to the origin from 1000 m away",)


@given(st.floats(1e-2, 1e5))
@settings(max_examples=60)
def test_a_guessed_unit_gives_a_plausible_size_if_any_unit_does(tmp_path_factory, longest: float) -> None:
    outcome = reading_or_reason(written(tmp_path_factory.getbasetemp() / "guess.stl", scaled(longest / 40)))
    plausible = [unit for unit, metres in USER_UNITS.items() if 0.0051 < longest * metres < 0.499]
    if isinstance(outcome, str):
        assert not plausible
        return
    assert outcome.unit_guessed
    assert outcome.mesh.extents.max() == pytest.approx(longest * USER_UNITS[outcome.unit], rel=1e-5)
    assert not plausible or 0.005 <= outcome.mesh.extents.max() * (1 + 1e-6) <= 0.50001
    assert "override with the unit option (mm, cm, m, inch)" in outcome.unit_reason


@pytest.mark.parametrize(
    ("longest", "unit"), [(40, "mm"), (490, "mm"), (0.04, "m"), (0.3, "m"), (1.57, "inch"), (4, "inch")]
)
def test_the_most_frequent_plausible_unit_is_guessed(longest: float, unit: str, tmp_path: Path) -> None:
    assert read_mesh(written(tmp_path / "part.stl", scaled(longest / 40))).unit == unit


@pytest.mark.parametrize("unit", USER_UNITS)
def test_a_given_unit_is_used_for_any_size(unit: str, tmp_path: Path) -> None:
    reading = read_mesh(written(tmp_path / "part.stl", scaled(0.02)), unit)
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
        read_mesh(written(tmp_path / "part.stl", scaled(longest / 40)), unit)


def test_a_unit_stated_in_the_file_is_used(tmp_path: Path) -> None:
    glb = read_mesh(written(tmp_path / "part.glb", scaled(1e-4, "glb")))
    threemf = read_mesh(written(tmp_path / "part.3mf", scaled(0.01, "3mf")))
    assert [(each.unit, each.unit_guessed) for each in (glb, threemf)] == [("m", False), ("mm", False)]
    assert glb.mesh.extents.max() == pytest.approx(0.004)
    assert threemf.mesh.extents.max() == pytest.approx(0.0004)
    with pytest.raises(InputError, match="'furlong': expected one of mm, cm, m, inch"):
        read_mesh(tmp_path / "part.glb", "furlong")


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


def test_a_folder_is_searched_deeply_in_order(tmp_path: Path) -> None:
    abc = [f"0000/0000000{i}/0000000{i}_{'ab' * 12}_trimesh_000.obj" for i in (2, 1)]
    for name in (*abc, "z.STL", "a.ply", "notes.md", ".hidden.stl", ".git/x.stl"):
        written(tmp_path / name, STL)
    found = [str(path.relative_to(tmp_path)) for path in mesh_files(tmp_path)]
    assert found == [abc[1], abc[0], "a.ply", "z.STL"]
    assert mesh_files(tmp_path / "z.STL") == mesh_files(str(tmp_path / "z.STL")) == [tmp_path / "z.STL"]


NAMES = ["b.stl", "a part.stl", "Gehäuse.stl"]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_list_may_have_any_line_ends_and_mark(encoding: str, end: str, tmp_path: Path) -> None:
    listing = written(tmp_path / "list.txt", end.join(["# mine", "", *NAMES, ""]).encode(encoding))
    assert mesh_files(listing) == [tmp_path / name for name in NAMES]


def test_a_list_may_hold_folders_and_names_that_are_no_utf_8(tmp_path: Path) -> None:
    odd = os.fsencode(tmp_path) + b"/Geh\xe4use.stl"
    for name in (odd, os.fsencode(tmp_path) + b"/a part.stl"):
        Path(os.fsdecode(name)).write_bytes(b"x")
    inside = written(tmp_path / "more/b.stl", STL)
    found = mesh_files(written(tmp_path / "list.txt", b"a part.stl\nGeh\xe4use.stl\nmore\n"))
    assert all(path.is_file() for path in found)
    assert os.fsencode(found[1]) == odd
    assert found[2] == inside


@pytest.mark.parametrize(
    ("name", "data", "fact"),
    [
        ("missing", None, "does not exist"),
        ("", None, "no mesh files inside"),
        ("list.txt", b"\xff\xfe\x00", "cannot be read as a list of paths"),
        ("list.txt", "\n".join(NAMES).encode("utf-16-le"), "UTF-16"),
    ],
)
def test_nothing_to_read_is_an_input_error(name: str, data: bytes | None, fact: str, tmp_path: Path) -> None:
    if data is not None:
        written(tmp_path / name, data)
    with pytest.raises(InputError, match=fact):
        mesh_files(tmp_path / name)


CASES = cases()
WHOLE = ("root-by-relationship.3mf", "lower-case.stl", "upper-case.stl", "carriage-returns.stl", "byte-order-mark.stl")
NAMED = {  # what the refusal names
    "negative-volume-slic3r.3mf": "NegativeVolume",
    "modifier-slic3r.3mf": "ParameterModifier",
    "support-blocker-bambu.3mf": "support_blocker",
    "support-object-touching.3mf": "support",
    "cutting-mesh-cura.3mf": "cutting_mesh",
    "support-mesh-cura.3mf": "support_mesh",
    "boolean-shape.3mf": "booleanoperations",
    "draco.glb": "Draco compression",
    "quantized-bytes.glb": "quantized positions",
    "sparse-positions.glb": "sparse",
    "escaped-name.gltf": "not a mesh format: .gltf",
    "polygons.off": "not a mesh format: .off",
    "own-camera/decimal-comma.stl": "line 4: '0,000000e+00' is no number (a decimal comma)",
}


@pytest.mark.skipif(CASES is None, reason="the folder of cases is absent")
@pytest.mark.parametrize("name", [*WHOLE, *NAMED])
def test_a_case_is_the_part_that_was_meant_or_is_refused_by_name(name: str) -> None:
    assert CASES is not None
    outcome = reading_or_reason(CASES / name)
    if isinstance(outcome, str):
        assert NAMED[name] in outcome
        assert "export" in outcome or "known are" in outcome
    else:
        assert name in WHOLE
        assert outcome.mesh.extents * 1e3 == pytest.approx((42, 24, 14), abs=1e-3)
        assert outcome.mesh.volume * 1e9 == pytest.approx(9283, rel=1e-5)


def test_real_parts_are_accepted_with_their_volumes(real_parts: Path) -> None:
    with (real_parts / "manifest.csv").open(encoding="utf-8", newline="") as rows:
        truth = {row["file"]: row for row in csv.DictReader(rows)}
    outcomes = {path.name: reading_or_reason(path) for path in mesh_files(real_parts)[::9]}  # all take half a minute
    closed = {name for name in outcomes if truth[name]["watertight"] == "True"}
    accepted = {name: outcome for name, outcome in outcomes.items() if isinstance(outcome, MeshReading)}
    assert len(closed & accepted.keys()) >= 0.95 * len(closed)
    for name in closed & accepted.keys():
        metres = USER_UNITS[accepted[name].unit]
        assert accepted[name].mesh.volume == pytest.approx(float(truth[name]["volume"]) * metres**3, rel=5e-3)
        assert defect_float32(accepted[name].mesh) is None
    stated = [name for name in accepted if truth[name]["units"] in USER_UNITS]
    assert np.mean([accepted[name].unit == truth[name]["units"] for name in stated]) >= 0.95
