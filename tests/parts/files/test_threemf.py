"""3MF: the core specification is read; all that a slicer adds is refused by name."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import trimesh

from kit1000.errors import MeshRefused
from kit1000.parts.files.read import read_mesh
from tests.samples.foreign_files import PART, archive, helper, mesh_xml, model_xml, object_xml, slic3r_config

BASE = "http://schemas.microsoft.com/3dmanufacturing"
PRODUCTION = f'xmlns:p="{BASE}/production/2015/06"'
FURTHER = "3D/Objects/my part.model"
PLACE = f'p:path="/3D/Objects/my%20part.model" {PRODUCTION}'
MOVED = 'transform="1 0 0 0 1 0 0 0 1 5 0 0"'
LATTICE = '<b:beamlattice xmlns:b="urn:b"><b:beams><b:beam v1="0" v2="1"/></b:beams></b:beamlattice>'
CURA_NEW = '<metadatagroup><metadata name="cura:{}">{}</metadata></metadatagroup>'
CURA_OLD = '<c:settings xmlns:c="http://software.ultimaker.com"><c:setting {}="{}">True</c:setting></c:settings>'
FLAG = '<config><volume firstid="12" lastid="23"><metadata key="modifier" value="1"/></volume></config>'
INLINE = '<s:volumes xmlns:s="urn:s"><s:volume ts="0" te="11"/><s:volume ts="12" te="23" modifier="1"/></s:volumes>'
INNER = trimesh.creation.box((8, 8, 8), trimesh.transformations.translation_matrix((25, 10, 5)))
ONE = object_xml(1, mesh_xml(PART))
BOTH = object_xml(1, mesh_xml(PART, helper()))
ROOT = model_xml(BOTH, 'objectid="1"')
MODEL = model_xml(ONE, 'objectid="1"')
OTHER = model_xml(object_xml(1, mesh_xml(trimesh.creation.box((5, 5, 5)))), 'objectid="1"')


def parts_xml(number: int, *components: str) -> str:
    inside = "".join(f"<component {attributes}/>" for attributes in components)
    return object_xml(number, f"<components>{inside}</components>")


def bambu(subtype: str) -> dict[str, str]:
    part = f'<part id="2" subtype="{subtype}"/>'
    return {"Metadata/model_settings.config": f'<config><object id="1">{part}</object></config>'}


READ: dict[str, tuple[str, dict[str, str], float]] = {  # (root model, further files, width in mm)
    "volumes of PrusaSlicer that are parts": (
        model_xml(object_xml(1, mesh_xml(PART, INNER)), 'objectid="1"'),
        slic3r_config((0, 11, "ModelPart"), (12, 23, "ModelPart")),
        30,
    ),
    "parts of Bambu Studio": (
        MODEL,
        bambu("normal_part"),
        30,
    ),
    "a helper of Cura that is switched off": (
        model_xml(object_xml(1, mesh_xml(PART) + CURA_NEW.format("cutting_mesh", "False")), 'objectid="1"'),
        {},
        30,
    ),
    "an odd object that is not built": (model_xml(ONE + object_xml(2, "<boolean/>"), 'objectid="1"'), {}, 30),
    "harmless required extensions": (
        model_xml(ONE, 'objectid="1"', attributes=f'{PRODUCTION} xmlns:m="{BASE}/material/" requiredextensions="p m"'),
        {},
        30,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_a_file_is_read_whole(name: str, tmp_path: Path) -> None:
    root, more, width = READ[name]
    reading = read_mesh(archive(tmp_path / "a.3mf", root, more))
    assert (reading.mesh.extents * 1e3).tolist() == pytest.approx([width, 20, 10], rel=1e-6)
    assert (reading.unit, reading.unit_guessed) == ("mm", False)


@pytest.mark.parametrize(
    ("target", "name"),
    [
        ("/3D/part.model", "3D/part.model"),
        ("3D/part.model", "3D/part.model"),
        ("/Model.model", "Model.model"),
        ("/3D/my%20part.model", "3D/my part.model"),
        ("/3d/P.model", "3D/p.MODEL"),
    ],
)
def test_the_root_is_the_model_that_the_relationships_name(target: str, name: str, tmp_path: Path) -> None:
    path = archive(tmp_path / "a.3mf", OTHER, root="x")
    with zipfile.ZipFile(path) as file:
        relationships = file.read("_rels/.rels").decode().replace("/x", target)
    with zipfile.ZipFile(path, "w") as file:
        for place, text in {"_rels/.rels": relationships, "3D/3dmodel.model": OTHER, name: MODEL}.items():
            file.writestr(place, text)
    assert (read_mesh(path).mesh.extents * 1e3).tolist() == pytest.approx([30, 20, 10])


def test_transforms_are_applied_innermost_first_and_mirrored_meshes_are_turned(tmp_path: Path) -> None:
    turned = 'transform="0 1 0 -1 0 0 0 0 1 100 0 0"'
    model = model_xml(ONE + parts_xml(2, f'objectid="1" {MOVED}'), f'objectid="2" {turned}')
    bounds = read_mesh(archive(tmp_path / "a.3mf", model)).mesh.bounds * 1e3
    assert bounds == pytest.approx(np.array([[80, 5, 0], [100, 35, 10]]), abs=1e-4)
    mirrored = model_xml(ONE, 'objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"')
    reading = read_mesh(archive(tmp_path / "b.3mf", mirrored))
    assert (reading.mesh.volume * 1e9, reading.notes) == (pytest.approx(6000), ())


def slic3r(kind: str) -> dict[str, str]:
    return slic3r_config((0, 11, "ModelPart"), (12, 23, kind))


def requiring(address: str) -> str:
    return model_xml(ONE, 'objectid="1"', attributes=f'xmlns:x="{address}" requiredextensions="x"')


def with_second(inside: str, attributes: str = 'type="model"') -> str:
    return model_xml(ONE + object_xml(2, inside, attributes), 'objectid="1"', 'objectid="2"')


def cura(mark: str) -> str:
    return with_second(mark + mesh_xml(helper()))


BOMB = "".join(parts_xml(i + 1, *[f'objectid="{i}"'] * 10) for i in range(1, 12))
ALONE = "export the part alone"
REFUSED: list[tuple[str, Mapping[str, str], tuple[str, ...]]] = [  # (root model, further files, facts)
    *((ROOT, slic3r(kind), (kind, ALONE)) for kind in ("NegativeVolume", "ParameterModifier", "SupportBlocker", "New")),
    *((ROOT, bambu(kind), (kind, ALONE)) for kind in ("negative_part", "modifier_part", "support_enforcer")),
    *((ROOT, {f"Metadata/{name}": slic3r("SeamPosition")["Metadata/Slic3r_PE_model.config"]}, ("SeamPosition",))
      for name in ("SuperSlicer_model.config", "slic3r_pe_MODEL.config")),
    (ROOT, {"Metadata/Slic3r_PE_model.config": FLAG}, ("modifier", ALONE)),
    (model_xml(object_xml(1, mesh_xml(PART, helper()) + INLINE), 'objectid="1"'), {}, ("modifier", ALONE)),
    *((cura(CURA_NEW.format(key, "True")), {}, (key, ALONE))
      for key in ("infill_mesh", "cutting_mesh", "support_mesh", "anti_overhang_mesh")),
    (cura(CURA_OLD.format("key", "support_mesh")), {}, ("support_mesh", ALONE)),
    (cura(CURA_OLD.format("c:key", "cutting_mesh")), {}, ("cutting_mesh", ALONE)),
    *((with_second(mesh_xml(helper()), f'type="{kind}"'), {}, ("object 2", kind, ALONE))
      for kind in ("support", "solidsupport", "other", "surface", "novel")),
    (model_xml(ONE, 'objectid="1" printable="0"'), {}, ('printable="0"', ALONE)),
    *((requiring(address), {}, (address, ALONE)) for address in (
        "http://schemas.3mf.io/3dmanufacturing/booleanoperations/2023/07",
        f"{BASE}/securecontent/2019/07",
        f"{BASE}/production/alternatives/2021/04",
        "http://example.org/unheard-of",
    )),
    (model_xml(ONE, 'objectid="1"', attributes='requiredextensions="zz"'), {}, ("zz (not declared)",)),
    (model_xml("", f'objectid="1" {PLACE}'), {FURTHER: MODEL}, ("further model files", "my%20part.model", ALONE)),
    (model_xml(parts_xml(1, f'objectid="1" {PLACE}'), 'objectid="1"'), {FURTHER: MODEL}, ("further model files",)),
    (with_second('<b:booleanshape xmlns:b="urn:b"/>'), {}, ("object 2", "booleanshape", ALONE)),
    (with_second('<d:displacementmesh xmlns:d="urn:d"/>'), {}, ("object 2", "displacementmesh")),
    (with_second(mesh_xml(PART).replace("</mesh>", f"{LATTICE}</mesh>")), {}, ("object 2", "beamlattice", ALONE)),
    (with_second(mesh_xml(PART), 'xmlns:s="urn:s" s:meshresolution="lowres"'), {}, ("object 2", "lowres")),
    (with_second(mesh_xml(PART), 'xmlns:a="urn:a" a:modelresolution="obfuscated"'), {}, ("object 2", "obfuscated")),
    (model_xml(ONE), {}, ("its build is empty", "save it with the part on the plate")),
    (model_xml(ONE, 'objectid="7"'), {}, ("no object 7",)),
    (model_xml(parts_xml(1, 'objectid="1"'), 'objectid="1"'), {}, ("nested more than 32",)),
    (model_xml(ONE + BOMB, 'objectid="12"'), {}, ("more than 5,000,000 triangles",)),
    (model_xml(ONE, 'objectid="1" transform="1 0"'), {}, ("not readable as 3MF",)),
    (model_xml(ONE.replace('v1="0"', 'v1="9"'), 'objectid="1"'), {}, ("vertex 9 of 8",)),
    (model_xml(ONE, 'objectid="1"', attributes='unit="cubit"'), {}, ("unknown unit", "cubit")),
    ("<model><resources>", {}, ("not readable as 3MF",)),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(REFUSED)))
def test_what_is_not_read_is_refused_by_name(number: int, tmp_path: Path) -> None:
    root, more, facts = REFUSED[number]
    with pytest.raises(MeshRefused) as caught:
        read_mesh(archive(tmp_path / "part.3mf", root, more))
    assert all(fact in caught.value.reason for fact in facts), caught.value.reason
    assert "\n" not in caught.value.reason


def test_an_archive_without_a_model_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "part.3mf", "w") as file:
        file.writestr("readme.txt", "nothing")
    with pytest.raises(MeshRefused, match="no model file in the archive"):
        read_mesh(tmp_path / "part.3mf")
