"""Hand control without a browser: two cups carry a part, with the aids of the page or bare, to a submission."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.cli import main
from kit1000.editor.display import KITS, body_node
from kit1000.editor.hand import PICK, PLACE, HandWorkspace
from kit1000.editor.keys import help_text, keys_of, shown, verbs_of
from kit1000.editor.records import EventLog
from kit1000.editor.scene import EditedScene
from kit1000.editor.seen_plates import TABLE
from kit1000.editor.session import UNTOUCHED, Session
from kit1000.pose import Pose
from kit1000.submission import read_submission
from tests.samples.editing import EYE, Desk, desk, dragged, header_of, scene_of

numbers = st.floats(-1, 1, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)


@pytest.fixture(params=["ideal", "photoneo"])
def scene(mini: Path, request: pytest.FixtureRequest) -> EditedScene:
    return scene_of(mini, request.param)


def hand(scene: EditedScene, out: Path, bare: bool = False) -> tuple[Desk, HandWorkspace]:
    table = desk(scene, out, snaps=False, interface="hand-bare" if bare else "hand")
    space = table.controller.space
    assert isinstance(space, HandWorkspace)
    return table, space


def world_from_cup(space: HandWorkspace, cup: int) -> Pose:
    return space.current[cup].goal_from_now @ space.rest(cup)


def choose(table: Desk, part: int) -> None:
    """Press a part's number."""
    table.controller.command(f"select-{part + 1}", EYE)


def apart(one: Pose, other: Pose) -> float:
    return float(np.abs(one.matrix() - other.matrix()).max())


@given(turn=vectors, shift=vectors, pick_turn=vectors, pick_shift=vectors)
def test_a_part_moves_as_the_cup_does_from_pick_to_place(
    mini: Path,
    tmp_path_factory: pytest.TempPathFactory,
    turn: np.ndarray,
    shift: np.ndarray,
    pick_turn: np.ndarray,
    pick_shift: np.ndarray,
) -> None:
    scene = scene_of(mini)
    table, space = hand(scene, tmp_path_factory.mktemp("hand"))
    part, top = scene.parts[0], scene.tops[scene.parts[0]][0]
    for cup, rotvec, point in (
        (PICK, pick_turn, top + 1e-3 * pick_shift),
        (PLACE, turn, scene.plates[0].point + 0.02 * shift + (0.0, 0.0, 0.04)),
    ):
        target = Pose.from_rotvec(rotvec, point) @ Pose(space.rest(cup).wxyz, np.zeros(3))
        table.controller.place(cup, target @ space.rest(cup).inverse())
    expected = world_from_cup(space, PLACE) @ world_from_cup(space, PICK).inverse()
    table.controller.command("confirm")
    edit = space.session.edits[part]
    assert edit.confirmed
    assert apart(edit.goal_from_now, expected) < 1e-12
    assert all(space.session.edits[cup].same_as(UNTOUCHED) for cup in (PICK, PLACE))


def test_a_part_is_picked_placed_and_checked(scene: EditedScene, mini: Path, tmp_path: Path) -> None:
    """From points alone to a submission without a fault."""
    table, space = hand(scene, tmp_path)
    part = scene.parts[0]
    choose(table, part)
    lip = world_from_cup(space, PICK).xyz
    assert np.square(scene.tops[part] - lip).sum(1).min() == 0
    assert space.carried(PLACE) == part
    assert table.stage.poses[body_node(part)].xyz.tolist() == [0, 0, 0]
    dragged(table, PLACE, scene.plates[0].point)
    plate = space.plate_of(PLACE)
    assert plate is not TABLE
    carried = space.part_edit(PLACE).goal_from_now
    assert abs(float(plate.height(carried.apply(scene.clouds[part])).min())) < 1e-9
    assert not space.session.edits[part].confirmed  # nothing moves before it is confirmed
    table.controller.command("confirm")
    assert space.session.edits[part].state == "confirmed"
    assert apart(space.session.edits[part].goal_from_now, carried) < 1e-12
    assert main(["check", str(tmp_path), "--data", str(mini)]) == 0
    rows = read_submission(tmp_path)
    assert rows.manifest.label == "Hand control"
    assert apart(rows.predictions.motions[0], carried) < 1e-9
    assert set(rows.predictions.confidence.tolist()) == {0.0}


def test_nothing_snaps_in_hand_control(mini: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["edit", str(mini), "--scene", "test-s0000", "--out", str(tmp_path / "out")]
    assert main([*words, "--interface", "hand", "--snap", "registration"]) == 2
    assert "--snap registration" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert {"take", "next", "take-all"}.isdisjoint(verbs_of("hand") | verbs_of("hand-bare"))


def test_a_part_that_was_carried_is_carried_on_from_where_it_is(scene: EditedScene, tmp_path: Path) -> None:
    table, space = hand(scene, tmp_path)
    part, plate = scene.parts[0], scene.plates[0]
    for _ in range(2):
        choose(table, part)
        dragged(table, PLACE, plate.point)
        assert space.over_kits(PLACE)
        table.controller.command("turn-left")
        before = space.session.edits[part].goal_from_now
        step = world_from_cup(space, PLACE) @ world_from_cup(space, PICK).inverse()
        table.controller.command("confirm")
        assert apart(space.session.edits[part].goal_from_now, step @ before) < 1e-12
    assert table.stage.poses[body_node(part)] is space.session.edits[part].goal_from_now


def test_all_undone_is_the_beginning_and_closing_loses_nothing(scene: EditedScene, tmp_path: Path) -> None:
    table, space = hand(scene, tmp_path)
    controller, part = table.controller, scene.parts[0]
    choose(table, part)
    dragged(table, PICK, scene.pivot(part))
    dragged(table, PLACE, scene.plates[0].point)
    for verb in ("turn-left", "raise", "level", "tip-away"):
        controller.command(verb, EYE)
    controller.command("confirm")
    choose(table, part)
    last = space.session
    assert table.stage.events == EventLog(tmp_path, header_of(scene, interface="hand")).rows  # as the sink got them
    again, other = hand(scene, tmp_path)
    assert all(edit.same_as(last.edits[body]) for body, edit in other.session.edits.items())
    assert other.carried(PLACE) == space.carried(PLACE)
    for _ in last.done:
        again.controller.command("undo")
    begin = Session.begin(space.edited)
    assert all(edit.same_as(begin.edits[body]) for body, edit in other.session.edits.items())
    assert other.carried(PLACE) is None
    for _ in last.done:
        again.controller.command("redo")
    assert all(edit.same_as(last.edits[body]) for body, edit in other.session.edits.items())


def test_the_green_cup_stands_upright_on_what_is_under_the_cursor(scene: EditedScene, tmp_path: Path) -> None:
    table, space = hand(scene, tmp_path)
    part = scene.parts[0]
    top = min(scene.tops[part], key=lambda point: float(np.square(point - scene.tops[part].mean(0)).sum()))
    dragged(table, PICK, np.array([0.3, -0.3, 0.0]))
    assert space.carried(PLACE) is None
    assert world_from_cup(space, PICK).xyz[2] == pytest.approx(0, abs=2e-3)
    dragged(table, PICK, top)
    cup = world_from_cup(space, PICK)
    assert cup.rotate((0.0, 0.0, 1.0)).tolist() == pytest.approx([0, 0, -1], abs=1e-12)
    assert np.square(scene.tops[part] - cup.xyz).sum(1).min() < 0.006**2
    assert space.carried(PLACE) == part


def test_nothing_is_carried_without_a_part_and_a_plate(scene: EditedScene, tmp_path: Path) -> None:
    table, space = hand(scene, tmp_path)
    choose(table, scene.parts[0])
    table.controller.command("confirm")
    assert "Nothing to carry" in table.stage.texts["note"]
    table.controller.command("reset-all")
    dragged(table, PLACE, scene.plates[0].point)
    assert "carries nothing" in table.stage.texts["fit"]
    table.controller.command("confirm")
    assert "Nothing to carry" in table.stage.texts["note"]
    assert not any(edit.confirmed for edit in space.session.edits.values())


def test_points_are_shown_and_no_shape(scene: EditedScene, tmp_path: Path) -> None:
    table, space = hand(scene, tmp_path)
    assert {KITS, *map(body_node, scene.parts)} <= table.stage.points.keys()
    assert table.stage.meshes.keys() == {body_node(cup) for cup in space.bodies}
    low, high = (getattr(scene.meshes[scene.parts[0]].vertices, side)(0) for side in ("min", "max"))
    points = table.stage.points[body_node(scene.parts[0])]
    assert (points > low - 5e-3).all()
    assert (points < high + 5e-3).all()


def test_bare_hand_control_moves_cups_by_the_gizmo_alone(scene: EditedScene, tmp_path: Path) -> None:
    table, space = hand(scene, tmp_path, bare=True)
    part, controller = scene.parts[0], table.controller
    for verb in ("select-1", "turn-left", "level", "take", "take-all"):
        controller.command(verb, EYE)
    dragged(table, PICK, scene.pivot(part))
    assert space.session.done == ()
    assert (space.selected, space.carried(PLACE)) == (PICK, None)
    for cup, point in ((PICK, scene.tops[part][0]), (PLACE, scene.plates[0].point)):
        controller.select(cup)
        assert table.stage.gizmo_pose is not None
        controller.carry(Pose.from_translation(point), done=False)
        controller.carry(Pose.from_translation(point), done=True)
    controller.command("confirm")
    assert space.session.edits[part].confirmed
    assert read_submission(tmp_path).manifest.label == "Hand control, bare"


@pytest.mark.parametrize("interface", ["scene", "hand", "hand-bare"])
def test_help_names_every_key_that_the_interface_has(interface: str) -> None:
    text = help_text(interface)  # type: ignore[arg-type]
    for key in keys_of("scene"):
        kept = key.verb in verbs_of(interface)  # type: ignore[arg-type]
        assert (f"**{shown(key)}** |" in text) == (kept and bool(key.help)), key
