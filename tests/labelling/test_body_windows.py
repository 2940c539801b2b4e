"""Windows of bodies: signed distances, cameras that see the same pixels, and what belongs to other bodies."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.camera import Camera
from kit1000.labelling.body_windows import MARGIN, body_windows
from kit1000.pose import Pose
from kit1000.values import LabelledDepth, View

CAMERA = Camera(90, 70, 80.0, 81.0, 44.0, 35.5)


def windows_of(labels: np.ndarray):
    depth = np.full(labels.shape, 0.7, np.float32)
    return body_windows(LabelledDepth(View(CAMERA, Pose.identity(), depth), labels))


@settings(max_examples=25)
@given(st.integers(0, 55), st.integers(0, 75), st.integers(2, 15), st.integers(2, 15))
def test_the_distance_is_zero_on_the_border_between_pixels(top: int, left: int, tall: int, wide: int) -> None:
    labels = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    labels[top : top + tall, left : left + wide] = 2
    window = windows_of(labels)[2]
    assert ((window.distance < 0) == window.mask).all()
    assert np.abs(window.distance).min() == 0.5
    row = top - window.corner[0]
    if left > 0 and left - window.corner[1] > 0:
        before = window.distance[row, left - window.corner[1] - 1 : left - window.corner[1] + 1]
        assert before.tolist() == [0.5, -0.5]


def test_a_window_sees_the_points_of_the_image() -> None:
    labels = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    labels[40:60, 30:50] = 3
    window = windows_of(labels)[3]
    assert window.corner == (40 - MARGIN, 30 - MARGIN)
    whole = CAMERA.unproject(np.full(labels.shape, 0.7))[labels == 3]
    assert np.allclose(window.points, whole, atol=1e-7)


def test_pixels_near_another_body_are_its_own() -> None:
    labels = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    labels[20:40, 20:40], labels[20:40, 41:60] = 1, 2
    window = windows_of(labels)[1]
    assert window.others[25, 41 - window.corner[1]]
    assert not window.others[window.mask].any()
    assert not window.others[:, : 20 - window.corner[1]].any()


def test_the_gradient_points_out_of_the_mask() -> None:
    labels = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    labels[25:45, 30:60] = 1
    window = windows_of(labels)[1]
    right = np.array([[60.0 - 0.5 - window.corner[1], 35.0 - window.corner[0]]])
    distance, gradient = window.distances_at(right)
    assert abs(distance[0]) < 1e-9
    assert gradient[0, 0] > 0.9
    assert abs(gradient[0, 1]) < 0.1
