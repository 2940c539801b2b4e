"""Repair of meshes: independent of the order in the file, every change is noted, hopeless surfaces are refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import Manifold

from kit1000.errors import MeshRefused
from kit1000.mesh import Mesh, defect_float32, mesh_from_solid, solid_from_mesh
from kit1000.parts.files.part_mesh import MAX_FACES_UNCHANGED, SIMPLIFY_TOLERANCE, part_mesh
from kit1000.parts.files.repair import closed_solid
from kit1000.parts.files.triangle_queries import crossings, max_distance

BOX = Manifold.cube((0.04, 0.02, 0.01), True)
SHAPES = {
    "box": BOX,
    "tube": Manifold.cylinder(0.03, 0.01, 0.01, 24) - Manifold.cylinder(0.09, 0.006, 0.006, 24, True),
    "ball": Manifold.sphere(0.02, 20),
    "bracket": Manifold.cube((0.04, 0.02, 0.004)) + Manifold.cube((0.004, 0.02, 0.03)),
}


def repaired(vertices: np.ndarray, faces: np.ndarray) -> tuple[Mesh, list[str]]:
    notes: list[str] = []
    mesh = part_mesh(closed_solid(np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int64), notes), notes)
    assert defect_float32(mesh) is None
    assert solid_from_mesh(mesh).volume() == pytest.approx(mesh.volume, rel=1e-9)
    return mesh, notes


def soup_of(*solids: Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Triangle corners (3m, 3) of several solids as an STL holds them, and faces (m, 3)."""
    corners = np.concatenate([mesh_from_solid(solid).triangles.reshape(-1, 3) for solid in solids])
    return corners, np.arange(len(corners)).reshape(-1, 3)


def tube_along(centre: Callable[[np.ndarray], np.ndarray], radius: float, n: int) -> Mesh:
    """A tube round a closed curve."""
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    tangent = centre(t + 1e-6) - centre(t - 1e-6)
    normal = np.cross(tangent, [0.0, 0.0, 1.0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    third = np.cross(tangent / np.linalg.norm(tangent, axis=1, keepdims=True), normal)
    k = 12
    angle = 2 * np.pi * np.arange(k) / k
    around = np.cos(angle)[:, None] * normal[:, None] + np.sin(angle)[:, None] * third[:, None]
    vertices = (centre(t)[:, None] + radius * around).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(k), indexing="ij")
    a, b = i * k + j, i * k + (j + 1) % k
    c, d = (i + 1) % n * k + (j + 1) % k, (i + 1) % n * k + j
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    mesh = Mesh(vertices, faces)
    return mesh if mesh.volume > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1])


def eight(t: np.ndarray) -> np.ndarray:
    """A curve that crosses itself at right angles in the middle, 60 mm long."""
    return 1e-3 * np.stack([30 * np.cos(t), 20 * np.sin(2 * t), np.zeros_like(t)], axis=1)


@given(st.sampled_from(sorted(SHAPES)), st.integers(0, 2**32 - 1))
def test_the_result_does_not_depend_on_the_order_in_the_file(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    indexed = mesh_from_solid(SHAPES[name])
    corners, _ = soup_of(SHAPES[name])
    wanted, _ = repaired(indexed.vertices, indexed.faces)
    order = rng.permutation(len(indexed.faces))
    turned = np.stack([np.roll(face, rng.integers(3)) for face in np.arange(len(corners)).reshape(-1, 3)[order]])
    shuffle = rng.permutation(len(corners))
    found, notes = repaired(corners[shuffle], np.argsort(shuffle)[turned])
    assert np.array_equal(found.vertices, wanted.vertices)
    assert found.volume == pytest.approx(wanted.volume, rel=1e-12)
    assert notes == []


@given(st.sampled_from(sorted(SHAPES)), st.integers(0, 2**32 - 1))
def test_faces_of_any_winding_become_outward(name: str, seed: int) -> None:
    mesh = mesh_from_solid(SHAPES[name])
    flip = np.random.default_rng(seed).random(len(mesh.faces)) < 0.5
    found, _ = repaired(mesh.vertices, np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces))
    assert found.volume == pytest.approx(SHAPES[name].volume(), rel=1e-5)


@given(st.sampled_from(sorted(SHAPES)), st.integers(0, 2**32 - 1))
def test_seams_of_rounding_noise_are_welded(name: str, seed: int) -> None:
    corners, faces = soup_of(SHAPES[name])
    noise = 1e-9 * np.random.default_rng(seed).uniform(-1, 1, corners.shape)
    found, notes = repaired(corners + noise, faces)
    assert found.volume == pytest.approx(SHAPES[name].volume(), rel=1e-5)
    assert any(note.startswith("welded") for note in notes)


def test_an_inside_out_solid_is_flipped_and_noted() -> None:
    mesh = mesh_from_solid(BOX)
    found, notes = repaired(mesh.vertices, mesh.faces[:, ::-1])
    assert found.volume == pytest.approx(8e-6)
    assert notes == ["flipped inside out"]


def test_vertices_in_the_middle_of_longer_edges_are_stitched() -> None:
    corners, faces = soup_of(BOX)
    top = np.flatnonzero((corners[faces][..., 2] > 0).all(1))  # the two faces above, replaced by a fan of eight
    rim = 1e-3 * np.array([[20, 10, 5], [0, 10, 5], [-20, 10, 5], [-20, 0, 5], [-20, -10, 5], [0, -10, 5]])
    rim = np.concatenate([rim, 1e-3 * np.array([[20, -10, 5], [20, 0, 5]])])
    fan = np.stack([np.tile([0, 0, 0.005], (8, 1)), rim, np.roll(rim, -1, axis=0)], axis=1)
    all_corners = np.concatenate([np.delete(corners[faces], top, axis=0), fan]).reshape(-1, 3)
    found, notes = repaired(all_corners, np.arange(len(all_corners)).reshape(-1, 3))
    assert found.volume == pytest.approx(8e-6)
    assert notes == ["stitched 4 T-junctions"]


def test_a_small_hole_is_filled_and_a_large_one_is_not() -> None:
    corners, faces = soup_of(SHAPES["ball"])
    _, notes = repaired(corners, faces[1:])
    assert notes == ["filled a small hole"]
    upper = corners[faces][..., 2].min(1) > 0.005
    with pytest.raises(MeshRefused, match=r"^not closed: \d+ open edges"):
        repaired(corners, faces[~upper])


def test_unconnected_triangles_are_refused_before_any_search() -> None:
    corners = np.random.default_rng(0).uniform(0, 0.05, (120_000, 3))
    with pytest.raises(MeshRefused, match=r"^not closed: 120000 open edges in .* holes"):
        repaired(corners, np.arange(120_000).reshape(-1, 3))


def test_holes_that_touch_at_a_vertex_are_filled() -> None:
    corners, faces = soup_of(SHAPES["ball"])
    apex = corners[faces[0, 0]]
    around = np.flatnonzero((corners[faces] == apex).all(-1).any(-1))
    missing = around[[0, int(len(around) // 2)]]
    found, _ = repaired(corners, np.delete(faces, missing, axis=0))
    assert found.volume == pytest.approx(SHAPES["ball"].volume(), rel=1e-3)


@pytest.mark.parametrize("both_sides", [False, True])
def test_a_sheet_has_no_thickness_however_it_is_tilted(both_sides: bool) -> None:
    sheet = 1e-3 * np.array([[0, 0, 0], [30, 0, 3], [30, 20, 3], [0, 20, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    with pytest.raises(MeshRefused, match=r"^zero thickness$"):
        repaired(sheet, np.concatenate([faces, faces[:, ::-1]]) if both_sides else faces)


def test_a_foil_is_refused_for_its_thickness() -> None:
    with pytest.raises(MeshRefused, match=r"^zero thickness$"):
        repaired(*soup_of(Manifold.cube((0.04, 0.02, 4e-6))))


def test_a_klein_bottle_is_one_sided() -> None:
    n = 8
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")

    def vertex(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return u % n * n + np.where(u >= n, -v, v) % n

    a, b, c, d = vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    vertices = np.random.default_rng(0).uniform(0, 0.05, (n * n, 3))
    with pytest.raises(MeshRefused, match="one-sided"):
        repaired(vertices, faces)


@given(st.floats(-0.04, 0.04), st.floats(-0.02, 0.02), st.floats(-0.01, 0.01))
def test_bodies_are_united_when_they_overlap(x: float, y: float, z: float) -> None:
    shift = np.round([x, y, z], 3)
    overlap = float(np.prod(np.maximum([0.04, 0.02, 0.01] - np.abs(shift), 0)))
    if overlap < 1e-9:  # touching or apart
        return
    found, _ = repaired(*soup_of(BOX, BOX.translate(shift.tolist())))
    assert found.volume == pytest.approx(2 * 8e-6 - overlap, rel=1e-5)


def test_bodies_that_touch_face_to_face_become_one() -> None:
    for shift in ((0.04, 0.0, 0.0), (0.04, 0.005, 0.003)):  # the first shares its faces, the second not
        found, notes = repaired(*soup_of(BOX, BOX.translate(shift)))
        assert found.volume == pytest.approx(16e-6, rel=1e-5)
        assert notes


def test_a_small_extra_body_is_dropped_and_two_equal_bodies_are_refused() -> None:
    small = BOX.scale((0.3, 0.3, 0.3)).translate((0.06, 0, 0))
    found, notes = repaired(*soup_of(BOX, small))
    assert found.volume == pytest.approx(8e-6, rel=1e-5)
    assert notes == ["kept the largest of 2 bodies (97.4% of the volume)"]
    with pytest.raises(MeshRefused, match=r"^2 separate bodies \(50%, 50% of the volume\)$"):
        repaired(*soup_of(BOX, BOX.translate((0.06, 0, 0))))


def test_a_void_is_kept_and_a_separate_inverted_body_is_flipped() -> None:
    inner = BOX.scale((0.5, 0.5, 0.5))
    hollow, notes = repaired(*soup_of(BOX - inner))
    assert hollow.volume == pytest.approx(7e-6, rel=1e-5)
    assert notes == []
    corners, faces = soup_of(BOX, BOX.scale((0.4, 0.4, 0.4)).translate((0.06, 0, 0)))
    beside, notes = repaired(corners, np.concatenate([faces[:12], faces[12:, ::-1]]))
    assert beside.volume == pytest.approx(8e-6, rel=1e-5)
    assert notes[0] == "flipped 1 of 2 bodies inside out"


def test_solids_that_touch_along_an_edge_stay_closed_after_rounding() -> None:
    stairs = BOX + BOX.translate((0.04, 0.02, 0)) + Manifold.cube((0.08, 0.04, 0.01)).translate((-0.02, -0.01, 0.005))
    found, notes = repaired(*soup_of(stairs))
    assert found.volume == pytest.approx(stairs.volume(), rel=1e-3)
    assert notes == ["separated surfaces that touch along edges, by 2 um"]


def test_a_loop_that_crosses_itself_is_refused() -> None:
    whole = tube_along(eight, 0.004, 96)
    with pytest.raises(MeshRefused, match=r"^passes through itself at \d+ places"):
        repaired(whole.vertices, whole.faces)


def test_a_small_fold_is_removed_within_the_stated_distance() -> None:
    mesh = mesh_from_solid(BOX.refine(40))
    vertices = np.array(mesh.vertices)
    vertices[np.argmin(np.linalg.norm(vertices - [0, 0, 0.005], axis=1))] += [1.3e-3, 0, 1e-5]
    found, notes = repaired(vertices, mesh.faces)
    assert found.volume == pytest.approx(8e-6, rel=1e-4)
    assert len(notes) >= 1


def test_a_spike_through_the_far_side_is_refused() -> None:
    mesh = mesh_from_solid(BOX.refine(8))
    vertices = np.array(mesh.vertices)
    vertices[np.argmin(np.linalg.norm(vertices - [0, 0, 0.005], axis=1))] = [3e-4, 2e-4, -0.012]
    with pytest.raises(MeshRefused, match=r"^passes through itself at \d+ places"):
        repaired(vertices, mesh.faces)


def test_many_faces_are_simplified_within_the_stated_distance() -> None:
    dense = SHAPES["tube"].refine(16)
    found, notes = repaired(*soup_of(dense))
    assert dense.num_tri() > MAX_FACES_UNCHANGED >= len(found.faces)
    assert notes[0].startswith(f"simplified {dense.num_tri():,} -> ")
    assert max_distance(found.vertices, mesh_from_solid(dense).triangles, 1e-4) <= SIMPLIFY_TOLERANCE
    assert max_distance(mesh_from_solid(dense).vertices, found.triangles, 1e-4) <= SIMPLIFY_TOLERANCE * (1 + 1e-3)
    assert found.volume == pytest.approx(dense.volume(), rel=1e-2)


@given(st.integers(0, 2**32 - 1))
def test_surfaces_cross_exactly_when_solids_overlap_without_containment(seed: int) -> None:
    """Two random tetrahedra, compared with exact booleans."""
    rng = np.random.default_rng(seed)
    first, second = (Manifold.hull_points(rng.uniform(-1, 1, (4, 3)) + shift) for shift in rng.uniform(0, 0.6, (2, 3)))
    shared = (first ^ second).volume()
    cross = 1e-6 < shared < min(first.volume(), second.volume()) - 1e-6
    triangles = np.concatenate([mesh_from_solid(first).triangles, mesh_from_solid(second).triangles])
    if cross or shared == 0 or shared > min(first.volume(), second.volume()) - 1e-12:
        assert (len(crossings(triangles, 1e-9)) > 0) == cross


@given(st.integers(0, 2**32 - 1))
def test_distance_to_a_box_matches_its_closed_form(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-3, 3, (20, 3))
    outside = np.abs(points) - [1.0, 0.5, 0.25]
    expected = np.where((outside > 0).any(1), np.linalg.norm(np.maximum(outside, 0), axis=1), -outside.max(1))
    triangles = mesh_from_solid(Manifold.cube((2, 1, 0.5), True)).triangles
    for point, distance in zip(points, expected, strict=True):
        assert max_distance(point[None], triangles, 10.0) == pytest.approx(distance, abs=1e-12)
    assert max_distance(points, triangles, 1e-3) == pytest.approx(min(expected.max(), 1e-3))
