"""A fit leads back to the true place, from as far off as a search leaves a shape, and by edges that a sensor moved."""

from __future__ import annotations

import numpy as np
import pytest

from kit1000.known_shapes.disparity import DisparityImage
from kit1000.known_shapes.fit import fit
from kit1000.known_shapes.known_kits import KITS
from kit1000.known_shapes.shapes import StandingShape
from kit1000.known_shapes.support import seen_support
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.rng import stream
from kit1000.sim.sensors import sense
from kit1000.values import LabelledDepth
from tests.samples.labelled_scenes import sample_scene


@pytest.mark.parametrize("yaw", [-2.0, 2.0])
@pytest.mark.parametrize("xy", [(0.0, 0.0), (5e-3, -4e-3)])
def test_kits_come_back_to_their_place(yaw: float, xy: tuple[float, float]) -> None:
    scene = sample_scene(noise=0.0)
    view = sense("d415", scene.image.view, stream(0, "fit"))
    seen = LabelledDepth(view, scene.image.labels)
    image = DisparityImage.of(seen, SensorFacts(), seen_support(seen))
    pose = view.world_from_camera.inverse() @ scene.world_from_assembly
    true = StandingShape.by_pose(scene.kits.shape(KITS), image.support, pose)
    best = fit(image, true).shape
    found = fit(image, best.at(best.place + (*xy, np.radians(yaw)))).shape
    assert np.hypot(*(found.place - best.place)[:2]) < 1e-3
    assert abs(np.degrees(found.place[2] - best.place[2])) < 0.4
