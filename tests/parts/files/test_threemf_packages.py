"""The archive of a 3MF file: its root by relationship, units and names of part files, extensions refused by name."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from kit1000.errors import MeshRefused
from kit1000.parts.files.sources import read_mesh
from tests.samples.foreign_files import PART, archive, mesh_xml, model_xml, object_xml

BASE = "http://schemas.microsoft.com/3dmanufacturing"
PRODUCTION = f'xmlns:p="{BASE}/production/2015/06"'
OTHER = model_xml(object_xml(1, mesh_xml(trimesh.creation.box((5, 5, 5)))), 'objectid="1"')
MODEL = model_xml(object_xml(1, mesh_xml(PART)), 'objectid="1"')


def size_of(path: Path) -> list[float]:
    return (read_mesh(path).mesh.extents * 1e3).round(4).tolist()


@pytest.mark.parametrize("root", ["3D/part.model", "Model.model", "3D/nested/root of all.model"])
def test_the_root_is_the_model_that_the_relationships_name(root: str, tmp_path: Path) -> None:
    assert size_of(archive(tmp_path / "a.3mf", MODEL, {"3D/3dmodel.model": OTHER}, root)) == [30, 20, 10]


def test_names_in_the_relationships_may_be_relative_or_percent_encoded(tmp_path: Path) -> None:
    for number, (target, name) in enumerate(
        [("3D/part.model", "3D/part.model"), ("/3D/my%20part.model", "3D/my part.model"), ("/3d/P.model", "3D/p.MODEL")]
    ):
        path = archive(tmp_path / f"{number}.3mf", OTHER, root="x")
        with zipfile.ZipFile(path) as file:
            relationships = file.read("_rels/.rels").decode().replace("/x", target)
        with zipfile.ZipFile(path, "w") as file:
            file.writestr("_rels/.rels", relationships)
            file.writestr("3D/3dmodel.model", OTHER)
            file.writestr(name, MODEL)
        assert size_of(path) == [30, 20, 10]


def test_a_root_that_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.3mf"
    archive(path, OTHER, root="3D/gone.model")
    with zipfile.ZipFile(path) as file:
        relationships = file.read("_rels/.rels").decode()
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("_rels/.rels", relationships)
        file.writestr("3D/3dmodel.model", OTHER)
    with pytest.raises(MeshRefused, match=r"names 3d/gone\.model, which is not in the archive"):
        read_mesh(path)


@pytest.mark.parametrize(("unit", "factor"), [("inch", 25.4), ("centimeter", 10), ("micron", 1e-3), ("foot", 304.8)])
def test_a_part_file_keeps_its_own_unit(unit: str, factor: float, tmp_path: Path) -> None:
    small = trimesh.Trimesh(PART.vertices / factor, PART.faces, process=False)
    inner = model_xml(object_xml(1, mesh_xml(small)), attributes=f'unit="{unit}"')
    place = f'p:path="/3D/Objects/my%20part.model" {PRODUCTION}'
    moved = 'transform="1 0 0 0 1 0 0 0 1 7 0 0"'  # in the unit of the root
    nested = object_xml(2, f'<components><component objectid="1" {place} {moved}/></components>')
    for number, model in enumerate([model_xml(nested, 'objectid="2"'), model_xml("", f'objectid="1" {place} {moved}')]):
        path = archive(tmp_path / f"{number}.3mf", model, {"3D/Objects/my part.model": inner})
        reading = read_mesh(path)
        assert np.allclose(reading.mesh.bounds * 1e3, [[7, 0, 0], [37, 20, 10]], atol=1e-4)
        assert (reading.unit, reading.unit_guessed) == ("mm", False)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("http://schemas.3mf.io/3dmanufacturing/booleanoperations/2023/07", "boolean shapes"),
        (f"{BASE}/securecontent/2019/07", "encrypted content"),
        (f"{BASE}/beamlattice/2017/02", "beam lattices"),
        ("http://schemas.3mf.io/3dmanufacturing/volumetric/2022/01", "volumetric data"),
        (f"{BASE}/production/alternatives/2021/04", "stand-ins"),
        ("http://example.org/unheard-of", "http://example.org/unheard-of"),
    ],
)
def test_an_unknown_required_extension_is_refused_by_name(address: str, words: str, tmp_path: Path) -> None:
    attributes = f'unit="millimeter" xmlns:x="{address}" requiredextensions="x"'
    model = model_xml(object_xml(1, mesh_xml(PART)), 'objectid="1"', attributes=attributes)
    with pytest.raises(MeshRefused, match=rf"requires the 3MF extension x \(.*{words}.*export it as a plain mesh"):
        read_mesh(archive(tmp_path / "a.3mf", model))
    inner = {"3D/inner.model": model}
    outer = model_xml("", f'objectid="1" p:path="/3D/inner.model" {PRODUCTION}')
    with pytest.raises(MeshRefused, match=r"3d/inner\.model requires the 3MF extension x"):
        read_mesh(archive(tmp_path / "b.3mf", outer, inner))


def test_extensions_that_change_no_shape_may_be_required(tmp_path: Path) -> None:
    attributes = f'unit="millimeter" {PRODUCTION} xmlns:m="{BASE}/material/2015/02" requiredextensions="p m"'
    model = model_xml(object_xml(1, mesh_xml(PART)), 'objectid="1"', attributes=attributes)
    assert size_of(archive(tmp_path / "a.3mf", model)) == [30, 20, 10]


def test_a_prefix_that_is_not_declared_is_refused(tmp_path: Path) -> None:
    attributes = 'unit="millimeter" requiredextensions="zz"'
    model = model_xml(object_xml(1, mesh_xml(PART)), 'objectid="1"', attributes=attributes)
    with pytest.raises(MeshRefused, match=r"extension zz \(not declared"):
        read_mesh(archive(tmp_path / "a.3mf", model))


@pytest.mark.parametrize(
    ("inside", "attributes", "reason"),
    [
        ('<b:booleanshape xmlns:b="urn:b" objectid="1" operation="union"/>', "", "object 2 is a booleanshape"),
        ('<d:displacementmesh xmlns:d="urn:d"/>', "", "object 2 is a displacementmesh"),
        (
            mesh_xml(PART),
            'xmlns:s="urn:s" s:slicestackid="7" s:meshresolution="lowres"',
            "object 2 has a mesh of resolution lowres, a stand-in",
        ),
        (
            mesh_xml(PART),
            'xmlns:a="urn:a" a:modelresolution="obfuscated"',
            "object 2 has a mesh of resolution obfuscated",
        ),
    ],
)
def test_a_shape_that_is_no_full_mesh_is_refused_where_it_is_used(
    inside: str, attributes: str, reason: str, tmp_path: Path
) -> None:
    objects = object_xml(1, mesh_xml(PART)) + object_xml(2, inside, attributes)
    assert size_of(archive(tmp_path / "unused.3mf", model_xml(objects, 'objectid="1"'))) == [30, 20, 10]
    with pytest.raises(MeshRefused, match=reason):
        read_mesh(archive(tmp_path / "used.3mf", model_xml(objects, 'objectid="1"', 'objectid="2"')))


def test_an_unknown_unit_is_refused(tmp_path: Path) -> None:
    model = model_xml(object_xml(1, mesh_xml(PART)), 'objectid="1"', attributes='unit="cubit"')
    with pytest.raises(MeshRefused, match="unknown unit 'cubit', expected micron"):
        read_mesh(archive(tmp_path / "a.3mf", model))
