"""glTF of other exporters: quantized, sparse, interleaved, instanced; what is not read is refused by its name."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from kit1000.errors import MeshRefused
from kit1000.parts.files import formats
from kit1000.parts.files.sources import read_mesh
from tests.samples.foreign_files import Gltf, readable_bodies

BOX = trimesh.creation.box((0.04, 0.02, 0.01))
SIZE = (40, 10, 20)  # [mm] y up becomes z up


def made(**more: Any) -> Gltf:
    gltf = Gltf()
    gltf.mesh(BOX, **more)
    return gltf


def size_of(path: Path) -> list[float]:
    return (read_mesh(path).mesh.extents * 1e3).tolist()


@pytest.mark.parametrize(
    ("component", "dtype", "largest", "normalized"),
    [
        (5120, "<i1", 127, True),
        (5122, "<i2", 32767, True),
        (5120, "<i1", 1, False),
        (5122, "<i2", 1, False),
        (5121, "<u1", 255, True),
        (5123, "<u2", 65535, True),
    ],
)
def test_quantized_positions_have_the_size_that_they_state(
    component: int, dtype: str, largest: int, normalized: bool, tmp_path: Path
) -> None:
    steps = (BOX.vertices / BOX.extents + 0.5) * (largest if normalized else 100)
    values = np.zeros((len(steps), 4), dtype)  # padded to whole words
    values[:, :3] = np.round(steps)
    gltf = made()
    view = gltf.view(values.tobytes(), byteStride=values.strides[0])
    gltf.json["accessors"][0] |= {"bufferView": view, "componentType": component, "normalized": normalized}
    gltf.json["nodes"][0]["scale"] = (BOX.extents / (1 if normalized else 100)).tolist()
    gltf.json |= {"extensionsRequired": ["KHR_mesh_quantization"], "extensionsUsed": ["KHR_mesh_quantization"]}
    assert size_of(gltf.glb(tmp_path / "a.glb")) == pytest.approx(SIZE, abs=1e-3)


@pytest.mark.parametrize("with_base", [True, False])
def test_sparse_positions_replace_those_of_their_base(with_base: bool, tmp_path: Path) -> None:
    gltf = made()
    high = np.flatnonzero(BOX.vertices[:, 1] > 0) if with_base else np.arange(8)
    if with_base:
        half = np.array(BOX.vertices, dtype="<f4")
        half[high, 1] = 0
        gltf.json["accessors"][0]["bufferView"] = gltf.view(half.tobytes())
    else:
        del gltf.json["accessors"][0]["bufferView"]
    gltf.json["accessors"][0]["sparse"] = {
        "count": len(high),
        "indices": {"bufferView": gltf.view(high.astype("<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": gltf.view(BOX.vertices[high].astype("<f4").tobytes())},
    }
    assert size_of(gltf.glb(tmp_path / "a.glb")) == pytest.approx(SIZE, abs=1e-4)


def test_positions_may_lie_between_other_attributes(tmp_path: Path) -> None:
    gltf = made()
    rows = np.zeros((8, 8), dtype="<f4")
    rows[:, 3:6] = BOX.vertices
    view = gltf.view(rows.tobytes(), byteStride=32)
    gltf.json["accessors"][0] |= {"bufferView": view, "byteOffset": 12}
    assert size_of(gltf.glb(tmp_path / "a.glb")) == pytest.approx(SIZE, abs=1e-4)


@pytest.mark.parametrize("mode", [5, 6])
def test_strips_and_fans_are_triangles(mode: int, tmp_path: Path) -> None:
    gltf = made()
    faces = [
        (1, 0, 3, 2),
        (4, 5, 6, 7),
        (0, 1, 4, 5),
        (2, 6, 3, 7),
        (0, 4, 2, 6),
        (1, 3, 5, 7),
    ]  # fmt: skip (the six sides of a box as strips)
    corners = np.array([[x, y, z] for x in (0, 0.04) for y in (0, 0.02) for z in (0, 0.01)], dtype="<f4")
    position = gltf.accessor(corners, 5126)
    primitives = []
    for a, b, c, d in faces:
        order = np.array([a, b, c, d] if mode == 5 else [a, b, d, c], dtype="<u2").reshape(-1, 1)
        indices = gltf.accessor(order, 5123)
        primitives.append({"attributes": {"POSITION": position}, "indices": indices, "mode": mode})
    gltf.json["meshes"] = [{"primitives": primitives}]
    reading = read_mesh(gltf.glb(tmp_path / "a.glb"))
    assert reading.mesh.volume * 1e9 == pytest.approx(8000, rel=1e-6)


def test_nodes_are_placed_by_matrix_or_by_translation_rotation_and_scale(tmp_path: Path) -> None:
    gltf = made()
    half = np.sqrt(0.5)
    gltf.json["nodes"] = [
        {"children": [1], "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 0, 0, 1]},
        {"mesh": 0, "rotation": [0, half, 0, half], "translation": [0.1, 0, 0], "scale": [1, 3, 1]},
    ]
    bounds = read_mesh(gltf.glb(tmp_path / "a.glb")).mesh.bounds * 1e3
    assert np.allclose(bounds, [[1190, -40, -60], [1210, 40, 60]], atol=1e-2)


def test_a_file_without_a_scene_has_all_its_roots(tmp_path: Path) -> None:
    gltf = made()
    for name in ("scene", "scenes"):
        del gltf.json[name]
    assert size_of(gltf.glb(tmp_path / "a.glb")) == pytest.approx(SIZE, abs=1e-4)


def test_only_the_default_scene_is_read(tmp_path: Path) -> None:
    gltf = made()
    gltf.json |= {"scenes": [{"nodes": [1]}, {"nodes": [0]}], "scene": 1}
    gltf.json["nodes"].append({"mesh": 0, "scale": [5, 5, 5]})
    assert size_of(gltf.glb(tmp_path / "a.glb")) == pytest.approx(SIZE, abs=1e-4)


def test_instances_are_bodies(tmp_path: Path) -> None:
    gltf = made()
    places = gltf.accessor(np.array([[0, 0, 0], [0.1, 0, 0]], dtype="<f4"), 5126)
    sizes = gltf.accessor(np.array([[1, 1, 1], [-2, 2, 2]], dtype="<f4"), 5126)
    extension = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places, "SCALE": sizes}}}
    gltf.json["nodes"][0]["extensions"] = extension
    gltf.json["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    bodies = readable_bodies(gltf.glb(tmp_path / "a.glb"))
    assert [body.mesh.volume * 1e9 for body in bodies] == pytest.approx([64000, 8000], rel=1e-5)
    assert not any("inside out" in note for body in bodies for note in body.notes)


def test_morph_targets_are_applied_with_their_weights(tmp_path: Path) -> None:
    gltf = made()
    taller = np.where(BOX.vertices > 0, BOX.vertices * [0, 2, 0], 0)
    target = gltf.accessor(taller.astype("<f4"), 5126)
    gltf.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": target}]
    gltf.json["meshes"][0]["weights"] = [0.5]
    assert size_of(gltf.glb(tmp_path / "a.glb")) == pytest.approx((40, 10, 30), abs=1e-4)
    gltf.json["nodes"][0]["weights"] = [0]
    assert size_of(gltf.glb(tmp_path / "b.glb")) == pytest.approx(SIZE, abs=1e-4)


def test_an_invisible_node_is_left_out(tmp_path: Path) -> None:
    gltf = made()
    hidden = {"KHR_node_visibility": {"visible": False}}
    gltf.json["nodes"].append({"mesh": 0, "translation": [0.02, 0, 0], "extensions": hidden})
    gltf.json["scenes"][0]["nodes"].append(1)
    reading = read_mesh(gltf.glb(tmp_path / "a.glb"))
    assert reading.mesh.volume * 1e9 == pytest.approx(8000, rel=1e-5)
    assert reading.notes == ("left out 1 invisible node",)


@pytest.mark.parametrize(
    "name", ["KHR_materials_unlit", "KHR_texture_transform", "EXT_texture_webp", "KHR_lights_punctual"]
)
def test_extensions_without_a_shape_may_be_required(name: str, tmp_path: Path) -> None:
    gltf = made()
    gltf.json["extensionsRequired"] = [name]
    assert size_of(gltf.glb(tmp_path / "a.glb")) == pytest.approx(SIZE, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("KHR_draco_mesh_compression", "stored with Draco compression .KHR_draco_.*export it without$"),
        ("EXT_meshopt_compression", "stored with meshopt compression .EXT_meshopt_.*export it without$"),
        ("KHR_meshopt_compression", "stored with meshopt compression"),
        ("ACME_surfaces", "requires the glTF extension ACME_surfaces, which is not supported: export it without$"),
    ],
)
def test_another_required_extension_is_refused_by_name(name: str, reason: str, tmp_path: Path) -> None:
    gltf = made()
    gltf.json["extensionsRequired"] = ["KHR_mesh_quantization", name]
    with pytest.raises(MeshRefused, match=reason):
        read_mesh(gltf.glb(tmp_path / "a.glb"))


def test_compressed_data_are_refused_also_where_nothing_is_required(tmp_path: Path) -> None:
    gltf = made(extensions={"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}})
    assert size_of(gltf.glb(tmp_path / "both.glb")) == pytest.approx(SIZE, abs=1e-4)
    for accessor in gltf.json["accessors"]:
        del accessor["bufferView"]
    with pytest.raises(MeshRefused, match="Draco compression"):
        read_mesh(gltf.glb(tmp_path / "draco.glb"))
    gltf = made()
    gltf.json["bufferViews"][0] |= {"buffer": 1, "extensions": {"EXT_meshopt_compression": {"buffer": 0}}}
    path = gltf.glb(tmp_path / "meshopt.glb")
    gltf.json["extensionsUsed"] = ["EXT_meshopt_compression"]
    data = path.read_bytes()
    assert b'"buffers"' in data
    with pytest.raises(MeshRefused, match=r"names buffers\[1\], which does not exist"):
        read_mesh(path)


def test_a_skin_and_another_version_are_refused_by_name(tmp_path: Path) -> None:
    gltf = made()
    gltf.json["nodes"][0]["skin"] = 0
    with pytest.raises(MeshRefused, match="bent by a skeleton"):
        read_mesh(gltf.glb(tmp_path / "a.glb"))
    gltf = made()
    gltf.json["asset"]["version"] = "1.0"
    with pytest.raises(MeshRefused, match=r"glTF of version 1.0, expected 2.0"):
        read_mesh(gltf.glb(tmp_path / "b.glb"))


@pytest.mark.parametrize(
    ("address", "file"),
    [
        ("a%20part.bin", "a part.bin"),
        ("a part.bin", "a part.bin"),
        ("100%25.bin", "100%.bin"),
        ("a%20b.bin", "a%20b.bin"),  # written as it is, against the standard
        ("Geh%C3%A4use.bin", "Gehäuse.bin"),
        ("data/x.bin", "data/x.bin"),
        ("data%5Cx.bin", "data/x.bin"),  # of an exporter on Windows
        ("data\\x.bin", "data/x.bin"),
        ("a%20part.bin?version=2", "a part.bin"),
    ],
)
def test_a_further_file_is_found_by_its_encoded_name(address: str, file: str, tmp_path: Path) -> None:
    assert size_of(made().gltf(tmp_path / "a.gltf", address, file)) == pytest.approx(SIZE, abs=1e-4)


def test_data_may_be_in_the_address_itself(tmp_path: Path) -> None:
    gltf = made()
    text = base64.b64encode(gltf.blob).decode()
    text = "\n".join([text[:40], text[40:]])  # in lines, as some encoders write
    for number, kind in enumerate(("application/octet-stream", "application/gltf-buffer")):
        path = gltf.gltf(tmp_path / f"{number}.gltf", f"data:{kind};base64,{text}", None)
        assert size_of(path) == pytest.approx(SIZE, abs=1e-4)


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("part%20a.bin", "its data are in part a.bin, which is missing: put that file beside it$"),
        ("https://example.org/a.bin", "its data lie at https://example.org/a.bin: download"),
        ("data:application/octet-stream;base64,???", "the base64 of buffer 0 is damaged"),
    ],
)
def test_data_that_are_missing_are_named(address: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(MeshRefused, match=reason):
        read_mesh(made().gltf(tmp_path / "a.gltf", address, None))


def test_a_further_file_that_is_cut_short_or_a_pointer_is_named(tmp_path: Path) -> None:
    path = made().gltf(tmp_path / "a.gltf", "a.bin", "a.bin")
    (tmp_path / "a.bin").write_bytes(b"\0" * 20)
    with pytest.raises(MeshRefused, match="cut short: buffer 0 has 20 of 168 bytes"):
        read_mesh(path)
    (tmp_path / "a.bin").write_bytes(b"version https://git-lfs.github.com/spec/v1\n")
    with pytest.raises(MeshRefused, match=r"its data in a\.bin are a Git LFS pointer"):
        read_mesh(path)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda json: json["nodes"][0].update(children=[0]), "nodes nested more than 64 deep"),
        (lambda json: json["accessors"][0].update(count=9000), "values beyond the end of their buffer"),
        (lambda json: json["accessors"][1].update(componentType=5126), "accessor 1 has indices that are no integers"),
        (lambda json: json["nodes"][0].update(mesh=7), r"names meshes\[7\], which does not exist"),
        (lambda json: json["scenes"][0].update(nodes=[0] * 5000), "more than 50,000 triangles"),
    ],
)
def test_a_damaged_file_is_refused(change: Any, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(formats, "MAX_FACES", 50_000)
    gltf = made()
    change(gltf.json)
    with pytest.raises(MeshRefused, match=reason):
        read_mesh(gltf.glb(tmp_path / "a.glb"))
