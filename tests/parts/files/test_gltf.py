"""glTF of other exporters: read exactly, or refused by the name of what is not read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from kit1000.errors import MeshRefused
from kit1000.parts.files import read
from kit1000.parts.files.read import read_mesh
from tests.samples.foreign_files import Gltf

BOX = trimesh.creation.box((0.04, 0.02, 0.01))
SIZE = (40, 10, 20)  # [mm] y up becomes z up
DRACO = "KHR_draco_mesh_compression"


def made(**more: Any) -> Gltf:
    gltf = Gltf()
    gltf.mesh(BOX, **more)
    return gltf


def interleaved(gltf: Gltf) -> None:
    rows = np.zeros((8, 8), dtype="<f4")
    rows[:, 3:6] = BOX.vertices
    gltf.json["accessors"][0] |= {"bufferView": gltf.view(rows.tobytes(), byteStride=32), "byteOffset": 12}


def in_the_second_scene(gltf: Gltf) -> None:
    gltf.json |= {"scenes": [{"nodes": [1]}, {"nodes": [0]}], "scene": 1}
    gltf.json["nodes"].append({"mesh": 0, "scale": [5, 5, 5]})


def mirrored(gltf: Gltf) -> None:
    gltf.json["nodes"][0]["scale"] = [-1, 1, 1]


def with_targets(gltf: Gltf) -> None:
    gltf.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": gltf.accessor(np.ones((8, 3), "<f4"), 5126)}]
    gltf.json["meshes"][0]["weights"] = [0]


def requiring(*names: str) -> Callable[[Gltf], None]:
    return lambda gltf: gltf.json.update(extensionsRequired=list(names))


READ: dict[str, Callable[[Gltf], Any]] = {
    "positions between other attributes": interleaved,
    "the default scene alone": in_the_second_scene,
    "a mirrored node": mirrored,
    "morph targets of no weight": with_targets,
    "a required material": requiring("KHR_materials_unlit"),
    "a required texture": requiring("KHR_texture_transform", "EXT_texture_webp"),
    "required quantization of other attributes": requiring("KHR_mesh_quantization"),
}


@pytest.mark.parametrize("name", READ)
def test_a_file_is_read_whole(name: str, tmp_path: Path) -> None:
    gltf = made()
    READ[name](gltf)
    reading = read_mesh(gltf.glb(tmp_path / "a.glb"))
    assert (reading.mesh.extents * 1e3).tolist() == pytest.approx(SIZE, abs=1e-4)
    assert reading.mesh.volume * 1e9 == pytest.approx(8000, rel=1e-5)
    assert reading.notes == ()


def test_strips_are_triangles(tmp_path: Path) -> None:
    gltf = made()
    faces = [(1, 0, 3, 2), (4, 5, 6, 7), (0, 1, 4, 5), (2, 6, 3, 7), (0, 4, 2, 6), (1, 3, 5, 7)]
    corners = np.array([[x, y, z] for x in (0, 0.04) for y in (0, 0.02) for z in (0, 0.01)], dtype="<f4")
    position = gltf.accessor(corners, 5126)
    primitives = []
    for face in faces:
        indices = gltf.accessor(np.array(face, dtype="<u2").reshape(-1, 1), 5123)
        primitives.append({"attributes": {"POSITION": position}, "indices": indices, "mode": 5})
    gltf.json["meshes"] = [{"primitives": primitives}]
    assert read_mesh(gltf.glb(tmp_path / "a.glb")).mesh.volume * 1e9 == pytest.approx(8000, rel=1e-6)


def test_nodes_are_placed_by_matrix_or_by_translation_rotation_and_scale(tmp_path: Path) -> None:
    gltf = made()
    half = np.sqrt(0.5)
    gltf.json["nodes"] = [
        {"children": [1], "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 0, 0, 1]},
        {"mesh": 0, "rotation": [0, half, 0, half], "translation": [0.1, 0, 0], "scale": [1, 3, 1]},
    ]
    bounds = read_mesh(gltf.glb(tmp_path / "a.glb")).mesh.bounds * 1e3
    assert np.allclose(bounds, [[1190, -40, -60], [1210, 40, 60]], atol=1e-2)


def sparse(gltf: Gltf) -> None:
    gltf.json["accessors"][0]["sparse"] = {"count": 1, "indices": {"bufferView": 0}, "values": {"bufferView": 0}}


def quantized(normalized: bool) -> Callable[[Gltf], None]:
    def change(gltf: Gltf) -> None:
        view = gltf.view(np.zeros((8, 4), "<i1").tobytes(), byteStride=4)
        gltf.json["accessors"][0] |= {"bufferView": view, "componentType": 5120, "normalized": normalized}

    return change


def node(**more: Any) -> Callable[[Gltf], None]:
    return lambda gltf: gltf.json["nodes"][0].update(more)


def below_a_camera(gltf: Gltf) -> None:
    gltf.json["nodes"] = [{"camera": 0, "children": [1]}, {"mesh": 0}]
    gltf.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]


def morphed(gltf: Gltf) -> None:
    with_targets(gltf)
    gltf.json["nodes"][0]["weights"] = [0.5]


def without(*names: str) -> Callable[[Gltf], Any]:
    return lambda gltf: [gltf.json.pop(name) for name in names]


REFUSED: list[tuple[Callable[[Gltf], Any], tuple[str, ...]]] = [
    (sparse, ("accessor 0 is sparse", "export it without")),
    (quantized(True), ("quantized positions", "32-bit floats")),
    (quantized(False), ("quantized positions",)),
    (lambda gltf: gltf.json["accessors"][0].pop("bufferView"), ("accessor 0", "no data")),
    (lambda gltf: gltf.json["meshes"][0]["primitives"][0].update(mode=6), ("fans", "export it as triangles")),
    (lambda gltf: gltf.json["meshes"][0]["primitives"][0].update(extensions={DRACO: {}}), ("Draco compression", DRACO)),
    (requiring(DRACO), ("Draco compression", DRACO, "export it without")),
    (requiring("EXT_meshopt_compression"), ("meshopt compression", "export it without")),
    (lambda gltf: gltf.json["bufferViews"][0].update(extensions={"KHR_meshopt_compression": {}}), ("meshopt",)),
    (requiring("ACME_surfaces"), ("ACME_surfaces", "export it without")),
    (node(extensions={"EXT_mesh_gpu_instancing": {}}), ("instances", "EXT_mesh_gpu_instancing")),
    (node(extensions={"KHR_node_visibility": {"visible": False}}), ("invisible nodes",)),
    (node(skin=0), ("bent by a skeleton", "before the export")),
    (morphed, ("morph targets", "before the export")),
    (below_a_camera, ("a camera", "export it without cameras")),
    (lambda gltf: gltf.json.update(buffers=[{"byteLength": 8, "uri": "a.bin"}]), ("further files", "as one GLB file")),
    (without("scene", "scenes"), ("no scene",)),
    (node(children=[0]), ("two places",)),
    (node(mesh=7), ("not readable",)),
    (lambda gltf: gltf.json["asset"].update(version="1.0"), ("version 1.0", "expected 2.0")),
    (lambda gltf: gltf.json["accessors"][0].update(count=9000), ("not readable",)),
    (lambda gltf: gltf.json["accessors"][0].update(count=-1), ("accessor 0 has no count",)),
    (lambda gltf: gltf.json["accessors"][1].update(componentType=5126), ("no integers",)),
    (lambda gltf: gltf.json["nodes"].extend([{"mesh": 0}] * 5000), ("60,012 triangles", "50,000")),
]


@pytest.mark.parametrize(("change", "facts"), REFUSED)
def test_what_is_not_read_is_refused_by_name(
    change: Callable[[Gltf], Any], facts: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(read, "MAX_FACES", 50_000)
    gltf = made()
    change(gltf)
    with pytest.raises(MeshRefused) as caught:
        read_mesh(gltf.glb(tmp_path / "a.glb"))
    assert all(fact in caught.value.reason for fact in facts), caught.value.reason
    assert "\n" not in caught.value.reason
