"""An MJCF scene has the bodies of its scene where they are, and MuJoCo, if installed, sees and keeps them there."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.export import export
from kit1000.pose import Pose
from kit1000.sim.world import FRICTION


@pytest.fixture(scope="module")
def recorded(mini: Path) -> RecordedScene:
    return next(iter(Dataset(mini).split("test-all", truth=True)))


@pytest.fixture(scope="module")
def scene(mini: Path, recorded: RecordedScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mjcf")
    export(mini, "mjcf", out, [recorded.id])
    return out / recorded.id / "scene.xml"


def floats(text: str) -> np.ndarray:
    return np.array([float(word) for word in text.split()])


def pose_of(element: ElementTree.Element) -> Pose:
    return Pose(floats(element.attrib["quat"]), floats(element.attrib["pos"]))


def test_bodies_stand_where_they_do(scene: Path, recorded: RecordedScene) -> None:
    bodies = ElementTree.parse(scene).getroot().findall("worldbody/body")
    assert [body.attrib["name"] for body in bodies] == [
        "assembly",
        *(f"p{i}" for i in range(len(recorded.scene.bodies) - 1)),
    ]
    for body, true in zip(bodies, recorded.scene.bodies, strict=True):
        np.testing.assert_array_equal(pose_of(body).matrix(), true.world_from_body.matrix())
    assert [body.find("freejoint") is not None for body in bodies] == [False] + [True] * (len(bodies) - 1)


def test_masses_and_friction_are_ours(scene: Path, recorded: RecordedScene) -> None:
    root, geometry = ElementTree.parse(scene).getroot(), recorded.split.dataset.geometry
    masses = [float(each.attrib["mass"]) for each in root.findall("worldbody/body/inertial")]
    assert masses[1:] == [geometry.part(body.id).mass for body in recorded.scene.bodies[1:]]
    friction = {each.attrib["friction"] for each in root.iter("geom") if "friction" in each.attrib}
    assert {floats(text)[0] for text in friction} == {FRICTION**2}


def test_every_goal_is_a_site(scene: Path, recorded: RecordedScene) -> None:
    assembly = recorded.split.dataset.geometry.assembly(recorded.scene.bodies[0].id)
    sites = [pose_of(site).matrix() for site in ElementTree.parse(scene).getroot().findall("worldbody/body/site")]
    goals = [mount.assembly_from_kit @ goal for mount in assembly.mounts for goal in mount.kit.slot.goals]
    np.testing.assert_allclose(sites, [goal.matrix() for goal in goals], atol=1e-12)


def test_the_file_says_what_its_pieces_measure(scene: Path, recorded: RecordedScene) -> None:
    comment = scene.read_text(encoding="utf-8").partition("<!--")[2].partition("-->")[0]
    for body in recorded.scene.bodies[1:]:
        assert f"{body.id}: part " in comment
    assert "clearance left 2." in comment or "clearance left 1." in comment


def test_mujoco_sees_the_scene_and_leaves_it_at_rest(scene: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    before = data.qpos.copy()
    mujoco.mj_step(model, data, nstep=300)
    assert np.abs(data.qpos - before).max() < 1e-3


def test_an_unknown_scene_and_an_existing_folder_are_refused(mini: Path, scene: Path) -> None:
    with pytest.raises(InputError, match="test-s9999"):
        export(mini, "mjcf", scene.parents[1], ["test-s9999"])
    with pytest.raises(InputError, match="exists already"):
        export(mini, "mjcf", scene.parents[1], [scene.parent.name])
