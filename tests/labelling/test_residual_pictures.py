"""The picture for the person who confirms: signs of the residual, and what lies in one image alone."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from kit1000.labelling.residual_pictures import (
    AGREES,
    FARTHER,
    MISSING,
    NEARER,
    NO_RETURN,
    STRAY,
    DrawnBody,
    residual_colours,
    residual_picture,
)
from kit1000.values import LabelledDepth, View
from tests.samples.labelled_scenes import SMALL, sample_scene


def test_colours_say_what_is_nearer_farther_and_in_one_image_alone() -> None:
    scene = sample_scene()
    depth, labels = np.full(scene.image.labels.shape, 0.7, np.float32), np.zeros_like(scene.image.labels)
    labels[:5], depth[1, :] = 1, 0.69
    depth[2], depth[3] = 0.71, 0.0
    rendered = np.zeros(depth.shape)
    rendered[:4], rendered[6] = 0.7, 0.7
    image = LabelledDepth(View(SMALL, scene.image.view.world_from_camera, depth), labels)
    colours = residual_colours(image, rendered, 1.0)
    rows = {0: AGREES, 1: NEARER, 2: FARTHER, 3: NO_RETURN, 4: STRAY, 6: MISSING}
    for row, colour in rows.items():
        assert np.abs(colours[row, 10].astype(int) - colour).max() <= 1, row


def test_the_picture_is_a_png_of_both_views_with_our_mark() -> None:
    scene = sample_scene()
    bodies = [DrawnBody("kits", 1, scene.kits.assembly.mesh, scene.camera_from_world @ scene.world_from_assembly)]
    png = residual_picture(scene.image, bodies, 1.0, "test-s0000")
    picture = Image.open(io.BytesIO(png))
    assert picture.width > 2 * picture.height
    assert b"kit1000" in png[:256]
    assert png == residual_picture(scene.image, bodies, 1.0, "test-s0000")
