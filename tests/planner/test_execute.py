"""The robot in generated scenes: each outcome provoked once, traces, and files of a run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.cli import main
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.kits.convex_pieces import TOLERANCE, enclosing_prisms
from kit1000.kits.seating import HOVER
from kit1000.mesh import convex_hull, solid_from_mesh
from kit1000.planner import execute, planning
from kit1000.planner.execute import OUTCOMES, SceneRun, run_scene
from kit1000.planner.motion import LINE_SPEED, MOVE_SPEED
from kit1000.planner.robot import HOME, JOINT_SPEED, tool_pose, within_limits
from kit1000.planner.runs import run_predictions
from kit1000.planner.trace import read_trace, state_at, trace_bytes
from kit1000.pose import Pose
from kit1000.submission.predictions import write_predictions
from kit1000.values import Prediction
from tests.samples.kits import sample_part

pytest.importorskip("pybullet")
UP = np.array([0.0, 0.0, 1.0])


class Case:
    """A scene, one of its upright parts, its true motion, and the run of the robot that seats it."""

    def __init__(self, scene: RecordedScene, part: int, query_id: str, motion: Pose, run: SceneRun) -> None:
        self.scene, self.part, self.query_id, self.motion, self.run = scene, part, query_id, motion, run

    def outcome(self, motion: Pose) -> str:
        return run_scene(self.scene, {self.part: motion}).parts[0].outcome


@pytest.fixture(scope="module", autouse=True)
def _few_ways() -> Iterator[None]:
    """The hand takes a part in fewer ways, each of which is a matter of a tenth of a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planning, "YAWS", 4)
        patch.setattr(planning, "DIRECT_TRIES", 3)
        yield


@pytest.fixture(scope="module")
def case(mini: Path) -> Case:
    dataset = Dataset(mini)
    scene_ids = [i for ids in dataset.summary["shards"].values() for i in ids]
    for scene_id in scene_ids:
        scene = dataset.recorded_scene(scene_id, truth=True)
        for query in scene.queries:
            if query.track == "place":
                motion = scene.truth_of(query.id).goal_drawn
                run = run_scene(scene, {query.part: motion})
                if run.parts[0].outcome == "seated":
                    return Case(scene, query.part, query.id, motion, run)
    raise AssertionError("no part of the small dataset is seated")


def test_with_the_true_motion_the_part_is_seated(case: Case) -> None:
    part = case.run.parts[0]
    assert case.run.order == (case.part,)
    assert abs(part.physics["height_mm"]) < 3
    assert part.physics["angle_deg"] < 10
    assert 10 < part.seconds < 90


@pytest.mark.parametrize(
    ("error", "outcomes"),
    [
        (Pose.from_translation([1.5, 0, 0]), {"unreachable"}),
        (Pose.from_rotvec([np.pi, 0, 0], [0, 0, 0.5]), {"not graspable from above"}),
        (Pose.from_translation([0.012, 0, 0]), {"jammed", "tipped", "not seated"}),
        (Pose.from_translation([0, -0.45, -0.3]), {"collision", "unreachable"}),
    ],
)
def test_wrong_motions_have_the_outcome_that_they_provoke(case: Case, error: Pose, outcomes: set[str]) -> None:
    assert case.outcome(error @ case.motion) in outcomes


def test_a_part_without_a_flat_spot_has_no_seal(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execute, "touch", lambda *_: None)
    assert case.outcome(case.motion) == "no seal"
    monkeypatch.setattr(execute, "find_grasps", lambda *_: [])
    (part,) = run_scene(case.scene, {case.part: case.motion}).parts
    assert (part.outcome, part.grasps, part.seconds) == ("no seal", 0, 0.0)


def test_the_arm_moves_from_home_without_jumps_within_its_limits(case: Case) -> None:
    now, joints = 0.0, HOME
    for event in case.run.events:
        assert event.start >= now - 1e-9
        if event.leg is None:
            continue
        leg = event.leg
        assert leg.joints[0] == pytest.approx(joints)
        assert within_limits(leg.joints).all()
        steps, seconds = np.abs(np.diff(leg.joints, axis=0)), np.diff(leg.seconds)[:, None]
        assert (steps <= JOINT_SPEED * seconds * (1 + 1e-9)).all()
        if leg.name in ("reach", "carry"):
            assert (steps <= MOVE_SPEED * seconds * (1 + 1e-6)).all()
        now, joints = event.start + leg.duration, leg.joints[-1]


def test_the_part_goes_in_along_a_line_of_100_mm_that_ends_at_the_prediction(case: Case) -> None:
    grasp = next(event for event in case.run.events if event.kind == "grasp")
    leg = next(event.leg for event in case.run.events if event.leg is not None and event.leg.name == "insert")
    assert grasp.pose is not None
    path = case.run.world_from_base @ tool_pose(leg.joints) @ grasp.pose
    goal = case.motion @ case.scene.scene.bodies[1 + case.part].world_from_body
    assert path[-1].xyz == pytest.approx(goal.xyz, abs=1e-6)
    assert (path[-1].inverse() @ goal).angle() < 1e-6
    out = case.motion.rotate(UP)
    assert path[0].xyz - path[-1].xyz == pytest.approx(HOVER * out, abs=1e-6)
    aside = (path.xyz - goal.xyz) - np.outer((path.xyz - goal.xyz) @ out, out)
    assert np.abs(aside).max() < 1e-6
    speed = np.linalg.norm(np.diff(path.xyz, axis=0), axis=1) / np.diff(leg.seconds)
    assert speed.max() <= LINE_SPEED * (1 + 1e-6)


def test_a_trace_read_back_tells_where_arm_and_parts_are(case: Case) -> None:
    trace = read_trace(trace_bytes(case.run))
    poses = [body.world_from_body for body in case.scene.scene.bodies[1:]]
    joints, first = state_at(trace, poses, 0.0)
    assert joints == pytest.approx(HOME, abs=1e-6)
    assert first[case.part].xyz == pytest.approx(poses[case.part].xyz)
    rest = next(event for event in case.run.events if event.kind == "rest")
    assert rest.pose is not None
    _, held = state_at(trace, poses, rest.start - 1e-3)
    assert held[case.part].xyz == pytest.approx((case.motion @ poses[case.part]).xyz, abs=1e-4)
    _, last = state_at(trace, poses, 1e6)
    assert last[case.part].xyz == pytest.approx(rest.pose.xyz, abs=1e-5)


@pytest.mark.parametrize("data", [b"", b"no json\n", b'{"format": "other"}\n', b"[1]\n", b"\xff\xfe"])
def test_what_is_no_trace_is_refused(data: bytes) -> None:
    with pytest.raises(InputError, match="trace: "):
        read_trace(data)


def test_the_command_writes_the_outcomes_and_traces_of_another_run(
    case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "predictions.csv", tmp_path / "out"
    write_predictions(file, [Prediction(case.query_id, case.motion, 1.0, 0.0)])
    data = str(case.scene.split.dataset.root)
    assert main(["run", data, "--predictions", str(file), "--out", str(out)]) == 0
    assert "1 of 1 seated; 1 seated" in capsys.readouterr().out
    report = read_json(out / "outcomes.json")
    assert report["counts"] == dict.fromkeys(OUTCOMES, 0) | {"seated": 1}
    assert report["scenes"][case.scene.id] == {"order": [case.part], "parts": [asdict(case.run.parts[0])]}
    assert (out / f"{case.scene.id}.jsonl").read_bytes() == trace_bytes(case.run)


def test_wrong_arguments_are_told_in_one_line(case: Case, tmp_path: Path) -> None:
    file = tmp_path / "predictions.csv"
    data = case.scene.split.dataset.root
    write_predictions(file, [Prediction(case.query_id, case.motion, 1.0, 0.0)])
    with pytest.raises(InputError, match="no prediction for scene 'test-s9999'"):
        run_predictions(data, file, scene_id="test-s9999")
    with pytest.raises(InputError, match="--track plase: did you mean place"):
        run_predictions(data, file, track="plase")
    other = case.query_id.replace("-place", "-snap")
    write_predictions(file, [Prediction(name, case.motion, 1.0, 0.0) for name in (case.query_id, other)])
    with pytest.raises(InputError, match="the predictions are of place, snap; name one"):
        run_predictions(data, file)


@cache
def prisms_of(name: str) -> list[np.ndarray]:
    return enclosing_prisms(sample_part(name).mesh)


@given(st.sampled_from(["tee", "bracket"]), st.integers(0, 2**32 - 1))
def test_enclosing_prisms_contain_the_part(name: str, seed: int) -> None:
    """Every vertex, and random points of the surface, lie in one of them."""
    mesh = sample_part(name).mesh
    rng = np.random.default_rng(seed)
    corners = mesh.triangles[rng.integers(len(mesh.faces), size=20)]
    points = np.einsum("nk,nkc->nc", rng.dirichlet(np.ones(3), 20), corners)
    inside = np.zeros(len(points), bool)
    for prism in prisms_of(name):
        low, high = prism.min(0) - 3e-6, prism.max(0) + 3e-6
        inside |= ((points >= low) & (points <= high)).all(1)
    assert inside.all()


@pytest.mark.parametrize("name", ["tee", "bracket"])
def test_enclosing_prisms_exceed_the_part_by_little(name: str) -> None:
    mesh = sample_part(name).mesh
    solid = solid_from_mesh(mesh)
    outside = sum((convex_hull(prism) - solid).volume() for prism in prisms_of(name))
    assert 0 <= outside < 1.5 * TOLERANCE * mesh.area
