"""Tests of STL and 3MF export: other readers find the assembly, in millimetres, on z = 0."""

from __future__ import annotations

import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import lxml.etree as etree
import numpy as np
import pytest
import trimesh

from kit1000.dataset.geometry import Geometry
from kit1000.errors import InputError
from kit1000.export import ASSEMBLY_FORMATS, FORMATS, export
from kit1000.export.threemf import threemf_bytes, write_3mf
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.mesh import Mesh, defect_float32, solid_from_mesh
from kit1000.parts.files.read import read_mesh
from kit1000.values import Assembly
from tests.samples.kits import sample_kit, sample_part

NAME = '<kits & "parts">'


@pytest.fixture(scope="module")
def assembly() -> Assembly:
    plan = AssemblyPlan(0.2, 1.0, (SidePlate(0, 0.6), SidePlate(3, 0.3)))
    made = build_assembly(NAME, [sample_kit(family) for family in ("tee", "foot", "cover")], plan)
    return Assembly(NAME, made.mesh.rounded_float32(), made.mounts)  # as a dataset holds it


@pytest.fixture
def source(assembly: Assembly, monkeypatch: pytest.MonkeyPatch) -> Geometry:
    """A geometry with the same assembly under two ids."""
    there = SimpleNamespace(
        root="fake",
        assemblies={"train-0000": {"split": "train"}, "test-0000": {"split": "test"}},
        assembly=lambda _: assembly,
    )
    return cast(Geometry, SimpleNamespace(geometry=there))


@pytest.mark.parametrize("ending", ["stl", "3mf"])
def test_a_file_read_back_is_the_assembly_in_millimetres(ending: str, assembly: Assembly, tmp_path: Path) -> None:
    path = ASSEMBLY_FORMATS[ending][1](assembly, tmp_path / f"assembly.{ending}")
    seen = trimesh.load_scene(path).to_mesh()
    assert seen.is_watertight
    assert seen.volume == pytest.approx(assembly.mesh.volume * 1e9, rel=1e-6)
    np.testing.assert_allclose(seen.bounds, assembly.mesh.bounds * 1e3, atol=1e-4)
    assert seen.bounds[0, 2] == pytest.approx(0, abs=1e-4)  # it stands, z up


@pytest.mark.parametrize("ending", ["stl", "3mf"])
def test_parts_seat_in_the_assembly_read_back(ending: str, assembly: Assembly, tmp_path: Path) -> None:
    seen = trimesh.load_scene(ASSEMBLY_FORMATS[ending][1](assembly, tmp_path / f"assembly.{ending}")).to_mesh()
    solid = solid_from_mesh(Mesh(seen.vertices, seen.faces))
    for mount in assembly.mounts:
        up = mount.assembly_from_kit.rotate([0.0, 0.0, 1.0])
        seated = mount.assembly_from_kit @ mount.kit.slot.kit_from_part
        part = solid_from_mesh(sample_part(mount.kit.id).mesh.moved(seated).scaled(1e3))
        assert part.translate(tuple(up)).min_gap(solid, 5) == pytest.approx(1, abs=0.01)  # a millimetre off its floor


@pytest.mark.parametrize("ending", ["stl", "3mf"])
def test_read_mesh_finds_the_same_solid(ending: str, assembly: Assembly, tmp_path: Path) -> None:
    path = ASSEMBLY_FORMATS[ending][1](assembly, tmp_path / f"assembly.{ending}")
    reading = read_mesh(path, None if ending == "3mf" else "mm")
    assert reading.unit == "mm"
    assert reading.unit_guessed is False
    assert reading.mesh.volume == pytest.approx(assembly.mesh.volume, rel=1e-6)
    np.testing.assert_allclose(reading.mesh.extents, assembly.mesh.extents, atol=1e-7)
    assert defect_float32(reading.mesh) is None


def test_a_3mf_holds_every_vertex_and_face_to_the_bit(assembly: Assembly, tmp_path: Path) -> None:
    root = model(write_3mf(assembly, tmp_path / "assembly.3mf"))
    space = {"c": "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"}
    assert root.attrib["unit"] == "millimeter"
    assert [item.attrib["objectid"] for item in root.findall("c:build/c:item", space)] == ["1"]
    things = root.findall("c:resources/c:object", space)
    assert [(thing.attrib["id"], thing.attrib["name"]) for thing in things] == [("1", NAME)]
    vertices = [
        [float(v.attrib[axis]) for axis in "xyz"] for v in things[0].findall("c:mesh/c:vertices/c:vertex", space)
    ]
    faces = [[int(t.attrib[v]) for v in ("v1", "v2", "v3")] for t in things[0].iterfind("c:mesh/c:triangles/*", space)]
    np.testing.assert_array_equal(vertices, assembly.mesh.vertices * 1e3)
    np.testing.assert_array_equal(faces, assembly.mesh.faces)


def test_a_3mf_is_a_package_whose_parts_all_have_a_type(assembly: Assembly, tmp_path: Path) -> None:
    with zipfile.ZipFile(write_3mf(assembly, tmp_path / "assembly.3mf")) as archive:
        assert archive.testzip() is None
        names = archive.namelist()
        types = etree.fromstring(archive.read("[Content_Types].xml"))
        relations = etree.fromstring(archive.read("_rels/.rels"))
    endings = {node.attrib["Extension"] for node in types}
    assert {name.rpartition(".")[2] for name in names[1:]} == endings
    assert names[0] == "[Content_Types].xml"
    assert [node.attrib["Target"] for node in relations] == ["/3D/3dmodel.model"]
    assert "3D/3dmodel.model" in names


def model(path: Path) -> etree._Element:
    with zipfile.ZipFile(path) as archive:
        return etree.fromstring(archive.read("3D/3dmodel.model"))


def test_the_same_assembly_gives_the_same_bytes(assembly: Assembly) -> None:
    assert threemf_bytes("a", assembly.mesh) == threemf_bytes("a", assembly.mesh)


@pytest.mark.parametrize("name", ASSEMBLY_FORMATS)
def test_all_assemblies_of_a_split_or_the_given_ids_are_exported(name: str, source: Geometry, tmp_path: Path) -> None:
    ending = ASSEMBLY_FORMATS[name][0]
    assert export(source, name, tmp_path / "all") == tmp_path / "all"
    export(source, name, tmp_path / "split", split="test")
    export(source, name, tmp_path / "asked", ids=("train-0000",))
    found = {path.name: sorted(entry.name for entry in path.iterdir()) for path in tmp_path.iterdir()}
    assert found == {
        "all": [f"test-0000{ending}", f"train-0000{ending}"],
        "split": [f"test-0000{ending}"],
        "asked": [f"train-0000{ending}"],
    }


def test_an_unknown_format_or_split_is_one_line(source: Geometry, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"^no export format 'step'; there are {', '.join(FORMATS)}$"):
        export(source, "step", tmp_path)
    with pytest.raises(InputError, match=r"^fake: no assemblies in split 'val'$"):
        export(source, "stl", tmp_path, split="val")
