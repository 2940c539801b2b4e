"""Resting faces: probabilities agree with another package and do not depend on the part's axes."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import Manifold
from trimesh.poses import compute_stable_poses

from kit1000.kits.cavity import insertion_depth
from kit1000.kits.face import SAME_PROBABILITY, RestingFace, distinct_faces, rank_faces, resting_faces, tips_over
from kit1000.kits.kit import CLEARANCE
from kit1000.mesh import Mesh
from kit1000.pose import Pose, random_quaternions
from tests.samples.shapes import as_part, box, cylinder, ell, prism, random_solid, upturned_tee

SOLIDS = {
    "slab": lambda: box(30, 20, 9),
    "ell": ell,
    "tee": upturned_tee,
    "hex": lambda: prism(6, 20, 26),
    "wedge": lambda: Manifold.hull_points(np.array([[0, 0, 0], [30, 0, 0], [0, 22, 0], [0, 0, 14], [9, 5, 12.0]])),
}


def mesh(name: str) -> Mesh:
    return as_part(SOLIDS[name]()).mesh


def near(face: RestingFace, normal: np.ndarray, angle: float = 1e-3) -> bool:
    return float(face.normal @ normal) > np.cos(angle)


def trimesh_probabilities(body: Mesh) -> list[tuple[np.ndarray, float]]:
    """(down normal in the part's axes, share) by trimesh, same faces joined."""
    hull = trimesh.Trimesh(body.vertices, body.faces, process=False)
    poses, shares = compute_stable_poses(hull, center_mass=np.zeros(3), sigma=0, threshold=0)
    joined: list[tuple[np.ndarray, float]] = []
    for pose, share in zip(poses, shares, strict=True):
        down = -pose[2, :3]
        same = [i for i, (normal, _) in enumerate(joined) if normal @ down > 1 - 1e-6]
        if same:
            joined[same[0]] = (joined[same[0]][0], joined[same[0]][1] + share)
        else:
            joined.append((down, share))
    return joined


@pytest.mark.parametrize("name", SOLIDS)
def test_probabilities_agree_with_another_package(name: str) -> None:
    faces, peers = resting_faces(mesh(name), min_probability=1e-6), trimesh_probabilities(mesh(name))
    for normal, share in peers:
        ours = sum(face.probability for face in faces if near(face, normal))
        assert ours == pytest.approx(share, abs=2e-3)


@given(st.integers(0, 10_000))
def test_probabilities_add_up_to_one(seed: int) -> None:
    faces = resting_faces(as_part(random_solid(seed)).mesh, min_probability=0.0)
    assert sum(face.probability for face in faces) == pytest.approx(1)
    assert all(a.probability >= b.probability - 1e-6 for a, b in pairwise(faces))


@given(st.integers(0, 10_000))
def test_the_part_stands_stably_on_every_face(seed: int) -> None:
    """The centre of mass lies over the convex hull of what touches the table, and the height is that of the part."""
    body = as_part(random_solid(seed)).mesh
    for face in resting_faces(body):
        vertices = body.moved(face.plane_from_part).vertices
        touching = vertices[vertices[:, 2] < vertices[:, 2].min() + 1e-6, :2]
        angles = np.sort(np.arctan2(touching[:, 1], touching[:, 0]))
        widest_gap = np.diff(angles, append=angles[0] + 2 * np.pi).max()
        assert widest_gap < np.pi + 1e-6
        assert face.height == pytest.approx(np.ptp(vertices[:, 2]))


def test_unlikely_faces_are_left_out() -> None:
    tower = as_part(box(6, 7, 60)).mesh
    assert len(resting_faces(tower)) == 4
    assert len(resting_faces(tower, min_probability=0.0)) == 6


def test_a_cylinder_has_two_ends_and_one_side_to_roll_on() -> None:
    body = as_part(cylinder(20, 22)).mesh
    faces = resting_faces(body, min_probability=0.0)
    assert len(faces) == 3
    side = [face for face in faces if abs(face.normal[2]) < 1e-6]
    assert len(side) == 1
    # the zone of directions below the cone through the rim of an end
    assert side[0].probability == pytest.approx(11 / np.hypot(10, 11), abs=2e-3)


@pytest.mark.parametrize(("sides", "height"), [(19, 1.0), *product([20, 24, 96], [0.2, 1.0, 30.0])])
def test_every_prism_rests_somewhere(sides: int, height: float) -> None:
    """The facets of a prism of many sides are all unlikely, yet it rolls to rest on them."""
    faces = resting_faces(as_part(prism(sides, 10, 10 * height)).mesh)
    flat = [face for face in faces if abs(face.normal[2]) > 0.5]
    assert not any(face.rolls for face in flat)
    assert all(face.rolls for face in faces if abs(face.normal[2]) < 0.5)
    assert sum(face.probability for face in faces) > 0.9
    assert len(faces) - len(flat) == 1


def test_facets_of_a_slight_bend_do_not_roll() -> None:
    bent = Manifold.hull_points(np.array([[-20, -9, 1], [20, -9, 1], [-20, 9, 1], [20, 9, 1], [0, -9, 0], [0, 9, 0.0]]))
    body = as_part(bent + box(40, 18, 12, (0, 0, 1))).mesh
    assert not any(face.rolls for face in resting_faces(body))


def test_congruent_faces_and_mirror_images_are_tried_once() -> None:
    cube = as_part(box(20, 20, 20)).mesh
    assert len(distinct_faces(cube, resting_faces(cube))) == 1
    slab = as_part(box(30, 24, 20)).mesh
    assert len(distinct_faces(slab, resting_faces(slab))) == 3
    ell_faces = distinct_faces(mesh("ell"), resting_faces(mesh("ell")))
    assert sum(abs(face.normal[2]) > 0.5 for face in ell_faces) == 1  # from above it is the mirror image of below
    pocket = as_part(box(30, 24, 20) - box(8, 6, 5, (4, 3, 15))).mesh
    assert len(distinct_faces(pocket, resting_faces(pocket))) == 6


def first_choice(body: Mesh) -> RestingFace:
    faces = resting_faces(body)
    return faces[rank_faces(body, faces, [insertion_depth(face.height) for face in faces], CLEARANCE)[0]]


def test_an_l_is_inserted_with_its_outline_in_the_plate() -> None:
    assert abs(first_choice(mesh("ell")).normal[2]) == pytest.approx(1)


def test_a_plate_is_not_inserted_on_its_narrow_edge() -> None:
    """On its edge a 7 mm plate would lean by 20 degrees within its clearance."""
    assert abs(first_choice(as_part(box(40, 26, 7)).mesh).normal[2]) == pytest.approx(1)


def test_the_likeliest_face_comes_first_and_rolling_ones_after_flat_ones() -> None:
    for body in (as_part(box(40, 30, 12) + box(9, 30, 20, (-15.5, 0, 0))).mesh, as_part(cylinder(20, 22)).mesh):
        faces = resting_faces(body)
        order = rank_faces(body, faces, [insertion_depth(face.height) for face in faces], CLEARANCE)
        ranked = [faces[i] for i in order if not tips_over(body, faces[i], insertion_depth(faces[i].height), CLEARANCE)]
        assert [face.rolls for face in ranked] == sorted(face.rolls for face in ranked)
        flat = [face.probability for face in ranked if not face.rolls]
        assert all(a >= (1 - SAME_PROBABILITY) * b for a, b in pairwise(flat))


def test_contrast_decides_between_faces_as_likely() -> None:
    """A block with a corner cut away below: upside down the cut is above the rim, where it tells nothing."""
    body = as_part(box(40, 30, 20) - box(20, 15, 7, (10, 7.5, 0))).mesh
    faces = resting_faces(body)
    down = [face for face in faces if abs(face.normal[2]) > 0.99]
    a, b = sorted(down, key=lambda face: -face.probability)
    assert b.probability >= (1 - SAME_PROBABILITY) * a.probability
    assert first_choice(body).normal[2] == pytest.approx(-1)


@pytest.mark.parametrize("name", SOLIDS)
def test_the_choice_does_not_depend_on_the_axes(name: str) -> None:
    body, rotation = mesh(name), Pose(random_quaternions(np.random.default_rng(4), 1)[0], np.zeros(3))
    before, after = first_choice(body), first_choice(body.moved(rotation))
    assert after.height == pytest.approx(before.height)
    assert after.probability == pytest.approx(before.probability, abs=1e-6)
