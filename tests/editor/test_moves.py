"""Moves and picks for a robot: consistent in every frame, read as they were written."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.capture.pose_files import stated_pose
from kit1000.dataset.reader import Dataset
from kit1000.editor.moves import FILE, FramedMove, Move, read_moves, write_moves
from kit1000.editor.picks import find_pick, insertion_axis
from kit1000.editor.scene import EditedScene
from kit1000.errors import InputError
from kit1000.kits.seating import HOVER
from kit1000.planner.robot import CUPS
from kit1000.pose import Pose
from kit1000.submission import read_submission
from kit1000.values import LabelledDepth
from tests.samples.checkout import ROOT
from tests.samples.editing import desk, found, goal, scene_of
from tests.samples.strategies import directions, poses

near = poses().map(lambda pose: Pose(pose.wxyz, np.clip(pose.xyz, -2, 2)))
KEY = ("test-s0000", "ideal")


def apart(one: Pose, other: Pose) -> float:
    return float(np.abs(one.matrix() - other.matrix()).max())


@st.composite
def moves(draw: st.DrawFn) -> Move:
    framed = FramedMove(draw(near), draw(near), draw(directions()))
    base = draw(st.none() | near)
    return Move(*KEY, draw(st.integers(0, 9)), draw(st.floats(0, 1)), True, None, framed, draw(near), base)


def frames(move: Move) -> list[FramedMove]:
    return [move.world, move.camera, *([] if move.base is None else [move.base])]


@given(move=moves())
def test_each_frame_is_consistent_and_all_frames_agree(move: Move) -> None:
    for framed in frames(move):
        assert apart(framed.motion @ framed.pick, framed.seated) == 0
        assert np.abs(framed.hover.xyz - framed.seated.xyz - HOVER * framed.axis).max() < 1e-12
        assert np.array_equal(framed.hover.wxyz, framed.seated.wxyz)
    seen = move.world_from_camera
    for name in ("pick", "hover", "seated"):
        assert apart(seen @ getattr(move.camera, name), getattr(move.world, name)) < 1e-9
    assert np.abs(seen.rotate(move.camera.axis) - move.world.axis).max() < 1e-9
    if move.base is not None and move.base_from_camera is not None:
        assert apart(move.base.seated, move.base_from_camera @ move.camera.seated) < 1e-9


@settings(max_examples=10)
@given(written=st.lists(moves(), max_size=3, unique_by=lambda move: move.part))
def test_moves_are_read_as_they_were_written(written: list[Move], tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("edits")
    write_moves(folder, "id", KEY, written)
    assert (folder / FILE).is_file() == bool(written)
    read = read_moves(folder) if written else []
    for one, other in zip(sorted(written, key=lambda move: move.part), read, strict=True):
        for name in ("scene", "sensor", "part", "confidence", "cup"):
            assert getattr(one, name) == getattr(other, name)
        assert apart(one.world.seated, other.world.seated) < 1e-9
        assert (one.base is None) == (other.base is None)


def sample(part: int = 0, base: Pose | None = None, scene: str = KEY[0]) -> Move:
    framed = FramedMove(Pose.from_rotvec((0, 0, 1.0), (0.1, 0.2, 0)), Pose.identity(), np.array([0.0, 0.0, 1.0]))
    return Move(scene, "ideal", part, 0.9, True, 3e-3, framed, Pose.from_rotvec((2.0, 0, 0), (0, 0, 0.7)), base)


def test_scenes_share_a_file_and_each_replaces_its_own_moves(tmp_path: Path) -> None:
    write_moves(tmp_path, "id", ("b", "ideal"), [sample(1, scene="b"), sample(0, scene="b")])
    write_moves(tmp_path, "id", ("a", "ideal"), [sample(4, scene="a")])
    assert [(move.scene, move.part) for move in read_moves(tmp_path)] == [("a", 4), ("b", 0), ("b", 1)]
    write_moves(tmp_path, "id", ("b", "ideal"), [])
    assert [(move.scene, move.part) for move in read_moves(tmp_path / FILE)] == [("a", 4)]
    with pytest.raises(InputError, match="about dataset id, not other"):
        write_moves(tmp_path, "other", KEY, [sample()])
    write_moves(tmp_path, "id", ("a", "ideal"), [])
    assert not (tmp_path / FILE).exists()


DAMAGES: list[tuple[list[str], object, str]] = [
    (["world", "pick", "wxyz"], [0, 0, 0], "moves[0].world.pick"),
    (["world", "motion"], {}, "moves[0].world.motion"),
    (["world", "pick", "wxyz"], [0, 0, 0, 0], "wxyz"),
    (["world", "axis"], [0, 0, 0], "axis"),
    (["confidence"], 3, "moves[0].confidence"),
    (["confidence"], "much", "moves[0].confidence"),
    (["part"], "0", "moves[0].part"),
    (["world_from_camera"], 3, "moves[0].world_from_camera"),
    (["base_from_camera"], [1, 2], "moves[0].base_from_camera"),
]


@pytest.mark.parametrize(("keys", "value", "field"), DAMAGES)
def test_a_damaged_move_is_one_line_with_its_place(keys: list[str], value: object, field: str, tmp_path: Path) -> None:
    write_moves(tmp_path, "id", KEY, [sample(base=Pose.from_translation((0.5, 0, 0)))])
    file = json.loads((tmp_path / FILE).read_text())
    *path, last = keys
    row = file["moves"][0]
    for key in path:
        row = row[key]
    row[last] = value
    (tmp_path / FILE).write_text(json.dumps(file))
    with pytest.raises(InputError) as refused:
        read_moves(tmp_path)
    text = str(refused.value)
    assert text.startswith(str(tmp_path / FILE))
    assert field in text
    assert "\n" not in text


def test_the_other_frames_of_a_file_follow_from_the_first(tmp_path: Path) -> None:
    """A file that was written before reads the same, whatever its further frames state."""
    move = sample(base=Pose.from_translation((0.5, 0, 0)))
    write_moves(tmp_path, "id", KEY, [move])
    file = json.loads((tmp_path / FILE).read_text())
    for name in ("camera", "base"):
        del file["moves"][0][name]
    (tmp_path / FILE).write_text(json.dumps(file))
    [read] = read_moves(tmp_path)
    assert read.base is not None
    assert move.base is not None
    assert apart(read.base.seated, move.base.seated) < 1e-12


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "kit1000/moves/1"}', '{"format": 1, "moves": []}'])
def test_another_file_is_refused_and_stays(text: str, tmp_path: Path) -> None:
    (tmp_path / FILE).write_text(text)
    with pytest.raises(InputError, match=re.escape(str(tmp_path / FILE))):
        read_moves(tmp_path)
    with pytest.raises(InputError, match=re.escape(str(tmp_path / FILE))):
        write_moves(tmp_path, "id", KEY, [sample()])
    assert (tmp_path / FILE).read_text() == text


@pytest.fixture(params=["ideal", "d415"])
def scene(mini: Path, request: pytest.FixtureRequest) -> EditedScene:
    return scene_of(mini, request.param)


def confirmed(scene: EditedScene, out: Path) -> tuple[Any, int, Pose]:
    """A desk at which the first part was snapped onto its goal and confirmed."""
    table, part = desk(scene, out, moves=True), scene.parts[0]
    true = goal(scene, part)
    table.controller.place(part, true)
    found(table, part, (true, 0.93))
    table.controller.command("take")
    table.controller.command("confirm")
    return table, part, true


def test_a_confirmed_part_is_a_move_and_an_undone_one_is_none(scene: EditedScene, tmp_path: Path) -> None:
    table, part, true = confirmed(scene, tmp_path)
    (move,) = read_moves(tmp_path)
    assert (move.scene, move.sensor, move.part, move.base) == (scene.recorded.id, scene.sensor, part, None)
    assert apart(move.world.motion, true) < 1e-12
    rows = read_submission(tmp_path).predictions
    assert all(apart(motion, move.world.motion) < 1e-12 for motion in rows.motions)
    assert apart(move.world_from_camera, scene.view.world_from_camera) < 1e-12
    plate = table.controller.space.pointing.below(true.apply(scene.pivot(part)))
    assert move.world.axis @ plate.normal > np.cos(np.radians(5))
    table.controller.command("undo")
    assert not (tmp_path / FILE).exists()


def test_the_camera_in_the_base_of_a_robot_comes_from_a_file_or_from_the_dataset(mini: Path, tmp_path: Path) -> None:
    stated = Pose.from_rotvec((0.1, 2.0, 0.3), (0.4, 0.1, 0.8))
    copy = tmp_path / "data"
    copy.mkdir()
    for path in mini.iterdir():
        if path.name != "dataset.json":
            (copy / path.name).symlink_to(path)
    summary = json.loads((mini / "dataset.json").read_text())
    row = {"wxyz": stated.wxyz.tolist(), "xyz": stated.xyz.tolist()}
    for base in (row, stated.matrix().tolist()):
        summary["config"]["base_from_camera"] = base
        (copy / "dataset.json").write_text(json.dumps(summary))
        opened = EditedScene.open(Dataset(copy), KEY[0], "ideal", False)
        assert opened.base_from_camera is not None
        assert apart(opened.base_from_camera, stated) < 1e-9
    other = Pose.from_translation((1, 2, 3))
    opened = EditedScene.open(Dataset(copy), KEY[0], "ideal", False, other)
    _, _, true = confirmed(opened, tmp_path / "out")
    (move,) = read_moves(tmp_path / "out")
    assert move.base is not None
    assert move.base_from_camera is not None
    assert apart(move.base_from_camera, other) < 1e-12
    base_from_world = other @ move.world_from_camera.inverse()
    assert apart(move.base.motion, base_from_world @ true @ base_from_world.inverse()) < 1e-9
    summary["config"]["base_from_camera"] = [1, 2]
    (copy / "dataset.json").write_text(json.dumps(summary))
    with pytest.raises(InputError, match=r"dataset\.json: config: base_from_camera: no pose"):
        EditedScene.open(Dataset(copy), KEY[0], "ideal", False)


def test_the_python_of_the_page_reads_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    base = Pose.from_rotvec((0.1, 2.0, 0.3), (0.4, 0.1, 0.8))
    (tmp_path / "edits").mkdir()
    write_moves(tmp_path / "edits", "id", KEY, [sample(0, base), sample(1, base)])
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```py\n(.*?)^```", (ROOT / "docs/reference/moves.md").read_text("utf-8"), re.M | re.S)
    assert blocks
    for block in blocks:
        exec(block, {})
        printed = capsys.readouterr().out
        assert KEY[0] in printed
        assert len(re.findall(r"-?\d+\.\d+", printed)) >= 6
    row = json.loads((tmp_path / "edits" / FILE).read_text())["moves"][0]
    assert stated_pose(row["base"]["seated"], "") is not None


UP = np.array([0.0, 0.0, 1.0])
level_moves = st.builds(
    lambda yaw, x, y: Pose.from_rotvec((0, 0, yaw), (x, y, 0)), st.floats(-3, 3), st.floats(-1, 1), st.floats(-1, 1)
)


@cache
def recorded(root: Path) -> tuple[LabelledDepth, int]:
    scene = scene_of(root)
    return scene.recorded.labelled_depth("ideal"), scene.parts[0]


def moved(image: LabelledDepth, motion: Pose) -> LabelledDepth:
    """An image whose world lies elsewhere."""
    return replace(image, view=replace(image.view, world_from_camera=motion @ image.view.world_from_camera))


@settings(max_examples=3)
@given(motion=level_moves)
def test_moving_the_world_along_the_table_moves_no_pick_in_the_frame_of_the_camera(mini: Path, motion: Pose) -> None:
    image, part = recorded(mini)
    here, there = find_pick(image, part, "ideal"), find_pick(moved(image, motion), part, "ideal")
    apart = (motion @ here.world_from_grip).inverse() @ there.world_from_grip
    assert float(np.abs(apart.matrix() - np.eye(4)).max()) < 1e-9
    assert here.cup == there.cup


def test_a_pick_is_on_the_part_with_z_into_it(mini: Path) -> None:
    image, part = recorded(mini)
    pick = find_pick(image, part, "ideal")
    assert np.abs(pick.world_from_grip.rotate(UP) + UP).max() < 1e-12
    assert pick.cup is None or pick.cup in CUPS
    scene = scene_of(mini)
    top = scene.tops[part]
    assert (pick.world_from_grip.xyz <= top.max(0) + 1e-3).all()
    assert (pick.world_from_grip.xyz >= top.min(0) - 1e-3).all()


def test_where_no_cup_seals_the_pick_is_the_top_of_the_middle(mini: Path) -> None:
    image, part = recorded(mini)
    rough = image.view.depth + 0.004 * (np.indices(image.view.depth.shape).sum(0) % 2) * (image.view.depth > 0)
    pick = find_pick(replace(image, view=replace(image.view, depth=rough.astype(np.float32))), part, "ideal")
    assert pick.cup is None
    top = scene_of(mini).tops[part]
    middle = (top.min(0) + top.max(0)) / 2
    assert np.abs(pick.world_from_grip.xyz - middle)[:2].max() < 6e-3
    assert pick.world_from_grip.xyz[2] == pytest.approx(top[:, 2].max(), abs=6e-3)


@given(motion=poses(), normal=directions())
def test_the_axis_is_the_carried_vertical_unless_that_leans_away_from_the_plate(
    motion: Pose, normal: np.ndarray
) -> None:
    carried = motion.rotate(UP)
    axis, upright = insertion_axis(motion, normal)
    angle = np.degrees(np.arccos(np.clip(carried @ normal, -1, 1)))
    if abs(angle - 20) > 1e-6:
        assert upright == (angle < 20)
    assert np.array_equal(axis, carried if upright else normal)
    alone, known = insertion_axis(motion, None)
    assert known
    assert np.array_equal(alone, carried)
