"""Corrections by a person: moves, fits, what is taken back, and that a moved body is confirmed anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kit1000.labelling.corrections import Correction
from kit1000.labelling.label_records import read_record
from kit1000.labelling.labelling_session import OwnScenes, publish
from kit1000.pose import Pose
from tests.samples.labelled_scenes import SCENE, own_folder, sample_scene, shapes_folder, true_record


@pytest.fixture
def correction(tmp_path: Path) -> Correction:
    source = shapes_folder(tmp_path / "shapes")
    scenes = OwnScenes.of(own_folder(tmp_path / "mine"))
    return Correction(scenes, true_record(sample_scene(), source, "A. Person"))


def position_mm(correction: Correction, name: str) -> float:
    """From the truth."""
    scene = sample_scene()
    true = scene.world_from_parts[[part.id for part in scene.kits.parts].index(name)]
    return 1e3 * float(np.linalg.norm(correction.world_from_body(name).xyz - true.xyz))


def test_a_moved_body_falls_into_place_again(correction: Correction) -> None:
    pose = correction.world_from_body("tee")
    correction.move("tee", Pose.from_translation((4e-3, -3e-3, 1e-3)) @ pose)
    assert position_mm(correction, "tee") == pytest.approx(np.linalg.norm([4, 3, 1]), abs=1e-6)
    assert correction.body("tee").doubts
    correction.fit("tee")
    assert position_mm(correction, "tee") < 1
    assert not correction.body("tee").doubts


def test_everything_can_be_taken_back(correction: Correction) -> None:
    first = correction.record
    correction.move("tee", Pose.from_translation((1e-2, 0.0, 0.0)))
    correction.fit("bracket")
    assert correction.take_back()
    assert correction.take_back()
    assert not correction.take_back()
    assert correction.record is first


def test_a_moved_body_must_be_confirmed_anew(correction: Correction) -> None:
    assert correction.record.confirmed
    correction.move("kits", correction.world_from_body("kits"))
    assert [body.confirmed_by for body in correction.record.bodies] == [None, "A. Person", "A. Person"]
    correction.confirm(["kits"], "B. Person")
    correction.save()
    saved = read_record(correction.scenes.root, SCENE)
    assert [body.confirmed_by for body in saved.bodies] == ["B. Person", "A. Person", "A. Person"]
    assert [body.moved for body in saved.bodies] == [True, False, False]
    assert publish(correction.scenes, [saved]) == []


def test_points_lie_on_the_bodies(correction: Correction) -> None:
    points, colours = correction.points()
    assert len(points) == len(colours) > 1000
    assert points[:, 2].min() > -6e-3
    assert points[:, 2].max() < 0.15
