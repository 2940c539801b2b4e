"""A sensor is a value with its facts: calibration uses only what they say that the image shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kit1000.camera import Camera, look_at
from kit1000.errors import InputError
from kit1000.perception.calibration import OUTLINE, calibrated_by
from kit1000.perception.calibration.camera_pose import borders_of
from kit1000.perception.calibration.table import flattened
from kit1000.perception.image_kinds import D415, PHOTONEO, RESTORED
from kit1000.perception.restoration import restored
from kit1000.perception.segmentation.instances import find_bodies
from kit1000.perception.sensor_facts import KEY, SensorFacts, sensor_of, simulated_sensor
from kit1000.pose import Pose
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.sim.sensors import SENSORS
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

CAMERA = Camera(640, 360, 462.5, 462.5, 319.5, 179.5)
EYE = look_at((0.1, -0.6, 0.6), (0.0, 0.05, 0.0))
OWN = SensorFacts("D435", baseline=0.05, stream="aligned", simulated_table=False, noise_px=0.05)
PHOXI = SensorFacts("PhoXi", baseline=0.225, fattening_px=0.0, simulated_table=False, noise_px=0.06, scanner=True)


@pytest.fixture(scope="module")
def view() -> View:
    """A table with nothing on it, whose left 60 columns have no return, as in an aligned image."""
    depth = render(CAMERA, EYE, [(table(), Pose.identity())]).depth.copy()
    depth[:, :60] = 0
    return View(CAMERA, EYE, depth)


def test_facts_are_read_back_as_they_were_stored() -> None:
    summary = {KEY: {"d415": OWN.as_row()}}
    assert sensor_of(summary, "d415") == OWN
    assert sensor_of({KEY: {"photoneo": PHOXI.as_row()}}, "photoneo") == PHOXI
    earlier = {name: value for name, value in OWN.as_row().items() if name != "scanner"}
    assert sensor_of({KEY: {"d415": earlier}}, "d415") == OWN
    assert sensor_of(summary, "ideal") == simulated_sensor("ideal")
    assert sensor_of({}, "d415") == simulated_sensor("d415") == SensorFacts()
    with pytest.raises(InputError, match="import again"):
        sensor_of({KEY: {"d415": {"colour": "blue"}}}, "d415")


def test_borders_are_those_that_the_image_shows() -> None:
    assert borders_of(SensorFacts()) == OUTLINE
    assert [borders_of(sensor) for sensor in (OWN, simulated_sensor("photoneo"), PHOXI)] == [(), (), ()]


def test_the_kind_of_an_image_follows_from_the_facts_of_its_sensor(view: View) -> None:
    simulated = [simulated_sensor(name) for name in SENSORS]
    assert [sensor.kind.name for sensor in simulated] == list(SENSORS)
    assert [sensor.kind for sensor in (OWN, PHOXI)] == [D415, PHOTONEO]
    assert [sensor.kind.exact for sensor in simulated] == [True, False, False]
    assert D415.best is RESTORED
    assert PHOTONEO.best is PHOTONEO
    assert find_bodies(view, PHOXI).kind is PHOTONEO


def test_holes_on_kits_of_a_scanner_stay_and_those_on_parts_are_closed(view: View) -> None:
    labels = np.zeros(view.depth.shape, np.uint8)
    labels[150:220, 200:300], labels[150:220, 350:450] = ASSEMBLY_LABEL, FIRST_PART_LABEL
    depth = view.depth.copy()
    depth[labels > 0] -= 0.03
    depth[180:190, 240:250] = depth[180:190, 390:400] = 0
    image = LabelledDepth(replace(view, depth=depth), labels)
    scanned, stereo = (restored(image, sensor).view.depth for sensor in (PHOXI, OWN))
    assert (scanned[180:190, 240:250] == 0).all()
    assert (scanned[180:190, 390:400] > 0).all()
    assert (stereo[180:190, 240:250] > 0).all()


def test_an_image_of_an_unknown_table_moves_no_camera(view: View) -> None:
    nothing = np.zeros(view.depth.shape, np.uint8)
    right = calibrated_by(view, nothing, OWN)
    assert np.sqrt(((right.world_from_camera.xyz - EYE.xyz) ** 2).sum()) < 0.2e-3
    assert (right.world_from_camera.inverse() @ EYE).angle() < 1e-3


def test_a_wall_beside_the_table_moves_no_camera(view: View) -> None:
    """Its foot is within the reach of a simulated table, not of one that was found in the image itself."""
    depth = view.depth.copy()
    depth[:150] = np.where(depth[:150] > 0, depth[:150] * np.float32(0.98), 0)
    moved = []
    for sensor in (OWN, replace(OWN, simulated_table=True)):
        right = calibrated_by(replace(view, depth=depth), np.zeros(depth.shape, np.uint8), sensor)
        moved.append(float(np.sqrt(((right.world_from_camera.xyz - EYE.xyz) ** 2).sum())))
    assert moved[0] < 0.2e-3
    assert moved[1] > moved[0]


def test_of_an_unknown_table_only_what_is_near_its_plane_is_put_on_it(view: View) -> None:
    nothing = np.zeros(view.depth.shape, np.uint8)
    depth = view.depth.copy()
    depth[200:220, 300:320] = 2.0  # the floor, through a hole
    flat = flattened(replace(view, depth=depth), nothing, simulated=False).depth
    assert (flat[200:220, 300:320] == 2).all()
    np.testing.assert_allclose(flat[250:300, 100:500], view.depth[250:300, 100:500], atol=1e-5)
    assert (flat[:, :60] > 0).any()  # without a return: on the plane
