"""Depth images that are the median of several frames: noise that changes in time is smaller, the rest is as in one."""

from __future__ import annotations

import numpy as np
import pytest

from kit1000.camera import Camera
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.sensors import SENSORS, sense, sensor_of_frames
from kit1000.values import View

CAMERA = Camera(320, 240, 925.0, 925.0, 159.5, 119.5)
D415 = SENSORS["d415"]


def tilted_plane() -> View:
    """A plane that rises from left to right, with a hole."""
    depth = np.tile(np.linspace(0.6, 0.9, CAMERA.width, dtype=np.float32), (CAMERA.height, 1))
    depth[100:120, 200:240] = 0
    return View(CAMERA, Pose.identity(), depth)


@pytest.mark.parametrize("frames", [1, 5, 50])
def test_noise_of_a_median_of_frames_is_that_of_drawn_frames(frames: int) -> None:
    """A fixed field and one that changes in time, of which the median of some frames is taken."""
    rng, fixed = np.random.default_rng(frames), D415.fixed_noise
    drawn = np.sqrt(1 - fixed**2) * np.median(rng.standard_normal((frames, 20_000)), axis=0)
    expected = D415.noise_px * (drawn + fixed * rng.standard_normal(20_000)).std()
    assert sensor_of_frames(D415, frames).noise_px == pytest.approx(expected, rel=0.05)


def test_frames_change_only_the_noise() -> None:
    view = tilted_plane()
    one, many = sense("d415", view, stream(2)), sense("d415", view, stream(2), frames=50)
    np.testing.assert_array_equal(one.depth == 0, many.depth == 0)
    np.testing.assert_array_equal(one.world_from_camera.matrix(), many.world_from_camera.matrix())
    for name in ("ideal", "photoneo"):
        again = sense(name, view, stream(2), frames=50)
        np.testing.assert_array_equal(sense(name, view, stream(2)).depth, again.depth)


def test_no_frame_is_no_image() -> None:
    view = tilted_plane()
    with pytest.raises(InputError, match="frames: expected 1 or more, got 0"):
        sense("d415", view, stream(2), frames=0)
