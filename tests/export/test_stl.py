"""Tests of STL export: other readers find assemblies and parts, in millimetres, on z = 0."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from kit1000.dataset.geometry import Geometry
from kit1000.errors import InputError
from kit1000.export import FORMATS, export, standing_mesh
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.parts.files.read import read_mesh
from tests.samples.labelled_scenes import shapes_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset folder of an assembly of two kits; it is exported to the folder `stl` beside it."""
    folder = tmp_path_factory.mktemp("export") / "data"
    shapes_folder(folder)
    assert export(folder, "stl", folder.parent / "stl") == folder.parent / "stl"
    return folder


@pytest.fixture(scope="module")
def geometry(folder: Path) -> Geometry:
    return Geometry(folder)


def meshes(geometry: Geometry) -> dict[str, Mesh]:
    """What is exported, by the name of the file without its ending."""
    parts = {f"part-{i}": standing_mesh(geometry.part(i), geometry.kit(i)) for i in geometry.parts}
    return parts | {i: geometry.assembly(i).mesh for i in geometry.assemblies}


def test_files_read_back_are_the_assemblies_and_parts_in_millimetres(geometry: Geometry) -> None:
    expected = meshes(geometry)
    paths = {path.stem: path for path in (geometry.root.parent / "stl").iterdir()}
    assert paths.keys() == expected.keys()
    for name, mesh in expected.items():
        seen = trimesh.load_scene(paths[name]).to_mesh()
        assert seen.is_watertight
        assert seen.volume == pytest.approx(mesh.volume * 1e9, rel=1e-6)
        np.testing.assert_allclose(seen.bounds, mesh.bounds * 1e3, atol=1e-4)
        assert seen.bounds[0, 2] == pytest.approx(0, abs=1e-4)  # it stands, z up
        reading = read_mesh(paths[name], "mm")
        assert (reading.unit, reading.unit_guessed) == ("mm", False)
        np.testing.assert_allclose(reading.mesh.extents, mesh.extents, atol=1e-7)


def test_parts_seat_in_the_assembly_read_back(geometry: Geometry) -> None:
    (assembly_id,) = geometry.assemblies
    assembly = geometry.assembly(assembly_id)
    seen = trimesh.load_scene(geometry.root.parent / "stl" / f"{assembly_id}.stl").to_mesh()
    solid = solid_from_mesh(Mesh(seen.vertices, seen.faces))
    for mount in assembly.mounts:
        up = mount.assembly_from_kit.rotate([0.0, 0.0, 1.0])
        seated = mount.assembly_from_kit @ mount.kit.slot.kit_from_part
        part = solid_from_mesh(geometry.part(mount.kit.id).mesh.moved(seated).scaled(1e3))
        assert part.translate(tuple(up)).min_gap(solid, 5) == pytest.approx(1, abs=0.01)  # a millimetre off its floor


@pytest.mark.parametrize("format", ["urdf", "stl"])
def test_the_given_ids_or_those_of_a_split_are_exported(format: str, folder: Path, tmp_path: Path) -> None:
    (assembly_id,) = Geometry(folder).assemblies
    name = assembly_id if format == "urdf" else f"{assembly_id}.stl"
    for options in ({"ids": (assembly_id,)}, {"split": "test"}):
        out = export(folder, format, tmp_path / "_".join(options), **options)  # type: ignore[arg-type]
        assert name in {path.name for path in out.iterdir()}


def test_an_unknown_format_or_split_is_one_line(folder: Path, tmp_path: Path) -> None:
    for format, split, fact in (("step", None, ", ".join(FORMATS)), ("stl", "val", "val")):
        with pytest.raises(InputError, match=fact):
            export(folder, format, tmp_path, split=split)
