"""Meshes are values; measures of solids against closed forms and trimesh; every kind of defect is named."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from kit1000.errors import MeshRefused, ShapeError
from kit1000.kits.printable_mesh import printable_mesh
from kit1000.mesh import (
    Mesh,
    body_count,
    convex_hull,
    defect,
    defect_float32,
    mesh_from_solid,
    solid_from_mesh,
    surface_points,
)
from kit1000.pose import Pose
from tests.samples.shapes import box, cylinder, random_solid, standing
from tests.samples.strategies import poses

CUBE = mesh_from_solid(standing(box(20, 30, 40)))


def other(mesh: Mesh) -> trimesh.Trimesh:
    """The same mesh in trimesh."""
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def test_a_mesh_is_a_value() -> None:
    vertices = np.array(CUBE.vertices)
    mesh = Mesh(vertices, CUBE.faces)
    vertices[:] = 0
    assert mesh.volume == pytest.approx(24e-6)
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 1
    with pytest.raises(ValueError, match="read-only"):
        mesh.faces[0] = 1


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((4, 2)), np.zeros((1, 3), int), r"vertices: expected .*\(n, 3\), got shape \(4, 2\)"),
        (np.zeros((4, 3)), np.zeros((1, 4), int), r"faces: expected .*\(m, 3\), got shape \(1, 4\)"),
        (np.full((4, 3), np.nan), np.zeros((1, 3), int), "vertices"),
        (np.zeros((4, 3)), np.array([[0, 1, 4]]), "indices run from 0 to 4, expected 0 to 3"),
        (np.zeros((4, 3)), np.array([[0, -1, 2]]), "indices run from -1 to 2, expected 0 to 3"),
    ],
)
def test_wrong_arrays_are_rejected_with_what_was_expected(
    vertices: np.ndarray, faces: np.ndarray, message: str
) -> None:
    with pytest.raises(ShapeError, match=message):
        Mesh(vertices, faces)


@given(st.integers(0, 10_000), poses())
def test_measures_agree_with_trimesh_at_any_pose(seed: int, pose: Pose) -> None:
    mesh = mesh_from_solid(standing(random_solid(seed))).moved(pose)
    peer = other(mesh)
    assert mesh.volume == pytest.approx(peer.volume, rel=1e-6)
    assert mesh.area == pytest.approx(peer.area, rel=1e-9)
    assert np.allclose(mesh.centroid, peer.center_mass, atol=1e-8)
    assert np.allclose(mesh.bounds, peer.bounds)


def test_measures_of_a_box() -> None:
    assert CUBE.volume == pytest.approx(20e-3 * 30e-3 * 40e-3)
    assert CUBE.area == pytest.approx(2 * (600 + 800 + 1200) * 1e-6)
    assert np.allclose(CUBE.centroid, [0, 0, 20e-3])
    assert np.allclose(CUBE.extents, [20e-3, 30e-3, 40e-3])
    assert Mesh(CUBE.vertices, CUBE.faces[:, ::-1]).volume == pytest.approx(-24e-6)
    assert CUBE.scaled(2).volume == pytest.approx(8 * CUBE.volume)


def two_boxes_on_an_edge() -> Mesh:
    touching = box(10, 10, 10) + box(10, 10, 10, (10, 10, 0))
    return mesh_from_solid(standing(touching)).merged()


def test_every_defect_is_named() -> None:
    vertices, faces = CUBE.vertices, CUBE.faces
    assert defect(CUBE) is None
    assert defect(Mesh(vertices, faces[:0])) == "empty mesh"
    assert defect(Mesh(vertices, faces[1:])) == "not closed: 3 open edges"
    assert defect(Mesh(vertices, np.concatenate([faces[:1, ::-1], faces[1:]]))) == "inconsistent winding"
    assert defect(Mesh(vertices, faces[:, ::-1])) == "inside out"
    assert defect(Mesh(vertices * [1, 1, 1e-6], faces)) == "zero thickness"
    assert defect(Mesh(vertices, np.concatenate([faces, [[0, 0, 1]]]))) == "1 collapsed edges"
    assert "edges shared by more than two faces" in str(defect(two_boxes_on_an_edge()))


def test_meshes_convert_to_solids_and_back() -> None:
    again = mesh_from_solid(solid_from_mesh(CUBE))
    assert again.volume == pytest.approx(CUBE.volume)
    assert len(again.faces) == 12
    with pytest.raises(MeshRefused, match="not closed: 3 open edges"):
        solid_from_mesh(Mesh(CUBE.vertices, CUBE.faces[1:]))
    with pytest.raises(MeshRefused, match="inside out"):
        solid_from_mesh(Mesh(CUBE.vertices, CUBE.faces[:, ::-1]))


def test_defect_float32_checks_the_mesh_as_a_loader_reads_it() -> None:
    """Closed by its indices, but two vertices are equal after float32 rounding."""
    parted = mesh_from_solid(box(10, 10, 10)).vertices * 1e-3, mesh_from_solid(box(10, 10, 10)).faces
    second = parted[0] + [10e-3, 10e-3 + 1e-12, 0]
    both = Mesh(np.concatenate([parted[0], second]), np.concatenate([parted[1], parted[1] + 8]))
    assert defect(both) is None
    assert "shared by more than two faces" in str(defect_float32(both))


def test_bodies_are_counted() -> None:
    assert body_count(CUBE) == 1
    assert body_count(mesh_from_solid(box(5, 5, 5) + box(5, 5, 5, (9, 0, 0)))) == 2
    assert body_count(mesh_from_solid(box(9, 9, 9) - box(3, 3, 3, (0, 0, 3)))) == 2


def test_rounding_moves_less_than_a_float32_step_and_is_idempotent() -> None:
    mesh = mesh_from_solid(standing(random_solid(3)))
    rounded = mesh.rounded_float32()
    assert np.array_equal(rounded.vertices, rounded.vertices.astype(np.float32))
    assert np.abs(rounded.vertices - mesh.vertices).max() < 4e-9
    assert np.array_equal(rounded.rounded_float32().vertices, rounded.vertices)


def test_merging_drops_duplicate_and_unused_vertices_and_collapsed_faces() -> None:
    loose = Mesh(np.concatenate([CUBE.triangles.reshape(-1, 3), [[9, 9, 9]]]), np.arange(36).reshape(12, 3))
    assert "not closed" in str(defect(loose))
    merged = loose.merged()
    assert len(merged.vertices) == 8
    assert defect(merged) is None
    assert merged.volume == pytest.approx(CUBE.volume)


def test_surface_points_are_uniform_over_the_area() -> None:
    points = surface_points(CUBE, 60_000, np.random.default_rng(5))
    assert np.abs(points[:, :2] / [10e-3, 15e-3]).max() <= 1 + 1e-9
    on_top = np.isclose(points[:, 2], 40e-3)
    assert on_top.mean() == pytest.approx(600 / 5200, abs=0.006)
    assert (points[on_top, 0] > 5e-3).mean() == pytest.approx(1 / 4, abs=0.03)


@given(st.integers(0, 10_000))
def test_hulls_are_exact_at_the_size_of_a_part(seed: int) -> None:
    """In metres the hull of manifold3d is off by micrometres: compare facets and volume."""
    points = np.random.default_rng(seed).normal(0, 0.01, (60, 3))
    points = np.concatenate([points, points * [1, 1, 1 + 1e-4]])
    hull = mesh_from_solid(convex_hull(points))
    heights = points @ hull.normals.T - np.einsum("ij,ij->i", hull.normals, hull.triangles[:, 0])
    broad = np.linalg.norm(np.cross(*np.moveaxis(np.diff(hull.triangles, axis=1), 1, 0)), axis=1) > 1e-8
    assert heights[:, broad].max() < 1e-8


def test_walls_that_touch_on_an_edge_are_printable() -> None:
    """Two pits that touch along one vertical line leave a plate whose mesh loaders consider open."""
    pits = box(10, 10, 20, (-5, -5, 4)) + box(10, 10, 20, (5, 5, 4))
    solid = standing(box(40, 40, 12) - pits)
    assert "shared by more than two faces" in str(defect_float32(mesh_from_solid(solid)))
    mesh = printable_mesh(solid, "plate")
    assert defect_float32(mesh) is None
    assert body_count(mesh) == 1
    assert mesh.volume == pytest.approx(solid.volume(), rel=1e-4)
    assert np.array_equal(mesh.vertices, mesh.rounded_float32().vertices)


def test_slivers_and_thin_films_do_not_open_a_printable_mesh() -> None:
    rng = np.random.default_rng(1)
    for _ in range(6):
        solid = box(40, 40, 12)
        for angle in rng.uniform(0, 360, 4):
            shaft = cylinder(14, 20, segments=48).rotate((0, 0, angle)).translate((7, 0, 3))
            solid = solid - shaft.rotate((0, 0, angle + 1e-7))
        assert defect_float32(printable_mesh(standing(solid), "plate")) is None
