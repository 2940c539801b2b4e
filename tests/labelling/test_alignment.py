"""Refinement of poses: from disturbed starts back to the truth, with masks that are too wide, and on the table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from kit1000.labelling.agreement import agreement
from kit1000.labelling.alignment import PlacedShape, align
from kit1000.labelling.body_windows import body_windows
from kit1000.labelling.standing_plane import seen_support
from kit1000.pose import Pose
from kit1000.values import LabelledDepth
from tests.samples.labelled_scenes import SampleScene, sample_scene

LABEL = 2  # the first part


def placed(scene: SampleScene, motion: Pose, image: LabelledDepth | None = None) -> tuple[PlacedShape, Pose]:
    """The first part moved off its true pose by a motion in its own frame, and that pose."""
    shape = scene.kits.shape(scene.kits.parts[0].id)
    window = body_windows(image or scene.image)[LABEL]
    true = scene.camera_from_world @ scene.world_from_parts[0]
    return PlacedShape(shape.mesh, window, true @ motion, 0.0, shape.downs), true


def off(found: Pose, true: Pose) -> tuple[float, float]:
    """[mm], [degrees]"""
    error = true.inverse() @ found
    return float(np.linalg.norm(error.xyz)) * 1e3, float(np.degrees(np.linalg.norm(error.rotvec())))


@pytest.mark.parametrize("seed", range(4))
def test_a_disturbed_pose_comes_back(seed: int) -> None:
    scene, rng = sample_scene(), np.random.default_rng(seed)
    motion = Pose.from_rotvec(rng.normal(0, 0.08, 3), rng.normal(0, 2.5e-3, 3))
    shape, true = placed(scene, motion)
    support = seen_support(scene.image)
    found = align([shape], support, fixed_scale=True).shapes[0]
    position, rotation = off(found.camera_from_body, true)
    assert position < 0.7
    assert rotation < 1.0
    assert agreement(found, support).cost < agreement(shape, support).cost


def test_a_mask_that_is_too_wide_moves_nothing() -> None:
    scene = sample_scene()
    wide = np.where(binary_dilation(scene.image.labels == LABEL, iterations=3), LABEL, scene.image.labels)
    image = LabelledDepth(scene.image.view, wide.astype(np.uint8))
    shape, true = placed(scene, Pose.from_translation((1e-3, -1e-3, 0.0)), image)
    found = align([shape], seen_support(image), fixed_scale=True).shapes[0]
    assert off(found.camera_from_body, true)[0] < 0.9
    assert 1.5 < found.width < 4.0


def test_the_true_pose_stays() -> None:
    scene = sample_scene(noise=0.0)
    shape, true = placed(scene, Pose.identity())
    found = align([shape], seen_support(scene.image), fixed_scale=True).shapes[0]
    position, rotation = off(found.camera_from_body, true)
    assert position < 0.25
    assert rotation < 0.3


def test_a_body_that_stands_on_the_table_is_put_on_it() -> None:
    scene = sample_scene()
    support = seen_support(scene.image)
    lifted = Pose.from_translation(2e-3 * support.normal)
    shape, _ = placed(scene, Pose.identity())
    shape = replace(shape, camera_from_body=lifted @ shape.camera_from_body)
    found = align([shape], support, fixed_scale=True).shapes[0]
    lowest = (found.camera_from_body.apply(found.mesh.vertices) @ support.normal).min() - support.offset
    assert abs(lowest) < 0.3e-3


@pytest.mark.parametrize("bend", [1e-3, 2e-3, 4e-3])
def test_bent_depths_move_a_body_less_than_its_spread_tells(bend: float) -> None:
    scene = sample_scene()
    view = scene.image.view
    columns = np.arange(view.depth.shape[1])
    field = bend * np.sqrt(2) * np.sin(columns / 60)  # [1/m]
    depth = np.where(view.depth > 0, 1 / (1 / np.maximum(view.depth, 1e-6) + field), 0).astype(np.float32)
    image = LabelledDepth(replace(view, depth=depth), scene.image.labels)
    shape, true = placed(scene, Pose.from_translation((0.5e-3, -0.5e-3, 0.0)), image)
    flat = align([placed(scene, Pose.identity())[0]], seen_support(scene.image), fixed_scale=True).shapes[0]
    found = align([shape], seen_support(image), fixed_scale=True).shapes[0]
    assert off(found.camera_from_body, true)[0] < 1e3 * max(2 * found.spread, 0.7e-3)
    assert found.spread > flat.spread
