"""Pictures of meshes and of depth images: bodies in view, colours, light, shadows, lines and holes; contact sheets."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from kit1000.camera import Camera
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.pictures import lighting
from kit1000.pictures.creases import smooth_patches
from kit1000.pictures.depth_images import (
    FAR_COLOUR,
    MIDDLE_COLOUR,
    NEAR_COLOUR,
    depth_picture,
    mask_picture,
    surface_light,
    surface_normals,
)
from kit1000.pictures.shading import (
    INK,
    KIT,
    PAPER,
    PART,
    SECONDARY,
    TABLE,
    ColouredBody,
    contact_sheet,
    framing_camera,
    shaded_picture,
)
from kit1000.pose import Pose, random_quaternions
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

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


def test_a_contact_sheet_needs_as_many_labels_as_images():
    with pytest.raises(InputError, match="1 images but 2 labels"):
        contact_sheet([np.zeros((2, 2, 3), np.uint8)], ["a", "b"])
    with pytest.raises(InputError, match="at least one image"):
        contact_sheet([], [])


CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
SHAPE = (CAMERA.height, CAMERA.width)


def view_of(depth: np.ndarray) -> View:
    return View(CAMERA, Pose.identity(), depth)


def steps(*distances: float) -> np.ndarray:
    """Walls across the optical axis, side by side from left to right [m]."""
    width = CAMERA.width // len(distances)
    return np.repeat(np.array(distances), width)[None].repeat(CAMERA.height, axis=0)


def hue_of(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) colours without their brightness: the fractions of red, green, blue."""
    return picture / picture.sum(axis=-1, keepdims=True).clip(1)


def unlit(colour: tuple[int, int, int]) -> np.ndarray:
    return np.array(colour) / sum(colour)


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 1.0))
def test_holes_are_ink(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    depth = np.where(rng.random(SHAPE) < share, 0, rng.uniform(0.5, 1.5, SHAPE))
    image = LabelledDepth(view_of(depth), rng.integers(0, 9, SHAPE).astype(np.uint8))
    for picture in (depth_picture(image.view), mask_picture(image)):
        assert picture.shape == (*SHAPE, 3)
        assert picture.dtype == np.uint8
        assert (picture[depth == 0] == INK).all()


def test_the_ends_and_the_middle_of_the_scale_have_their_colours() -> None:
    hues = hue_of(depth_picture(view_of(steps(0.5, 1.0, 1.5, 0.5))).astype(float))[20, 8::16]
    for hue, colour in zip(hues, (NEAR_COLOUR, MIDDLE_COLOUR, FAR_COLOUR, NEAR_COLOUR), strict=True):
        np.testing.assert_allclose(hue, unlit(colour), atol=0.01)


def test_a_few_outliers_do_not_change_the_scale() -> None:
    depth = steps(0.8, 0.9)
    outliers = depth.copy()
    outliers[3, 3], outliers[40, 60] = 0.01, 60.0
    one, other = (depth_picture(view_of(image)).astype(int) for image in (depth, outliers))
    far = np.ones(SHAPE, bool)
    far[1:6, 1:6] = far[38:43, 58:63] = False  # shading depends on neighbours
    assert np.abs(one - other)[far].max() <= 2


def normals_of(depth: np.ndarray) -> np.ndarray:
    return surface_normals(CAMERA, depth.astype(np.float32), np.ones(SHAPE, bool)).reshape(*SHAPE, 3)


@given(tilt=st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7)))
def test_the_normals_of_a_plane_are_its_own_towards_the_camera(tilt: tuple[float, float]) -> None:
    normal = np.array((*tilt, -1.0)) / np.linalg.norm((*tilt, 1.0))
    v, u = np.indices(SHAPE)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(SHAPE)], axis=-1)
    found = normals_of(0.7 * normal[2] / (rays @ normal))
    np.testing.assert_allclose(found, np.broadcast_to(normal, found.shape), atol=1e-3)


def test_edges_stay_sharp_and_lone_pixels_have_no_normal() -> None:
    np.testing.assert_allclose(normals_of(steps(0.5, 0.9)) @ (0, 0, -1), 1, atol=1e-6)  # two walls, no slope between
    lone = np.zeros(SHAPE)
    lone[20, 30] = 0.7
    assert np.isnan(normals_of(lone)).all()
    assert (surface_light(CAMERA, lone, lone > 0) == 1).all()


def test_surfaces_are_lit_from_the_upper_left() -> None:
    """The same slope is bright where it faces the light and dark where it faces away."""
    v, u = np.indices(SHAPE)
    # Depth grows towards the side that a surface faces: the ground is farther the higher it is in the image.
    facing = {"left": -u, "right": u, "up": -v, "down": v}
    views = {side: LabelledDepth(view_of(1 + 0.01 * along), np.ones(SHAPE, np.uint8)) for side, along in facing.items()}
    lit = {side: int(mask_picture(image)[24, 32].sum()) for side, image in views.items()}
    assert min(lit["left"], lit["up"]) > 1.2 * max(lit["right"], lit["down"])


def test_lines_separate_labels_and_steps_but_cross_no_plane() -> None:
    labels = np.ones(SHAPE, np.uint8)
    v, u = np.indices(SHAPE)
    tilted = 1 / (1.2 + 0.002 * u - 0.001 * v)  # a plane: its inverse depth is linear

    def is_dark(depth: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        return mask_picture(LabelledDepth(view_of(depth), kinds)).max(axis=2) < 120

    assert not is_dark(tilted, labels).any()
    two = np.where(u < 32, 1, 2).astype(np.uint8)
    assert is_dark(tilted, two)[:, 31:33].all()
    assert is_dark(tilted - 0.05 * (u >= 32), labels)[:, 31:33].all(axis=0).any()


def test_masks_have_the_colour_of_their_label() -> None:
    labels = np.zeros(SHAPE, np.uint8)
    colours = {0: TABLE, ASSEMBLY_LABEL: KIT}
    colours |= {FIRST_PART_LABEL + i: (PART, *SECONDARY)[i % 7] for i in range(8)}
    for place, label in enumerate(colours):
        labels[:, 6 * place : 6 * place + 6] = label
    picture = mask_picture(LabelledDepth(view_of(np.full(SHAPE, 0.9)), labels)).astype(float)
    for place, colour in enumerate(colours.values()):
        stripe = picture[:, 6 * place + 1 : 6 * place + 5].reshape(-1, 3)
        assert len(np.unique(stripe, axis=0)) == 1  # between lines the colour depends on the label only
        np.testing.assert_allclose(hue_of(stripe)[0], unlit(colour), atol=0.01)
    first = picture[0, 6 * (FIRST_PART_LABEL + np.arange(8)) + 2]
    assert len(np.unique(first[:7], axis=0)) == 7  # parts of one scene differ
    assert np.array_equal(first[0], first[7])  # the eighth has the first colour
