"""Reading 3MF files: parts in further model files, transforms of components, and what cannot be built."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from kit1000.errors import MeshRefused
from kit1000.parts.files.sources import read_mesh

NAMES = (
    'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
    'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06" '
    'xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"'
)
LATTICE = '<b:beamlattice minlength="1" radius="1"><b:beams><b:beam v1="0" v2="1"/></b:beams></b:beamlattice>'
ROOT, FURTHER = "3D/3dmodel.model", "3D/Objects/box.model"


def box_xml(object_id: int, side: float = 10, triangles: bool = True, inside: str = "") -> str:
    box = trimesh.creation.box((side, 20, 10))
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in box.vertices)
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in box.faces) if triangles else ""
    mesh = f"<mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles>{inside}</mesh>"
    return f'<object id="{object_id}" type="model">{mesh}</object>'


def parts_xml(object_id: int, *components: str) -> str:
    inside = "".join(f"<component {attributes}/>" for attributes in components)
    return f'<object id="{object_id}"><components>{inside}</components></object>'


def model_xml(objects: str, *items: str, unit: str = "millimeter") -> str:
    build = "".join(f"<item {attributes}/>" for attributes in items)
    return f'<model unit="{unit}" {NAMES}><resources>{objects}</resources><build>{build}</build></model>'


def threemf(folder: Path, **models: str) -> Path:
    path = folder / "part.3mf"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in models.items():
            archive.writestr({"root": ROOT, "further": FURTHER}.get(name, name), text)
    return path


PLACE = f'p:path="/{FURTHER}"'
MOVED = 'transform="1 0 0 0 1 0 0 0 1 5 0 0"'


@pytest.mark.parametrize(
    ("root", "further", "volume", "width"),
    [
        (model_xml("", f'objectid="1" {PLACE}'), model_xml(box_xml(1)), 2e-6, 0.010),
        (model_xml("", f'objectid="2" {PLACE}'), model_xml(box_xml(1) + box_xml(2, 30)), 6e-6, 0.030),
        (model_xml(parts_xml(1, f'objectid="2" {PLACE}'), 'objectid="1"'), model_xml(box_xml(2)), 2e-6, 0.010),
        (
            model_xml(parts_xml(1, f'objectid="1" {PLACE}', f'objectid="2" {PLACE} {MOVED}'), 'objectid="1"'),
            model_xml(box_xml(1) + box_xml(2)),
            3e-6,
            0.015,
        ),
        (model_xml("", f'objectid="1" {PLACE}', unit="inch"), model_xml(box_xml(1)), 2e-6, 0.010),
        (model_xml(box_xml(1), 'objectid="1"', f'objectid="1" {PLACE} {MOVED}'), model_xml(box_xml(1)), 3e-6, 0.015),
    ],
)
def test_a_3mf_may_keep_its_parts_in_further_model_files(
    root: str, further: str, volume: float, width: float, tmp_path: Path
) -> None:
    mesh = read_mesh(threemf(tmp_path, root=root, further=further)).mesh
    assert mesh.volume == pytest.approx(volume, rel=1e-6)
    assert mesh.extents[0] == pytest.approx(width, rel=1e-6)


def test_transforms_of_a_3mf_are_applied_innermost_first(tmp_path: Path) -> None:
    turned = 'transform="0 1 0 -1 0 0 0 0 1 100 0 0"'
    objects = box_xml(1) + parts_xml(2, f'objectid="1" {MOVED}')
    mesh = read_mesh(threemf(tmp_path, root=model_xml(objects, f'objectid="2" {turned}'))).mesh
    assert mesh.bounds == pytest.approx(np.array([[0.09, 0, -0.005], [0.11, 0.01, 0.005]]), abs=1e-8)


BOMB = "".join(parts_xml(i + 1, *[f'objectid="{i}"'] * 10) for i in range(1, 12))


@pytest.mark.parametrize(
    ("root", "reason"),
    [
        (
            model_xml(box_xml(1, triangles=False, inside=LATTICE), 'objectid="1"'),
            "holds a beam lattice, .* export it as",
        ),
        (model_xml(box_xml(1)), "its build is empty: .*save it with the part on the plate$"),
        (model_xml(box_xml(1), 'objectid="7"'), "not readable as 3MF: no object 7 in 3d/3dmodel.model$"),
        (model_xml("", f'objectid="1" {PLACE}'), "not readable as 3MF: .*3d/objects/box.model"),
        (
            model_xml(parts_xml(1, 'objectid="1"'), 'objectid="1"'),
            "not readable as 3MF: components nested more than 32",
        ),
        (model_xml(box_xml(1) + BOMB, 'objectid="12"'), "1,200,000,000,000 triangles, more than 5,000,000$"),
        (model_xml(box_xml(1), 'objectid="1" transform="1 0"'), "not readable as 3MF: "),
        (model_xml(box_xml(1).replace('v1="0"', 'v1="9"'), 'objectid="1"'), "damaged: faces name vertex 9 of 8$"),
        ("<model><resources>", "not readable as 3MF: "),
    ],
)
def test_a_3mf_that_cannot_be_built_is_refused(root: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(MeshRefused, match=reason) as caught:
        read_mesh(threemf(tmp_path, root=root))
    assert "\n" not in caught.value.reason


def test_a_3mf_without_a_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshRefused, match="not readable as 3MF: no model file in the archive"):
        read_mesh(threemf(tmp_path, readme="nothing"))


def test_a_lattice_beside_triangles_is_noted(tmp_path: Path) -> None:
    reading = read_mesh(threemf(tmp_path, root=model_xml(box_xml(1, inside=LATTICE), 'objectid="1"')))
    assert reading.notes == ("ignored a beam lattice, which has no triangles",)
