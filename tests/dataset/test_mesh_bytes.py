"""Tests of the bytes of mesh files: those that trimesh writes, on which the checksums of datasets rest."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

from kit1000.dataset.mesh_files import FACET, glb_bytes, stl_bytes
from kit1000.mesh import Mesh, y_up
from tests.samples.mini import l_shape

LARGER = Mesh(l_shape().vertices * 1.5, l_shape().faces)
ROUGH = Mesh(
    np.random.default_rng(0).normal(size=(50, 3)), np.random.default_rng(1).permuted(np.arange(48)).reshape(16, 3)
)
CASES = [
    ({"part": l_shape()}, None),
    ({"kit": ROUGH, "part": l_shape()}, {"kit": (224, 219, 210), "part": (238, 122, 40)}),
    ({"a": l_shape(), 'b "é"': LARGER, "c": ROUGH, "d": l_shape()}, {"b": (1, 2, 3), "c": (5, 6, 7), "d": (5, 6, 7)}),
]


@pytest.mark.parametrize(("bodies", "colours"), CASES)
def test_a_glb_has_the_bytes_of_trimesh(bodies: dict[str, Mesh], colours: dict | None) -> None:
    scene = trimesh.Scene()
    for name, mesh in bodies.items():
        body = trimesh.Trimesh(y_up(mesh.vertices), mesh.faces, process=False)
        if colours and name in colours:
            colour = [*((c / 255) ** 2.2 for c in colours[name]), 1.0]
            material = PBRMaterial(baseColorFactor=colour, metallicFactor=0.0, roughnessFactor=0.6, doubleSided=False)
            body.visual = TextureVisuals(material=material)
        scene.add_geometry(body, node_name=name, geom_name=name)
    assert glb_bytes(bodies, colours) == scene.export(file_type="glb")


@pytest.mark.parametrize("mesh", [l_shape(), ROUGH])
def test_an_stl_has_the_numbers_of_trimesh(mesh: Mesh) -> None:
    theirs = trimesh.Trimesh(mesh.vertices * 1e3, mesh.faces, process=False).export(file_type="stl")
    ours = stl_bytes(mesh)
    assert isinstance(theirs, bytes)
    assert ours[:84] == theirs[:84]
    mine, reference = (np.frombuffer(data, FACET, offset=84) for data in (ours, theirs))
    assert np.array_equal(mine, reference)  # -0 equals 0
