"""Depth images and masks as pictures: holes in INK, near brighter and warmer than far, masks coloured by label."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.camera import Camera
from kit1000.pictures.depth_images import (
    FAR_COLOUR,
    MIDDLE_COLOUR,
    NEAR_COLOUR,
    depth_picture,
    mask_picture,
    surface_light,
    surface_normals,
)
from kit1000.pictures.shading import INK, KIT, PART, SECONDARY, TABLE
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

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


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 1.0))
def test_holes_are_ink(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    depth = np.where(rng.random(SHAPE) < share, 0, rng.uniform(0.5, 1.5, SHAPE))
    image = LabelledDepth(view_of(depth), rng.integers(0, 9, SHAPE).astype(np.uint8))
    for picture in (depth_picture(image.view), mask_picture(image)):
        assert picture.shape == (*SHAPE, 3)
        assert picture.dtype == np.uint8
        assert (picture[depth == 0] == INK).all()


def test_near_is_brighter_and_warmer_than_far() -> None:
    picture = depth_picture(view_of(steps(0.5, 0.7, 0.9, 1.1))).astype(float)
    inside = picture[5:-5, 8::16]  # the middle of each wall, away from the steps
    brightness, warmth = inside.sum(axis=-1), inside[..., 0] - inside[..., 2]
    assert (np.diff(brightness, axis=1) < 0).all()
    assert (warmth[:, 0] > 100).all()
    assert (warmth[:, 2:] < -40).all()


def test_the_ends_and_the_middle_of_the_scale_have_their_colours() -> None:
    hues = hue_of(depth_picture(view_of(steps(0.5, 1.0, 1.5, 0.5))).astype(float))[20, 8::16]
    for hue, colour in zip(hues, (NEAR_COLOUR, MIDDLE_COLOUR, FAR_COLOUR, NEAR_COLOUR), strict=True):
        np.testing.assert_allclose(hue, unlit(colour), atol=0.01)


@settings(max_examples=20)
@given(factor=st.floats(0.5, 3.0))
def test_the_scale_adapts_to_the_scene(factor: float) -> None:
    """A scene twice as far and twice as large gives the same picture, but for rounding."""
    v, u = np.indices(SHAPE)
    depth = 0.7 + 0.004 * u + 0.1 * np.sin(v / 7)
    one, other = (depth_picture(view_of(depth * scale)).astype(int) for scale in (1.0, factor))
    assert np.abs(one - other).max() <= 2


def test_a_constant_depth_gives_one_colour() -> None:
    picture = depth_picture(view_of(np.full(SHAPE, 0.8)))
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) == 1
    np.testing.assert_allclose(hue_of(picture.astype(float))[0, 0], unlit(NEAR_COLOUR), atol=0.01)


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


@pytest.mark.parametrize("label", [0, 1, 2, 9, 200, 255])
def test_every_label_has_a_colour(label: int) -> None:
    picture = mask_picture(LabelledDepth(view_of(np.full(SHAPE, 1.0)), np.full(SHAPE, label, np.uint8)))
    assert picture.max() > 20
