"""Registration of known shapes in whole scenes: poses, names, doubts, the depth scale, and masks that are wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from kit1000.errors import InputError
from kit1000.known_shapes.height_search import HeightGrid, Place
from kit1000.known_shapes.known_kits import KITS
from kit1000.known_shapes.registration import RegisteredScene, agreement, register_scene
from kit1000.known_shapes.shapes import KnownShape
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth
from tests.samples.labelled_scenes import SampleScene, sample_scene

SHARP = SensorFacts(fattening_px=0.0)
LABELS = range(FIRST_PART_LABEL, FIRST_PART_LABEL + 2)


def registered(scene: SampleScene, labels: np.ndarray | None = None, names: tuple[str, ...] = ()) -> RegisteredScene:
    image = scene.image if labels is None else LabelledDepth(scene.image.view, labels)
    parts = [scene.kits.shape(name) for name in names or [part.id for part in reversed(scene.kits.parts)]]
    return register_scene(image, SHARP, scene.kits.kit_shape, parts)


@cache
def found() -> RegisteredScene:
    return registered(sample_scene())


def error_of(scene: SampleScene, result: RegisteredScene, name: str) -> Pose:
    """From the true pose."""
    numbers = {part.id: i for i, part in enumerate(scene.kits.parts)}
    true = scene.world_from_assembly if name == KITS else scene.world_from_parts[numbers[name]]
    body = next(body for body in result.bodies if body.name == name)
    return (scene.camera_from_world @ true).inverse() @ result.camera_from_body(body)


def assert_in_place(scene: SampleScene, result: RegisteredScene) -> None:
    for body in result.bodies:
        error = error_of(scene, result, body.name)
        assert np.linalg.norm(error.xyz) < 1e-3, body.name
        assert np.degrees(error.angle()) < 1, body.name


def test_shapes_are_found_over_their_own_masks() -> None:
    assert {body.name: body.label for body in found().bodies} == {
        KITS: ASSEMBLY_LABEL,
        "bracket": LABELS[0],
        "tee": LABELS[1],
    }
    assert_in_place(sample_scene(), found())


def test_a_body_whose_image_settles_its_pose_has_no_doubts() -> None:
    assert not any(body.agreement.faults for body in found().bodies)


def _joined_parts(labels: np.ndarray) -> np.ndarray:
    return np.where(labels == LABELS[1], LABELS[0], labels)


def _kits_cut_into(labels: np.ndarray) -> np.ndarray:
    cut = labels.copy()
    rows, columns = np.nonzero(labels == ASSEMBLY_LABEL)
    cut[rows.min() : rows.min() + 40, : int(np.median(columns))] = 0
    return cut


@pytest.mark.parametrize("wrong", [_joined_parts, _kits_cut_into])
def test_wrong_masks_move_no_body(wrong: Callable[[np.ndarray], np.ndarray]) -> None:
    scene = sample_scene()
    assert_in_place(scene, registered(scene, wrong(scene.image.labels)))


def test_kits_are_found_although_their_heights_mislead(monkeypatch: pytest.MonkeyPatch) -> None:
    proposed = HeightGrid.places

    def misled(self: HeightGrid, shape: KnownShape, *args: Any) -> list[Place]:
        places = proposed(self, shape, *args)
        if shape.name != KITS:
            return places
        return [Place(score, each.at(each.place + (40e-3, -40e-3, 0.0))) for score, each in places[:1]]

    monkeypatch.setattr(HeightGrid, "places", misled)
    assert_in_place(sample_scene(), registered(sample_scene()))


def test_a_part_without_a_mask_is_found_and_in_doubt() -> None:
    scene = sample_scene()
    result = registered(scene, np.where(scene.image.labels == LABELS[1], 0, scene.image.labels))
    assert_in_place(scene, result)
    (tee,) = (body for body in result.bodies if body.name == "tee")
    assert tee.label == 0
    assert "no mask shows it alone" in result.doubts(tee)


def test_a_wrong_shape_is_in_doubt() -> None:
    scene = sample_scene()
    labels = np.where(scene.image.labels == LABELS[1], 0, scene.image.labels)  # the mask of the bracket is left
    depth = np.where(scene.image.labels == LABELS[1], 0, scene.image.view.depth)  # and the tee is not there
    view = type(scene.image.view)(scene.image.view.camera, scene.image.view.world_from_camera, depth.astype(np.float32))
    result = register_scene(LabelledDepth(view, labels), SHARP, scene.kits.kit_shape, [scene.kits.shape("tee")])
    assert all(result.doubts(body) for body in result.bodies if body.name == "tee")
    assert np.linalg.norm(error_of(scene, result, KITS).xyz) < 1.5e-3


@pytest.mark.parametrize("scale", [0.997, 1.003])
def test_sizes_tell_the_depth_scale_of_a_sharp_image(scale: float) -> None:
    scene = sample_scene(noise=0.3e-3, scale=scale)
    result = registered(scene)
    assert result.scale == pytest.approx(scale, abs=3 * result.scale_spread)
    assert abs(result.scale - scale) < abs(1 - scale)


def motion_at(result: RegisteredScene, scale: float) -> Pose:
    """From the first part to the kits in the camera frame, by a depth scale."""
    kits, part = (body.standing.camera_from_body(scale) for body in result.bodies[:2])
    return kits @ part.inverse()


def test_a_motion_is_left_open_by_what_the_depth_scale_changes() -> None:
    result = found()
    part, motion = result.bodies[1], motion_at(result, result.scale)
    middle = result.camera_from_body(part).apply(part.standing.shape.mesh.centroid)
    by = 1e-3
    changed = motion_at(result, result.scale * (1 + by)).apply(middle) - motion.apply(middle)
    expected = result.scale_spread * np.linalg.norm(changed) / by
    assert result.left_open(motion) == pytest.approx(expected, rel=0.15)  # bodies keep their own size


@pytest.mark.parametrize("wrong", [0, 1])
def test_a_motion_is_in_doubt_if_kits_or_part_are(wrong: int) -> None:
    result = found()
    motion = motion_at(result, result.scale)
    sharp = replace(result, scale_spread=1e-4)
    assert not sharp.motion_doubts(result.bodies[1], motion)
    assert replace(result, scale_spread=1e-2).motion_doubts(result.bodies[1], motion)
    bodies = [*result.bodies]
    bodies[wrong] = replace(bodies[wrong], agreement=replace(bodies[wrong].agreement, unexplained=0.5))
    assert replace(sharp, bodies=tuple(bodies)).motion_doubts(bodies[1], motion)


def test_the_less_is_seen_of_a_part_the_less_sure_is_its_motion() -> None:
    result = replace(found(), scale_spread=1e-4)
    part, motion = result.bodies[1], motion_at(result, result.scale)
    spreads, sure = [part.agreement.spread], [result.confidence(part, motion)]
    across = np.nonzero(sample_scene().image.labels == part.label)[1]
    for share in (50, 80):  # of its columns, from the right, that have no return
        measured = result.image.measured.copy()
        measured[:, int(np.percentile(across, 100 - share)) :] = 0
        left = agreement(replace(result.image, measured=measured), part.standing, (), result.scale)
        spreads.append(left.spread)
        hidden = replace(part, agreement=replace(part.agreement, spread=left.spread))
        sure.append(result.confidence(hidden, motion))
    assert spreads[0] < spreads[1] < spreads[2]
    assert sure[0] > sure[1] > sure[2]


def test_images_without_what_is_needed_are_refused() -> None:
    scene = sample_scene()
    view, labels = scene.image.view, scene.image.labels
    bare = np.where(labels > 0, 0, view.depth).astype(np.float32)
    with pytest.raises(InputError, match="nothing stands"):
        register_scene(
            LabelledDepth(type(view)(view.camera, view.world_from_camera, bare), labels),
            SHARP,
            scene.kits.kit_shape,
            [],
        )
    with pytest.raises(InputError, match="table"):
        registered(scene, np.ones_like(labels))
