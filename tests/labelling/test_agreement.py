"""How well a pose explains an image: worse the farther it is off, and faults that name what is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kit1000.labelling.agreement import agreement
from kit1000.labelling.alignment import PlacedShape
from kit1000.labelling.body_windows import body_windows
from kit1000.labelling.standing_plane import seen_support
from kit1000.pose import Pose
from tests.samples.labelled_scenes import sample_scene


def test_the_cost_grows_with_the_error() -> None:
    scene = sample_scene()
    support, window = seen_support(scene.image), body_windows(scene.image)[1]
    true = scene.camera_from_world @ scene.world_from_assembly
    shape = PlacedShape(scene.kits.assembly.mesh, window, true)
    costs = []
    for shift in (0.0, 3e-3, 8e-3, 20e-3):
        moved = replace(shape, camera_from_body=Pose.from_translation((shift, 0.0, 0.0)) @ true)
        costs.append(agreement(moved, support).cost)
    assert costs == sorted(costs)
    assert agreement(shape, support).faults == ()


def test_a_pose_outside_the_window_explains_nothing() -> None:
    scene = sample_scene()
    window = body_windows(scene.image)[2]
    away = PlacedShape(scene.kits.parts[0].mesh, window, Pose.from_translation((3.0, 0.0, 0.7)))
    fit = agreement(away, seen_support(scene.image))
    assert fit.cost == 1.0
    assert not np.isfinite(fit.depth)
    assert fit.faults
