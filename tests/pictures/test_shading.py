"""Shaded pictures: all bodies in view, correct colours, shadows and lines; contact sheets."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.pictures import lighting
from kit1000.pictures.creases import smooth_patches
from kit1000.pictures.shading import (
    KIT,
    PAPER,
    PART,
    SECONDARY,
    ColouredBody,
    contact_sheet,
    framing_camera,
    shaded_picture,
)
from kit1000.pose import Pose, random_quaternions

IDENTITY = Pose.identity()
ABOVE = (0.0, 0.0, 1.0)
SIZE = (120, 90)


def mesh(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(shape.vertices), np.array(shape.faces, dtype=np.int32))


BOX = mesh(trimesh.creation.box(extents=(0.08, 0.06, 0.04)))
BALL = mesh(trimesh.creation.icosphere(subdivisions=3, radius=0.03))
CYLINDER = mesh(trimesh.creation.cylinder(radius=0.02, height=0.05, sections=24))


def picture(bodies: list[ColouredBody], direction=(0.5, -1.0, 0.8), **options) -> np.ndarray:
    return shaded_picture(bodies, *framing_camera(bodies, direction, SIZE, margin=0.2), **options)


def brightness(image: np.ndarray) -> np.ndarray:
    return image.astype(float).mean(axis=2)


@settings(max_examples=40)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(lambda d: np.linalg.norm(d) > 0.1),
    st.sampled_from([(640, 480), (300, 500), (64, 64)]),
    st.sampled_from([5.0, 20.0, 60.0]),
)
def test_the_framing_camera_sees_every_vertex_as_near_as_possible(
    seed: int, direction: tuple, size: tuple, field_deg: float
):
    rng = np.random.default_rng(seed)
    poses = Pose(random_quaternions(rng, 3), rng.uniform(-0.2, 0.2, (3, 3)))
    bodies = list(zip((BOX, BALL, CYLINDER), poses, strict=True))
    camera, view = framing_camera(bodies, direction, size, field_deg, margin=0.1)
    points = np.concatenate([pose.apply(shape.vertices) for shape, pose in bodies])
    share = (camera.project(view.inverse().apply(points)) + 0.5) / np.array(size)
    low, high = share.min(axis=0), share.max(axis=0)
    assert (low >= 0.1 - 1e-9).all()
    assert (high <= 0.9 + 1e-9).all()
    # The tighter side extends from border to border, the other one is centred.
    assert (high - low).max() == pytest.approx(0.8, abs=1e-6)
    forward = view.rotate(np.array((0.0, 0.0, 1.0)))
    np.testing.assert_allclose(forward, -np.array(direction) / np.linalg.norm(direction), atol=1e-9)


def test_the_framing_camera_needs_a_body():
    with pytest.raises(InputError, match="at least one body"):
        framing_camera([])


def test_without_bodies_there_is_only_the_background():
    camera, view = framing_camera([(BOX, IDENTITY)], size=SIZE)
    image = shaded_picture([], camera, view)
    assert image.shape == (90, 120, 3)
    assert (image == PAPER).all()


@pytest.mark.parametrize("colour", [KIT, PART, *SECONDARY])
def test_a_level_face_has_the_colour_of_its_body(colour: tuple[int, int, int]):
    image = picture([ColouredBody(BOX, IDENTITY, colour)], ABOVE)
    assert np.abs(image[45, 60].astype(int) - colour).max() <= 20


def test_a_body_casts_a_shadow_on_the_ground_only():
    body = [ColouredBody(BOX, IDENTITY, KIT)]
    with_ground, without = brightness(picture(body, ABOVE)), brightness(picture(body, ABOVE, ground=False))
    free = np.ones(with_ground.shape, bool)
    free[15:75, 20:100] = False  # away from the box itself, which fills 60 % of the image
    assert (without[free] == np.mean(PAPER)).mean() > 0.98
    assert with_ground[free].min() < np.mean(PAPER) - 20
    assert with_ground[free].max() <= np.ceil(np.mean(PAPER))


def test_a_cavity_is_darker_than_the_plate_around_it():
    outer = trimesh.creation.annulus(r_min=0.01, r_max=0.05, height=0.04, sections=48)
    floor = trimesh.creation.cylinder(radius=0.02, height=0.005, sections=48)
    floor.apply_translation((0, 0, -0.015))
    image = brightness(
        picture([ColouredBody(mesh(outer), IDENTITY, KIT), ColouredBody(mesh(floor), IDENTITY, KIT)], ABOVE)
    )
    assert image[45, 60] < image[45, 80] - 30


def test_edges_of_a_box_are_drawn_dark():
    image = brightness(picture([ColouredBody(BOX, IDENTITY, KIT)], (0.0, -1.0, 1.0), ground=False))
    column = image[:, 60]  # from the background over the top face and the front face
    front_edge = 30 + column[30:60].argmin()
    assert column[front_edge] < min(column[front_edge - 5], column[front_edge + 5]) - 15
    assert column[:30].min() < 160


def test_a_view_from_below_draws_no_ground():
    body = [ColouredBody(BOX, IDENTITY, KIT)]
    down = (0.3, -0.4, -1.0)
    np.testing.assert_array_equal(picture(body, down), picture(body, down, ground=False))


@pytest.mark.parametrize(("shape", "count"), [(BOX, 6), (BALL, 1), (CYLINDER, 3)])
def test_the_number_of_smooth_patches(shape: Mesh, count: int):
    assert len(np.unique(smooth_patches(shape)[0])) == count


def test_patches_do_not_depend_on_shared_vertices():
    corners = BALL.triangles.reshape(-1, 3)
    soup = Mesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    patches, normals = smooth_patches(soup)
    assert len(np.unique(patches)) == 1
    np.testing.assert_allclose(normals, smooth_patches(BALL)[1], atol=1e-9)


def test_shading_normals_are_those_of_the_true_surface():
    flat = smooth_patches(BOX)[1]
    np.testing.assert_allclose(flat, np.repeat(BOX.normals[:, None], 3, axis=1), atol=1e-12)
    np.testing.assert_allclose(smooth_patches(BALL)[1], BALL.triangles / 0.03, atol=0.01)
    side = np.abs(CYLINDER.normals[:, 2]) < 0.5
    radial = CYLINDER.triangles[side] * (1, 1, 0) / 0.02
    np.testing.assert_allclose(smooth_patches(CYLINDER)[1][side], radial, atol=1e-6)


def test_open_light_is_that_of_a_picture_of_a_face_that_nothing_shades():
    key, up = np.array((0.6, 0.0, 0.8)), np.array((0.0, 0.0, 1.0))
    normals = np.concatenate([np.eye(3), -np.eye(3), [key]])
    lamps = lighting.place_lamps([(BOX, IDENTITY)], np.zeros(3), 0.06, key)
    found = lighting.open_light(normals, key, up)
    for normal, light in zip(normals, found, strict=True):
        shares = lamps.weights * np.maximum(lamps.directions @ normal, 0)
        from_lamps = shares[: lamps.key_count].sum(), shares[lamps.key_count :].sum(), (1 - normal[2]) / 2
        np.testing.assert_allclose(light, from_lamps @ lighting.COLOURS, atol=0.1)


def test_a_contact_sheet_has_every_picture_with_a_caption():
    images = [np.full((30, 100, 3), shade, np.uint8) for shade in (10, 60, 110, 160, 210)]
    sheet = np.array(contact_sheet(images, ["a", "b", "c", "d", "a long caption that cannot fit"], columns=2))
    for shade in (10, 60, 110, 160, 210):
        assert (sheet == shade).all(axis=2).sum() >= 30 * 100 - 5
    rows, width = sheet.shape[0] // 3, sheet.shape[1] // 2
    last = sheet[2 * rows + 35 :, :width]
    assert (brightness(last) < 150).sum() > 20  # letters
    assert (sheet[:, -2:] == PAPER).all()  # nothing runs over the border


def test_a_contact_sheet_accepts_pillow_images_of_several_sizes():
    sheet = contact_sheet([Image.new("RGB", (40, 20)), Image.new("RGB", (80, 60))], ["one", "two"], columns=5)
    assert sheet.width > 160
    assert sheet.width < 200


def test_a_contact_sheet_needs_as_many_labels_as_images():
    with pytest.raises(InputError, match="1 images but 2 labels"):
        contact_sheet([np.zeros((2, 2, 3), np.uint8)], ["a", "b"])
    with pytest.raises(InputError, match="at least one image"):
        contact_sheet([], [])
