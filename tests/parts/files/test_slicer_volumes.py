"""Volumes that a slicer keeps beside the part: left out or subtracted, with a note; other shapes refused by name."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from kit1000.errors import MeshRefused
from kit1000.parts.files.sources import read_mesh
from tests.samples.foreign_files import (
    PART,
    archive,
    helper,
    mesh_xml,
    model_xml,
    object_xml,
    readable_bodies,
    slic3r_config,
)

CUBE = helper()
ONE = object_xml(1, mesh_xml(PART, CUBE))
CURA = "http://software.ultimaker.com/xml/cura/3mf/2015/10"


def volume_of(path: Path) -> tuple[float, tuple[str, ...]]:
    reading = read_mesh(path)
    return reading.mesh.volume * 1e9, reading.notes


@pytest.mark.parametrize(
    ("kind", "volume", "note"),
    [
        ("ModelPart", 6000 + 8 * 8 * 4, "united overlapping or touching bodies (2 in the file)"),
        ("NegativeVolume", 6000 - 8 * 8 * 4, "subtracted 1 negative volume"),
        ("ParameterModifier", 6000, "left out 1 modifier"),
        ("SupportEnforcer", 6000, "left out 1 support enforcer"),
        ("SupportBlocker", 6000, "left out 1 support blocker"),
        ("SeamPosition", 6000, "left out 1 seam position"),
    ],
)
def test_a_volume_of_prusaslicer_counts_by_its_type(kind: str, volume: float, note: str, tmp_path: Path) -> None:
    config = slic3r_config((0, 11, "ModelPart"), (12, 23, kind))
    path = archive(tmp_path / "part.3mf", model_xml(ONE, 'objectid="1"'), config)
    assert volume_of(path) == (pytest.approx(volume, rel=1e-6), (note,))


@pytest.mark.parametrize("name", ["SuperSlicer_model.config", "Slic3r_model.config", "slic3r_pe_MODEL.config"])
def test_relatives_of_prusaslicer_describe_volumes_in_files_of_their_own(name: str, tmp_path: Path) -> None:
    (config,) = slic3r_config((0, 11, "ModelPart"), (12, 23, "SupportBlocker")).values()
    path = archive(tmp_path / "part.3mf", model_xml(ONE, 'objectid="1"'), {f"Metadata/{name}": config})
    assert volume_of(path) == (pytest.approx(6000), ("left out 1 support blocker",))


def test_an_old_modifier_is_marked_by_a_flag(tmp_path: Path) -> None:
    flag = '<metadata type="volume" key="modifier" value="1"/>'
    config = f'<config><object id="1"><volume firstid="12" lastid="23">{flag}</volume></object></config>'
    path = archive(tmp_path / "a.3mf", model_xml(ONE, 'objectid="1"'), {"Metadata/Slic3r_PE_model.config": config})
    assert volume_of(path) == (pytest.approx(6000), ("left out 1 modifier",))
    inline = object_xml(
        1,
        mesh_xml(PART, CUBE)
        + '<s:volumes xmlns:s="http://schemas.slic3r.org/3mf/2017/06"><s:volume ts="0" te="11" modifier="0"/>'
        '<s:volume ts="12" te="23" modifier="1"/></s:volumes>',
    )
    path = archive(tmp_path / "b.3mf", model_xml(inline, 'objectid="1"'))
    assert volume_of(path) == (pytest.approx(6000), ("left out 1 modifier",))


def test_several_helpers_are_counted_by_kind(tmp_path: Path) -> None:
    mesh = object_xml(1, mesh_xml(PART, CUBE, CUBE, CUBE))
    kinds = ("ModelPart", "SupportBlocker", "SupportBlocker", "ParameterModifier")
    config = slic3r_config(*((12 * k, 12 * k + 11, kind) for k, kind in enumerate(kinds)))
    path = archive(tmp_path / "part.3mf", model_xml(mesh, 'objectid="1"'), config)
    assert volume_of(path)[1] == ("left out 2 support blockers", "left out 1 modifier")


@pytest.mark.parametrize(
    ("subtype", "kind", "volume", "note"),
    [
        ("normal_part", "model", 6256, "united overlapping or touching bodies (2 in the file)"),
        ("negative_part", "other", 5744, "subtracted 1 negative volume"),  # Bambu Studio writes this type
        ("negative_part", "model", 5744, "subtracted 1 negative volume"),
        ("modifier_part", "other", 6000, "left out 1 modifier"),
        ("support_enforcer", "other", 6000, "left out 1 support enforcer"),
        ("support_blocker", "model", 6000, "left out 1 support blocker"),
    ],
)
def test_a_component_of_bambu_studio_counts_by_its_subtype(
    subtype: str, kind: str, volume: float, note: str, tmp_path: Path
) -> None:
    parts = object_xml(1, mesh_xml(PART)) + object_xml(2, mesh_xml(CUBE), f'type="{kind}"')
    place = (
        'p:path="/3D/Objects/object_1.model" xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06"'
    )
    components = f'<components><component objectid="1" {place}/><component objectid="2" {place}/></components>'
    config = f'<part id="1" subtype="normal_part"/><part id="2" subtype="{subtype}"/>'
    more = {
        "3D/Objects/object_1.model": model_xml(parts),
        "Metadata/model_settings.config": f'<config><object id="2">{config}</object></config>',
    }
    # the assembly has the number of one of its parts, as may be in another model
    path = archive(tmp_path / "part.3mf", model_xml(object_xml(2, components), 'objectid="2"'), more)
    assert volume_of(path) == (pytest.approx(volume, rel=1e-6), (note,))


@pytest.mark.parametrize(
    ("setting", "note"),
    [
        ("infill_mesh", "left out 1 infill mesh"),
        ("cutting_mesh", "left out 1 cutting mesh"),
        ("support_mesh", "left out 1 support mesh"),
        ("anti_overhang_mesh", "left out 1 support blocker"),
    ],
)
def test_helper_meshes_of_cura_are_no_part(setting: str, note: str, tmp_path: Path) -> None:
    new = f'<metadatagroup><metadata name="cura:{setting}" preserve="1">True</metadata></metadatagroup>'
    old = f'<c:settings xmlns:c="{CURA}"><c:setting key="{setting}">True</c:setting></c:settings>'
    prefixed = old.replace("key=", "c:key=")
    off = new.replace("True", "False")
    first = object_xml(1, mesh_xml(PART) + off)
    for name, mark in (("new", new), ("old", old), ("prefixed", prefixed)):
        second = object_xml(2, mark + mesh_xml(CUBE))
        model = model_xml(first + second, 'objectid="1"', 'objectid="2"')
        assert volume_of(archive(tmp_path / f"{name}.3mf", model)) == (pytest.approx(6000), (note,))
        nested = object_xml(3, '<components><component objectid="1"/><component objectid="2"/></components>')
        model = model_xml(first + second + nested, 'objectid="3"')
        assert volume_of(archive(tmp_path / f"{name}-3.3mf", model)) == (pytest.approx(6000), (note,))


@pytest.mark.parametrize(
    ("kind", "note"),
    [
        ("support", "left out 1 support object"),
        ("solidsupport", "left out 1 support object"),
        ("other", "left out 1 helper object"),
        ("surface", "left out 1 surface object"),
    ],
)
def test_objects_of_other_types_are_no_part(kind: str, note: str, tmp_path: Path) -> None:
    objects = object_xml(1, mesh_xml(PART)) + object_xml(2, mesh_xml(CUBE), f'type="{kind}"')
    path = archive(tmp_path / "part.3mf", model_xml(objects, 'objectid="1"', 'objectid="2"'))
    assert volume_of(path) == (pytest.approx(6000), (note,))


def test_a_surface_alone_is_the_part(tmp_path: Path) -> None:
    objects = object_xml(1, mesh_xml(PART), 'type="surface"')
    assert volume_of(archive(tmp_path / "a.3mf", model_xml(objects, 'objectid="1"'))) == (pytest.approx(6000), ())


def test_items_that_are_not_printed_are_no_part(tmp_path: Path) -> None:
    objects = object_xml(1, mesh_xml(PART)) + object_xml(2, mesh_xml(CUBE))
    model = model_xml(objects, 'objectid="1" printable="1"', 'objectid="2" printable="0"')
    expected = (pytest.approx(6000), ("left out 1 item marked as not printable",))
    assert volume_of(archive(tmp_path / "part.3mf", model)) == expected
    with pytest.raises(MeshRefused, match=r"holds nothing to print: left out 2 items marked as not printable$"):
        read_mesh(archive(tmp_path / "none.3mf", model.replace('printable="1"', 'printable="0"')))


def test_a_negative_volume_cuts_the_parts_of_its_own_item_alone(tmp_path: Path) -> None:
    far = 'transform="1 0 0 0 1 0 0 0 1 0 15 0"'
    beside = object_xml(
        2, mesh_xml(trimesh.creation.box((30, 10, 10), trimesh.transformations.translation_matrix((15, 10, 5))))
    )
    config = slic3r_config((0, 11, "ModelPart"), (12, 23, "NegativeVolume"))
    model = model_xml(ONE + beside, 'objectid="1"', f'objectid="2" {far}')
    assert volume_of(archive(tmp_path / "part.3mf", model, config))[0] == pytest.approx(6000 - 256 + 3000, rel=1e-6)


# Volumes by PrusaSlicer 2.5.0, as filament in cm^3 at 100 % infill: 5.75, 5.99, 6.19, 6.28 and 5.88.
@pytest.mark.parametrize(
    ("kinds", "volume", "note"),
    [
        ("PN", 6000 - 256, "subtracted 1 negative volume"),
        ("NP", 6000, "left out 1 negative volume listed before all parts"),
        ("PNP", 6000 - 256 + 512 - 64, "subtracted 1 negative volume"),
        ("NPP", 6000 + 288, "left out 1 negative volume listed before all parts"),
        ("PPN", 6000 + 288 - 256 - 160, "subtracted 1 negative volume"),
    ],
)
def test_a_negative_volume_cuts_the_parts_before_it_alone(kinds: str, volume: float, note: str, tmp_path: Path) -> None:
    shifted = CUBE.copy().apply_translation((3, 0, 0))
    meshes, parts = [], iter((PART, shifted))
    for kind in kinds:
        meshes.append(CUBE if kind == "N" else next(parts))
    names = {"P": "ModelPart", "N": "NegativeVolume"}
    config = slic3r_config(*((12 * k, 12 * k + 11, names[kind]) for k, kind in enumerate(kinds)))
    path = archive(tmp_path / "part.3mf", model_xml(object_xml(1, mesh_xml(*meshes)), 'objectid="1"'), config)
    measured, notes = volume_of(path)
    assert measured == pytest.approx(volume, rel=1e-6)
    assert note in notes


def test_each_instance_of_a_cut_object_is_cut(tmp_path: Path) -> None:
    config = slic3r_config((0, 11, "ModelPart"), (12, 23, "NegativeVolume"))
    items = ['objectid="1"', 'objectid="1" transform="-1 0 0 0 1 0 0 0 1 -10 0 0"']  # mirrored
    bodies = readable_bodies(archive(tmp_path / "part.3mf", model_xml(ONE, *items), config))
    assert [body.mesh.volume * 1e9 for body in bodies] == pytest.approx([5744, 5744], rel=1e-6)


@pytest.mark.parametrize(
    ("volumes", "reason"),
    [
        (
            [(0, 11, "NegativeVolume"), (12, 23, "SupportBlocker")],
            "holds nothing to print: left out 1 support blocker$",
        ),
        ([(0, 11, "Hologram")], "volume of the unknown type 'Hologram'; export it as a plain mesh"),
        ([(0, 99, "ModelPart")], "damaged: a volume of triangles up to 99 of 24"),
    ],
)
def test_volumes_that_make_no_part_are_refused(volumes: list, reason: str, tmp_path: Path) -> None:
    path = archive(tmp_path / "part.3mf", model_xml(ONE, 'objectid="1"'), slic3r_config(*volumes))
    with pytest.raises(MeshRefused, match=reason):
        read_mesh(path)


def test_a_part_that_is_cut_away_whole_is_refused(tmp_path: Path) -> None:
    whole = object_xml(1, mesh_xml(PART, trimesh.creation.box((200, 200, 200))))
    config = slic3r_config((0, 11, "ModelPart"), (12, 23, "NegativeVolume"))
    with pytest.raises(MeshRefused, match="nothing is left of it once its negative volumes are subtracted"):
        read_mesh(archive(tmp_path / "part.3mf", model_xml(whole, 'objectid="1"'), config))
