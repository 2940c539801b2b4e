"""Meshes and pictures in files: GLB, STL and PNG hold every number, as other programs read and write them."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from kit1000.dataset.mesh_files import glb_bytes, read_glb, stl_bytes
from kit1000.dataset.png_files import COMPRESSION, QUICK_COMPRESSION, png_bytes, read_png
from kit1000.errors import InputError
from kit1000.mesh import Mesh, defect_float32, y_up
from kit1000.parts.files.read import read_triangles
from tests.samples.mini import l_shape

POINTS = arrays(np.float64, (7, 3), elements=st.floats(-1, 1, width=32))
FACES = np.array([[0, 1, 2], [6, 5, 4], [3, 3, 0]], dtype=np.int32)


@given(POINTS)
def test_a_glb_has_every_vertex_and_face_to_the_bit(tmp_path_factory, points: np.ndarray) -> None:
    path = tmp_path_factory.getbasetemp() / "mesh.glb"
    path.write_bytes(glb_bytes({"a b/c": Mesh(points, FACES), "ä": Mesh(points[::-1], FACES[:1])}))
    bodies = read_glb(path)
    assert list(bodies) == ["a b/c", "ä"]
    assert bodies["a b/c"].vertices.tobytes() == points.tobytes()
    assert np.array_equal(bodies["a b/c"].faces, FACES)
    assert bodies["ä"].vertices.tobytes() == points[::-1].tobytes()


def test_y_up_maps_z_to_y_and_keeps_orientation() -> None:
    assert np.array_equal(y_up(np.eye(3)), [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert np.linalg.det(y_up(np.eye(3))) == pytest.approx(1)


def test_a_glb_handed_to_us_comes_in_z_up_like_an_stl(tmp_path: Path) -> None:
    mesh = l_shape()
    (tmp_path / "part.glb").write_bytes(glb_bytes({"part": mesh}))
    (tmp_path / "part.stl").write_bytes(stl_bytes(mesh))
    glb, stl = (read_triangles(tmp_path / f"part{suffix}") for suffix in (".glb", ".stl"))
    assert np.allclose(glb.vertices[glb.faces] * 1e3, stl.vertices[stl.faces], atol=1e-4)


def test_other_readers_find_metres_and_y_up_in_a_glb(tmp_path: Path) -> None:
    mesh = l_shape().rounded_float32()
    path = tmp_path / "mesh.glb"
    path.write_bytes(glb_bytes({"part": mesh}, {"part": (255, 0, 0)}))
    seen = trimesh.load_scene(path).to_mesh()
    assert np.allclose(seen.extents, mesh.extents[[0, 2, 1]], atol=1e-9)
    assert seen.volume == pytest.approx(mesh.volume, rel=1e-6)
    assert seen.is_watertight


def test_zeros_of_both_signs_have_bounds_of_one() -> None:
    """Which of two equal zeros a processor takes for the largest is its own."""
    points = np.array([[-1.0, -0.0, -1.0], [1.0, 0.0, -2.0], [0.5, -0.0, -3.0], [-2.0, 0.0, 1.0]] * 8)
    for mesh in (Mesh(points, FACES[:1]), Mesh(-points, FACES[:1])):
        assert b"-0.0" not in glb_bytes({"a": mesh})


def test_an_stl_holds_float32_millimetres_with_z_up(tmp_path: Path) -> None:
    mesh = l_shape()
    path = tmp_path / "mesh.stl"
    path.write_bytes(stl_bytes(mesh))
    soup = read_triangles(path)
    assert np.array_equal(soup.vertices.reshape(-1, 3, 3), (mesh.triangles * 1e3).astype(np.float32))
    seen = trimesh.load_mesh(path)
    assert np.allclose(seen.bounds, mesh.bounds * 1e3, atol=1e-5)
    assert seen.is_watertight
    assert defect_float32(mesh.scaled(1e3)) is None


@pytest.mark.parametrize("data", [b"", b"no glb", glb_bytes({"a": l_shape()})[:-100], glb_bytes({"a": l_shape()})[:40]])
def test_a_damaged_glb_is_one_line(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "mesh.glb"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"cannot read .*mesh\.glb: ") as caught:
        read_glb(path)
    assert "\n" not in str(caught.value)


def test_a_missing_glb_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no file .*mesh\.glb"):
        read_glb(tmp_path / "mesh.glb")


def test_a_glb_that_git_left_as_a_pointer_is_named(tmp_path: Path) -> None:
    path = tmp_path / "mesh.glb"
    path.write_bytes(b"version https://git-lfs.github.com/spec/v1\nsize 684\n")
    with pytest.raises(InputError, match=r"mesh\.glb: a Git LFS pointer .*: run git lfs pull$"):
        read_glb(path)


@pytest.mark.parametrize("compression", [COMPRESSION, QUICK_COMPRESSION])
@pytest.mark.parametrize("shape", [(1, 1, 3), (7, 30, 3), (64, 9, 3)])
def test_a_file_is_read_as_the_picture(shape: tuple[int, int, int], compression: int) -> None:
    picture = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    assert np.array_equal(read_png(png_bytes(picture, compression)), picture)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_an_image_of_one_channel_keeps_its_values(dtype: type) -> None:
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (7, 30), dtype=dtype)
    with Image.open(io.BytesIO(png_bytes(image))) as read:
        assert np.array_equal(np.asarray(read), image)


def test_a_file_says_what_it_was_made_with() -> None:
    picture = np.zeros((2, 2, 3), np.uint8)
    with Image.open(io.BytesIO(png_bytes(picture, software="kit1000"))) as read:
        assert read.text == {"Software": "kit1000"}  # pyright: ignore[reportAttributeAccessIssue]
    with Image.open(io.BytesIO(png_bytes(picture))) as read:
        assert read.text == {}  # pyright: ignore[reportAttributeAccessIssue]
