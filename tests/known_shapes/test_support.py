"""The plane under the bodies: found in measured depths, whatever the recorded pose says of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kit1000.errors import InputError
from kit1000.known_shapes.support import recorded_support, seen_support, standing_frame
from kit1000.pose import Pose
from kit1000.values import LabelledDepth
from tests.samples.labelled_scenes import NOISE, sample_scene


@pytest.mark.parametrize("scale", [1.0, 1.003])
def test_the_plane_is_that_of_the_measured_table(scale: float) -> None:
    scene = sample_scene(noise=0.3e-3, scale=scale)
    support = seen_support(scene.image)
    pose = scene.camera_from_world
    assert np.degrees(np.arccos(support.normal @ pose.rotate((0.0, 0.0, 1.0)))) < 0.05
    assert support.offset == pytest.approx(scale * float(pose.xyz @ support.normal), abs=0.3e-3)


def test_the_plane_does_not_follow_an_error_of_the_recorded_pose() -> None:
    scene = sample_scene()
    view = scene.image.view
    moved = replace(view, world_from_camera=Pose.from_translation((0.0, 0.0, 4e-3)) @ view.world_from_camera)
    here, there = seen_support(scene.image), seen_support(LabelledDepth(moved, scene.image.labels))
    assert here.offset == pytest.approx(there.offset, abs=1e-4)
    assert here.noise_at(0.7) == pytest.approx(NOISE, rel=0.35)


def test_the_recorded_plane_follows_the_recorded_pose() -> None:
    scene = sample_scene()
    view = scene.image.view
    moved = replace(view, world_from_camera=Pose.from_translation((0.0, 0.0, 4e-3)) @ view.world_from_camera)
    seen, recorded = seen_support(scene.image), recorded_support(LabelledDepth(moved, scene.image.labels))
    level = np.cross(recorded.normal, np.random.default_rng(0).normal(size=(9, 3)))
    on_plane = recorded.normal * recorded.offset + level
    assert np.allclose(moved.world_from_camera.apply(on_plane)[:, 2], 0.0, atol=1e-12)
    assert recorded.offset == pytest.approx(seen.offset - 4e-3, abs=0.3e-3)
    assert (recorded.noise, recorded.bend) == pytest.approx((seen.noise, seen.bend))


def test_the_bend_is_what_the_depths_of_the_table_share_over_a_part() -> None:
    scene = sample_scene()
    view = scene.image.view
    rows, columns = np.mgrid[: view.depth.shape[0], : view.depth.shape[1]]
    field = 2e-3 * np.sin(columns / 60) * np.cos(rows / 60)  # [1/m], of a root mean square of half as much
    bent = replace(view, depth=np.where(view.depth > 0, 1 / (1 / np.maximum(view.depth, 1e-6) + field), 0))
    flat, found = (seen_support(LabelledDepth(seen, scene.image.labels)) for seen in (view, bent))
    assert flat.bend < 0.3e-3
    assert found.bend == pytest.approx(1e-3, rel=0.35)
    assert flat.bend_share < 0.1 < found.bend_share


def test_the_frame_stands_on_the_plane() -> None:
    support = seen_support(sample_scene().image)
    frame = standing_frame(support, np.array([0.05, -0.02, 0.6]))
    assert np.allclose(frame.rotate((0.0, 0.0, 1.0)), support.normal)
    assert frame.xyz @ support.normal == pytest.approx(support.offset)


def test_an_image_without_table_is_refused() -> None:
    scene = sample_scene()
    far = replace(scene.image.view, depth=scene.image.view.depth * np.float32(1.5))
    with pytest.raises(InputError, match=r"pixels of the table .*expected \d+ or more"):
        seen_support(LabelledDepth(far, scene.image.labels))
