"""Inputs that were refused or misread once: each is read as its README says, where the folder of them exists."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from kit1000.errors import MeshRefused
from kit1000.parts.files.sources import mesh_files, read_mesh
from tests.samples.foreign_files import cases

FOLDER = cases()
NOTED = {
    "negative-volume-slic3r.3mf": "subtracted 1 negative volume",
    "modifier-slic3r.3mf": "left out 1 modifier",
    "support-blocker-bambu.3mf": "left out 1 support blocker",
    "support-object-touching.3mf": "left out 1 support object",
    "cutting-mesh-cura.3mf": "left out 1 cutting mesh",
    "support-mesh-cura.3mf": "left out 1 support mesh",
}
CLEAN = ("root-by-relationship.3mf", "quantized-bytes.glb", "sparse-positions.glb", "escaped-name.gltf", "polygons.off")
CLEAN += ("lower-case.stl", "upper-case.stl", "carriage-returns.stl", "byte-order-mark.stl")
REFUSED = {"boolean-shape.3mf": "booleanoperations", "draco.glb": "Draco compression .*export it without"}


def case(name: str) -> Path:
    if FOLDER is None:
        pytest.skip("the folder of cases is absent")
    return FOLDER / name


@pytest.mark.parametrize("name", [*NOTED, *CLEAN])
def test_a_case_is_the_part_that_was_meant(name: str) -> None:
    reading = read_mesh(case(name))
    size, volume = ((30, 24, 14), 7267) if "negative" in name else ((42, 24, 14), 9283)
    tolerance = 0.2 if "quantized" in name else 1e-3
    assert reading.mesh.extents * 1e3 == pytest.approx(size, abs=tolerance)
    assert reading.mesh.volume * 1e9 == pytest.approx(volume, rel=0.01 if "quantized" in name else 1e-5)
    assert reading.notes == ((NOTED[name],) if name in NOTED else ())


@pytest.mark.parametrize("name", REFUSED)
def test_a_case_that_cannot_be_read_is_refused_by_name(name: str) -> None:
    with pytest.raises(MeshRefused, match=REFUSED[name]) as caught:
        read_mesh(case(name))
    assert "\n" not in caught.value.reason


def test_the_list_of_the_cases_names_files_that_exist(tmp_path: Path) -> None:
    for name in ("list-byte-order-mark.txt", "lower-case.stl", "upper-case.stl"):
        shutil.copy(case(name), tmp_path)
    found = mesh_files(tmp_path / "list-byte-order-mark.txt")
    assert found == [tmp_path / "lower-case.stl", tmp_path / "upper-case.stl"]
    assert all(file.is_file() for file in found)
