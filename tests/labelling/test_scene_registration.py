"""Registration of whole scenes: poses, names, doubts, and the depth scale."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from kit1000.errors import InputError
from kit1000.labelling import scene_registration
from kit1000.labelling.known_kits import KITS
from kit1000.labelling.scene_registration import RegisteredScene, ShapeDistance, register_scene
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth
from tests.samples.labelled_scenes import SampleScene, sample_scene

LABELS = range(FIRST_PART_LABEL, FIRST_PART_LABEL + 2)


@pytest.fixture(scope="module", autouse=True)
def _few_turns() -> Iterator[None]:
    """Bodies start in half as many turns: refining them takes most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_registration, "KIT_TURNS", 36)
        patch.setattr(scene_registration, "PART_TURNS", 18)
        yield


@pytest.fixture(scope="module")
def found() -> RegisteredScene:
    scene = sample_scene()
    parts = [scene.kits.shape(part.id) for part in reversed(scene.kits.parts)]  # in another order than the masks
    return register_scene(scene.image, scene.kits.kit_shape, parts)


def true_pose(scene: SampleScene, name: str) -> Pose:
    """camera_from_body."""
    if name == KITS:
        return scene.camera_from_world @ scene.world_from_assembly
    number = [part.id for part in scene.kits.parts].index(name)
    return scene.camera_from_world @ scene.world_from_parts[number]


def test_each_mask_gets_its_own_shape(found: RegisteredScene) -> None:
    names = [body.name for body in found.bodies]
    assert names == [KITS, "bracket", "tee"]
    assert [body.label for body in found.bodies] == [ASSEMBLY_LABEL, *LABELS]


def test_shapes_lie_where_they_are(found: RegisteredScene) -> None:
    scene = sample_scene()
    for body in found.bodies:
        error = true_pose(scene, body.name).inverse() @ body.placed.camera_from_body
        assert np.linalg.norm(error.xyz) < 0.8e-3, body.name
        assert np.degrees(np.linalg.norm(error.rotvec())) < 0.6, body.name
        surface = ShapeDistance(scene.kits.shape(body.name).mesh)
        assert surface.between(true_pose(scene, body.name), body.placed.camera_from_body) < 1e-3


def test_a_body_whose_image_settles_its_pose_has_no_doubts(found: RegisteredScene) -> None:
    assert [body.doubts(1e-4) for body in found.bodies] == [()] * 3
    assert any("distance is open" in doubt for doubt in found.bodies[0].doubts(5e-3))


@pytest.mark.slow
def test_the_sizes_of_the_shapes_tell_the_depth_scale() -> None:
    scene = sample_scene(noise=0.3e-3, scale=1.003)
    parts = [scene.kits.shape(part.id) for part in scene.kits.parts]
    registered = register_scene(scene.image, scene.kits.kit_shape, parts)
    assert registered.scale == pytest.approx(1.003, abs=3 * registered.scale_spread)
    assert registered.scale - 1 > 1.5e-3
    error = true_pose(scene, KITS).inverse() @ registered.bodies[0].placed.camera_from_body
    assert np.linalg.norm(error.xyz) < 1.2e-3  # uncorrected it would be 2 mm


def test_a_wrong_shape_is_in_doubt() -> None:
    scene = sample_scene()
    wrong = [scene.kits.shape("tee")]
    labels = np.where(scene.image.labels == LABELS[1], 0, scene.image.labels)  # the mask of the bracket is left
    image = LabelledDepth(scene.image.view, labels)
    registered = register_scene(image, scene.kits.kit_shape, wrong)
    assert registered.bodies[1].doubts(1e-4)
    kits = registered.bodies[0]
    assert np.linalg.norm((true_pose(scene, KITS).inverse() @ kits.placed.camera_from_body).xyz) < 1.5e-3
    assert abs(registered.scale - 1) < 2e-3  # by the kits alone
    assert any("wrong shapes" in doubt for doubt in kits.doubts(1e-4, scale=1.02))


def test_images_without_what_is_needed_are_refused() -> None:
    scene = sample_scene()
    view, labels = scene.image.view, scene.image.labels
    kits, parts = scene.kits.kit_shape, [scene.kits.shape(part.id) for part in scene.kits.parts]
    with pytest.raises(InputError, match="no kits"):
        register_scene(LabelledDepth(view, np.where(labels == ASSEMBLY_LABEL, 0, labels)), kits, parts)
    with pytest.raises(InputError, match=r"2 parts given.* 1"):
        register_scene(LabelledDepth(view, np.where(labels == LABELS[0], 0, labels)), kits, parts)
    with pytest.raises(InputError, match="table"):
        register_scene(LabelledDepth(view, np.ones_like(labels)), kits, [])
