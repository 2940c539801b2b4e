"""Images from several places settle on one shape at one pose, symmetric ones too; their motions are averaged."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from kit1000.known_shapes.registration import register_scene
from kit1000.known_shapes.several_images import PlacedScene, SeenPart, agreed_motions, one_part, rotated_like
from kit1000.known_shapes.shapes import ShapeDistance, StandingShape
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from tests.samples.labelled_scenes import sample_scene
from tests.samples.own_images import box

SHARP = SensorFacts(fattening_px=0.0)


@cache
def placed() -> PlacedScene:
    scene = sample_scene()
    parts = [scene.kits.shape(part.id) for part in scene.kits.parts]
    found = register_scene(scene.image, SHARP, scene.kits.kit_shape, parts)
    return PlacedScene(found, scene.image.view.world_from_camera)


def with_pose(name: str, standing: StandingShape) -> SeenPart:
    """The part of a name, in a scene in which it stands at a wrong place."""
    right = placed()
    wrong = replace(next(body for body in right.parts if body.name == name), standing=standing)
    bodies = tuple(wrong if body.name == name else body for body in right.scene.bodies)
    scene = PlacedScene(replace(right.scene, bodies=bodies), right.world_from_camera)
    return SeenPart(scene, wrong, scene.world_from(wrong), 0.0)


@pytest.mark.parametrize("count", [1, 3])
def test_the_pose_that_explains_all_images_replaces_a_wrong_one(count: int) -> None:
    """However many images are wrong, as one is right: what the images show decides, not their number."""
    right = next(body for body in placed().parts if body.name == "bracket")
    middle = placed().world_from(right).apply(right.standing.shape.mesh.bounds.mean(0))
    good = placed().seen(middle)
    assert good is not None
    flipped = right.standing.at(right.standing.place + (0.0, 0.0, np.pi))
    seen = one_part([*(with_pose("bracket", flipped) for _ in range(count)), good])
    distance = ShapeDistance(right.standing.shape.mesh)
    assert len(seen) == count + 1
    assert all(distance.between(part.world_from_part, good.world_from_part) < 1e-3 for part in seen)


def test_a_neighbour_of_a_part_that_an_image_misses_is_not_taken_for_it() -> None:
    bracket, tee = (next(body for body in placed().parts if body.name == name) for name in ("bracket", "tee"))
    there = SeenPart(placed(), bracket, placed().world_from(bracket), 0.0)
    beside = SeenPart(placed(), tee, placed().world_from(tee), 0.1)
    assert one_part([beside, there]) == [there]
    assert one_part([beside]) == [beside]
    assert one_part([]) == []


@pytest.mark.parametrize("degrees", [90.0, 180.0, -90.0])
@pytest.mark.parametrize("world", [Pose.identity(), Pose.from_rotvec((0.3, -1.0, 2.0), (0.5, 0.1, -0.2))])
def test_images_of_a_symmetric_part_agree_on_one_of_its_poses(degrees: float, world: Pose) -> None:
    """A square bar looks the same after a quarter turn; the pose keeps its middle and the surface its place."""
    bar = box((0.02, 0.02, 0.04), (0.03, 0.0))
    first = world @ Pose.from_rotvec((0.1, 0.0, 0.2), (0.1, 0.2, 0.0))
    middle = Pose.from_translation(bar.centroid)
    turned = Pose.from_rotvec((0.0, 0.0, np.radians(degrees + 2)))
    second = Pose.from_translation((1e-3, 0.0, 0.0)) @ first @ middle @ turned @ middle.inverse()
    found = rotated_like(second, first, bar)
    assert np.allclose(found.rotation_matrix(), first.rotation_matrix())
    assert np.allclose(found.apply(bar.centroid), second.apply(bar.centroid))


def test_poses_of_other_parts_and_near_poses_stay() -> None:
    bar, pose = box((0.02, 0.03, 0.04), (0.0, 0.0)), Pose.identity()
    for degrees in (5.0, 90.0):
        other = Pose.from_rotvec((0.0, 0.0, np.radians(degrees)))
        assert rotated_like(pose, other, bar) is pose


def test_images_that_agree_outvote_one_that_does_not() -> None:
    middle, right = np.array([0.1, 0.0, 0.02]), Pose.from_rotvec((0.0, 0.0, 1.0), (0.1, 0.2, 0.0))
    near = Pose.from_translation((1e-3, 0.0, 0.0)) @ right
    wrong = Pose.from_rotvec((0.0, 0.0, -2.0), (0.1, 0.2, 0.0))
    images = [[PredictedMotion(wrong, 0.6)], [PredictedMotion(right, 0.5)], [PredictedMotion(near, 0.5)]]
    best = agreed_motions(images, middle)[0]
    assert np.allclose(best.goal_from_now.xyz, right.xyz + (0.5e-3, 0.0, 0.0))
    assert best.confidence == pytest.approx(0.75)


def test_one_image_is_its_own_word() -> None:
    image = [PredictedMotion(Pose.identity(), 0.3), PredictedMotion(Pose.from_translation((0.1, 0.0, 0.0)), 0.2)]
    assert agreed_motions([image], np.zeros(3)) == image
    assert agreed_motions([], np.zeros(3)) == []


def test_an_image_without_motions_says_nothing() -> None:
    images = [[PredictedMotion(Pose.identity(), confidence)] for confidence in (0.3, 0.4)]
    for place in range(3):
        motions = agreed_motions([*images[:place], [], *images[place:]], np.zeros(3))
        assert [motion.confidence for motion in motions] == [0.58, 0.58]
    assert agreed_motions([[], images[0]], np.zeros(3)) == images[0]
    assert agreed_motions([[], []], np.zeros(3)) == []
