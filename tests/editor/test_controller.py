"""The editor without a browser: a fake page drags parts of a recorded scene from depth to a submission."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from kit1000.camera import look_at
from kit1000.cli import main
from kit1000.editor.controller import Controller
from kit1000.editor.display import FIELD, KITS, body_node, ghost_node
from kit1000.editor.keys import KEYS, help_text
from kit1000.editor.moves import read_moves
from kit1000.editor.pointing import Eye
from kit1000.editor.proposals import Proposal, distinct
from kit1000.editor.records import FILE, EventLog
from kit1000.editor.scene import EditedScene
from kit1000.editor.seen_plates import TABLE
from kit1000.editor.session import Session, same_motion
from kit1000.editor.texts import LIKELY_COLOUR, SURE_COLOUR, UNSURE_COLOUR, confidence_colour, plain
from kit1000.editor.worker import Completion, Job, Result
from kit1000.errors import InputError
from kit1000.known_shapes.predictor import FoundShape, FoundShapes
from kit1000.pose import Pose
from kit1000.submission import read_submission
from kit1000.values import FIRST_PART_LABEL, LabelledDepth
from tests.samples.editing import EYE, FakeStage, answered, desk, dragged, found, goal, header_of, off, scene_of


@pytest.fixture(params=["ideal", "d415"])
def scene(mini: Path, request: pytest.FixtureRequest) -> EditedScene:
    return scene_of(mini, request.param)


def test_a_part_is_dragged_snapped_confirmed_and_checked(scene: EditedScene, mini: Path, tmp_path: Path) -> None:
    """From depth alone to a submission without a fault, scored as perfect since the fit is the goal."""
    table = desk(scene, tmp_path)
    part = scene.parts[0]
    true = goal(scene, part)
    found(table, part, (true, 0.93))
    dragged(table, part, true.apply(scene.pivot(part)) + (0.006, 0.004, 0.0))
    space = table.controller.space
    assert space.plate_of(part) is not TABLE
    assert ghost_node(part) not in table.stage.hidden
    assert table.stage.colours[ghost_node(part)] == SURE_COLOUR
    assert "93 % sure" in table.stage.texts["fit"]
    assert [asked[0] for asked in table.asker.asked] == [part]
    table.controller.command("take")
    table.controller.command("take")
    assert "at a fit already" in table.stage.texts["note"]
    table.controller.command("confirm")
    assert space.session.edits[part].state == "confirmed"
    assert same_motion(table.stage.poses[body_node(part)], true)
    assert main(["check", str(tmp_path), "--data", str(mini)]) == 0
    rows = read_submission(tmp_path).predictions
    mine = [rows.row(query_id) for query_id in rows.query_ids if f"-p{part}-" in query_id]
    assert mine
    assert all(same_motion(rows.motions[row], true) for row in mine if row is not None)


def test_one_gesture_is_one_operation_and_undone_bit_for_bit(scene: EditedScene, tmp_path: Path) -> None:
    table, part = desk(scene, tmp_path), scene.parts[0]
    controller, begin = table.controller, Session.begin(scene.parts)
    dragged(table, part, scene.plates[0].point, steps=7)
    dragged(table, part, scene.plates[0].point + (0.01, 0.0, 0.03), "shift")
    dragged(table, part, scene.plates[0].point + (0.02, 0.0, 0.0), "cmd/ctrl")
    dragged(table, part, scene.plates[0].point + (0.0, 0.01, 0.0), "alt")
    for verb in ("turn-left", "turn-right-fine", "tip-away", "tip-aside", "level", "raise", "lower", "reset"):
        controller.command(verb, EYE)
    count = len(controller.space.session.done)
    assert count == 4 + 8
    last = controller.space.session
    for _ in range(count):
        controller.command("undo")
    assert all(edit.same_as(begin.edits[p]) for p, edit in controller.space.session.edits.items())
    for _ in range(count):
        controller.command("redo")
    assert all(edit.same_as(last.edits[p]) for p, edit in controller.space.session.edits.items())


def test_closing_and_opening_again_loses_nothing(scene: EditedScene, tmp_path: Path) -> None:
    """Also when the last line was cut off by a crash; undone operations can still be redone."""
    table, part = desk(scene, tmp_path), scene.parts[0]
    dragged(table, part, scene.plates[0].point)
    table.controller.command("turn-left")
    table.controller.command("raise")
    table.controller.command("undo")
    before = table.controller.space.session
    with open(tmp_path / FILE, "a", encoding="utf-8") as file:
        file.write('{"event": "do", "na')
    again = desk(scene, tmp_path).controller.space.session
    assert [operation.name for operation in again.done] == [operation.name for operation in before.done]
    assert len(again.undone) == 1
    for session, other in ((again, before), (again.redo(), before.redo())):
        assert all(edit.same_as(other.edits[p]) for p, edit in session.edits.items())
    table.controller.command("redo")  # the cut line is gone: what follows is readable
    assert [json.loads(line)["event"] for line in (tmp_path / FILE).read_text().splitlines()][-2:] == ["undo", "redo"]


def test_letting_go_near_a_fit_takes_it(scene: EditedScene, tmp_path: Path) -> None:
    table, part = desk(scene, tmp_path), scene.parts[0]
    point = scene.plates[0].point
    dragged(table, part, point)
    found(table, part, (table.controller.space.current[part].goal_from_now, 0.7))
    for place, state in ((np.array([0.0, -0.2, 0.0]), "free"), (point, "snapped")):
        dragged(table, part, place)
        assert table.controller.space.session.edits[part].state == state


def test_a_turned_part_gets_the_answer_to_its_own_pose_and_a_moved_one_any_rotation(
    scene: EditedScene, tmp_path: Path
) -> None:
    table, part = desk(scene, tmp_path), scene.parts[0]
    space, pivot = table.controller.space, scene.pivot(part)
    dragged(table, part, scene.plates[0].point)
    hand = space.current[part].goal_from_now
    aside, along = off(hand, pivot, 1.5, (0.005, 0.0, 0.0)), off(hand, pivot, 0.2, (0.0, 0.005, 0.0))
    found(table, part, (aside, 0.9), (along, 0.6), (off(hand, pivot, 0.0, (0.05, 0.0, 0.0)), 0.99))
    assert [fit.confidence for fit in space.fits(part)] == [0.9, 0.6]  # one is out of reach
    table.controller.command("turn-left")
    assert [fit.confidence for fit in space.fits(part)] == [0.6, 0.9]
    turned = space.session.edits[part].goal_from_now
    answered(table, part, turned, (off(turned, pivot, 0.1, (0.0, 0.0, 0.004)), 0.3))
    assert [fit.confidence for fit in space.fits(part)] == [0.3, 0.6, 0.9]
    answered(table, part, hand, (hand, 1.0))  # too late: the hand has moved on
    assert [fit.confidence for fit in space.fits(part)] == [0.3, 0.6, 0.9]
    ghost = space.ghost(part)
    table.controller.command("next")
    assert space.ghost(part) is not ghost


def test_snap_all_takes_likely_fits_and_no_cavity_twice(mini: Path, tmp_path: Path) -> None:
    scene = max((scene_of(mini, "ideal", split=split) for split in ("train", "val")), key=lambda one: len(one.parts))
    table = desk(scene, tmp_path)
    goals = {part: goal(scene, part) for part in scene.parts}
    for part in scene.parts:
        first = scene.parts[0]
        stolen = Pose.from_translation(goals[first].apply(scene.pivot(first)) - scene.pivot(part))
        found(table, part, (stolen if part != first else goals[first], 0.8 - 0.1 * part), (goals[part], 0.1))
    table.controller.command("take-all")
    states = [edit.state for edit in table.controller.space.session.edits.values()]
    assert states == ["snapped", *["free"] * (len(scene.parts) - 1)]
    assert len(table.controller.space.session.done) == 1
    table.controller.command("confirm-all")
    assert table.controller.space.session.edits[scene.parts[0]].confirmed


def test_without_a_method_nothing_snaps_and_a_pose_by_hand_can_be_confirmed(scene: EditedScene, tmp_path: Path) -> None:
    table, part = desk(scene, tmp_path, snaps=False), scene.parts[0]
    dragged(table, part, scene.plates[0].point)
    table.controller.command("take")
    table.controller.command("confirm")
    assert table.controller.space.session.edits[part].state == "confirmed"
    rows = read_submission(tmp_path).predictions
    assert set(rows.confidence.tolist()) == {0.0}
    table.controller.command("undo")
    assert not (tmp_path / "manifest.toml").exists()


def test_a_part_that_is_taken_into_the_hand_again_is_asked_about(scene: EditedScene, tmp_path: Path) -> None:
    """As after a restart: else the page would say for ever that it asks."""
    first, part = desk(scene, tmp_path), scene.parts[0]
    dragged(first, part, scene.plates[0].point)
    table = desk(scene, tmp_path)
    assert table.asker.asked == []
    table.controller.select(part)
    hand = table.controller.space.session.edits[part].goal_from_now
    assert [(part, same_motion(guess, hand)) for part, guess in table.asker.asked] == [(part, True)]
    assert table.controller.space.waits(part)
    answered(table, part, hand, (hand, 0.9))
    table.controller.select(None)
    table.controller.select(part)
    assert len(table.asker.asked) == 1  # the answer is known


def test_fits_that_are_found_in_the_middle_of_a_drag_are_shown_at_once(scene: EditedScene, tmp_path: Path) -> None:
    table, part = desk(scene, tmp_path), scene.parts[0]
    grabbed, point = scene.pivot(part), scene.plates[0].point
    table.controller.grab(part, EYE, EYE.screen(grabbed), grabbed)
    table.controller.drag(EYE.screen(point))
    assert ghost_node(part) in table.stage.hidden
    share, hand = table.stage.share, table.controller.space.current[part].goal_from_now
    found(table, part, (hand, 0.7))
    assert ghost_node(part) not in table.stage.hidden
    assert table.stage.share > share
    table.controller.drag(EYE.screen(point + (0.1, 0.0, 0.0)))
    table.controller.release()
    assert len(table.controller.space.session.done) == 1


def test_the_gizmo_carries_a_part_and_is_one_operation(scene: EditedScene, tmp_path: Path) -> None:
    table, part = desk(scene, tmp_path), scene.parts[0]
    table.controller.carry(Pose.identity(), done=True)  # nothing is selected
    table.controller.select(part)
    table.controller.command("gizmo")
    assert table.stage.gizmo_pose is not None
    assert np.allclose(table.stage.gizmo_pose.xyz, scene.pivot(part))
    for k in range(4):
        pose = Pose.from_rotvec((0.0, 0.1 * k, 0.0), scene.pivot(part) + (0.0, 0.0, 0.01 * k))
        table.controller.carry(pose, done=k == 3)
    motion = table.controller.space.session.edits[part].goal_from_now
    assert np.allclose(motion.apply(scene.pivot(part)), scene.pivot(part) + (0.0, 0.0, 0.03))
    assert [operation.name for operation in table.controller.space.session.done] == [f"part {part + 1}: gizmo"]
    table.controller.command("deselect")
    assert table.stage.gizmo_pose is None


@pytest.mark.parametrize("aspect", [0.6, 1.0, 2.2])
def test_every_view_fills_the_window_with_the_scene(scene: EditedScene, tmp_path: Path, aspect: float) -> None:
    table = desk(scene, tmp_path)
    for verb in ("view-camera", "view-top"):
        table.controller.command(verb, EYE._replace(aspect=aspect))
        eye = Eye(look_at(*table.stage.looks[-1]), FIELD, aspect)
        away = np.abs(np.array([eye.screen(point) for point in scene.bounds]) - 0.5)
        assert 0.43 < away.max() < 0.46, verb


def test_what_cannot_be_done_is_said(scene: EditedScene, tmp_path: Path) -> None:
    table, part = desk(scene, tmp_path), scene.parts[0]
    for verb, said in (
        ("undo", "Nothing to undo"),
        ("redo", "Nothing to redo"),
        ("select-9", "no part 9"),
        ("take-all", "still looking"),
        ("confirm", "Choose a part"),
        ("view-slot", "Choose a part"),
        (f"select-{part + 1}", ""),
        ("confirm", "drag a part"),  # it is on the table
    ):
        table.controller.command(verb)
        assert said in table.stage.texts["note"], verb
    assert not any(edit.confirmed for edit in table.controller.space.session.edits.values())
    for each in scene.parts:
        found(table, each)
    table.controller.command("take-all")
    assert "No further part" in table.stage.texts["note"]
    table.controller.select(part)
    assert table.stage.texts["note"] == ""


def test_an_operation_that_cannot_be_written_is_not_done(
    scene: EditedScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, part = desk(scene, tmp_path), scene.parts[0]
    dragged(table, part, scene.plates[0].point)
    before = table.controller.space.session

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(table.log, "add", full)
        for verb in ("turn-left", "undo"):
            with pytest.raises(OSError, match="No space"):
                table.controller.command(verb)
            assert table.controller.space.session is before


def test_every_key_does_something_or_says_why_not(scene: EditedScene, tmp_path: Path) -> None:
    table = desk(scene, tmp_path)
    for key in KEYS:
        table.controller.command("deselect")
        table.controller.command(key.verb, EYE)
        table.controller.command(f"select-{scene.parts[0] + 1}")
        table.controller.command(key.verb, EYE)
    assert all(key.help in help_text("scene") for key in KEYS)
    used = [(key.key, key.modifier) for key in KEYS]
    assert len(set(used)) == len(used)
    assert not {key.key for key in KEYS if key.modifier is None} & set("WASDQE")


def test_a_session_with_true_shapes_says_so_everywhere(mini: Path, tmp_path: Path) -> None:
    scene = scene_of(mini, truth=True)
    table, part = desk(scene, tmp_path), scene.parts[0]
    table.controller.place(part, goal(scene, part))
    table.controller.command("confirm")
    assert all(json.loads(line)["truth"] for line in (tmp_path / FILE).read_text().splitlines())
    manifest = read_submission(tmp_path).manifest
    assert manifest.uses_true_geometry
    assert "True shapes were shown" in manifest.description
    with pytest.raises(InputError, match="choose another --out"):
        EventLog(tmp_path, header_of(scene_of(mini)))


def test_known_shapes_replace_what_is_seen_and_doubts_are_marked(
    scene: EditedScene, mini: Path, tmp_path: Path
) -> None:
    table, (part, *others) = desk(scene, tmp_path), scene.parts
    true = scene_of(mini, truth=True)
    part_mesh, kits = true.meshes[part], FoundShape("kits", true.kits, ("the scale is open",))
    table.controller.command(f"select-{part + 1}")
    table.controller.completed(Completion(FoundShapes(kits, {part: FoundShape("tee", part_mesh, ())})))
    meshes = table.stage.meshes
    assert meshes[KITS] is true.kits
    assert meshes[body_node(part)] is meshes[ghost_node(part)] is part_mesh
    lines = table.stage.texts["parts"].splitlines()
    assert lines[0].startswith("kits ? not sure: the scale is open")
    assert "tee" in lines[1]
    assert "?" not in lines[1] + table.stage.labels[f"/name/{part}"]
    for line, other in zip(lines[2:], others, strict=True):
        assert meshes[body_node(other)] is not true.meshes[other]  # its shape was not found: as seen
        assert "?" in line
        assert "?" in table.stage.labels[f"/name/{other}"]
    table.controller.place(part, goal(scene, part))
    table.controller.command("confirm")
    assert table.controller.space.session.edits[part].confirmed


def test_a_known_shape_that_no_mask_shows_is_moved_like_any_part(mini: Path, tmp_path: Path) -> None:
    """It gets a number after all others, keeps its edits when the page opens again, and has a move for the robot."""
    split = max(("train", "val"), key=lambda each: len(scene_of(mini, split=each).parts))
    scene, true = scene_of(mini, split=split), scene_of(mini, truth=True, split=split)
    hidden, *shown = scene.parts
    labels = np.where(scene.image.labels == FIRST_PART_LABEL + hidden, 0, scene.image.labels).astype(np.uint8)
    queries = {part: scene.queries[part] for part in shown}
    masked = replace(scene, queries=queries, drawn=LabelledDepth(scene.view, labels))
    parts = {part: FoundShape("tee", true.meshes[part], ()) for part in shown}
    further = 1 + max(scene.parts)
    shapes = FoundShapes(
        FoundShape("kits", true.kits, ()), {**parts, further: FoundShape("ell", true.meshes[hidden], ())}, ("cam",)
    )
    table = desk(masked, tmp_path, moves=True)
    assert table.controller.bodies == tuple(shown)
    table.controller.completed(Completion(shapes))
    assert table.controller.bodies == (*shown, further)
    assert table.stage.texts["parts"].splitlines()[0].strip() == "? Not found in the image: cam."
    motion = goal(scene, hidden)
    found(table, further, (motion, 0.9))
    table.controller.command(f"select-{further + 1}")
    dragged(table, further, motion.apply(table.controller.space.scene.pivot(further)) + (0.004, 0.0, 0.0))
    table.controller.command("take")
    table.controller.command("confirm")
    (move,) = read_moves(tmp_path)
    assert move.part == further
    assert same_motion(move.world.motion, motion)
    box = true.meshes[hidden].bounds
    assert (np.abs(move.world.pick.xyz - box.mean(0)) < np.ptp(box, axis=0) / 2 + 3e-3).all()
    assert not (tmp_path / "predictions.csv").exists()  # no query asks for it
    again = desk(masked, tmp_path, moves=True)
    assert read_moves(tmp_path)[0].part == further
    again.controller.completed(Completion(shapes))
    assert again.controller.space.part_edits[further].confirmed
    again.controller.command("undo")
    assert not (tmp_path / "moves.json").exists()


def test_sessions_with_and_without_shapes_are_not_mixed(scene: EditedScene, tmp_path: Path) -> None:
    header = replace(header_of(scene), shapes=True)
    log = EventLog(tmp_path, header)
    table = Controller(scene, cast(Any, stage := FakeStage()), log, None)
    part = scene.parts[0]
    table.place(part, goal(scene, part))
    table.select(part)
    table.command("confirm")
    assert read_submission(tmp_path).manifest.reads == "shapes"
    with pytest.raises(InputError, match="shapes True, not False; choose another --out"):
        EventLog(tmp_path, header_of(scene))
    table.completed(Completion(None, "no [weights](x)"))
    assert stage.texts["parts"].splitlines()[0].strip() == "? Only what the image shows is shown: no weights(x)"


def test_colour_follows_confidence_in_three_steps() -> None:
    steps = [confidence_colour(share) for share in (0.0, 0.499, 0.5, 0.799, 0.8, 1.0)]
    assert steps == [UNSURE_COLOUR] * 2 + [LIKELY_COLOUR] * 2 + [SURE_COLOUR] * 2


def test_fits_that_nobody_can_tell_apart_are_one() -> None:
    pivot = np.array([0.1, 0.2, 0.0])
    fits = [Proposal(Pose.from_translation((x, 0.0, 0.0)), 0.5) for x in (0.0, 0.0009, 0.0011, 0.01)]
    assert distinct(fits, pivot) == [fits[0], fits[2], fits[3]]


def test_failures_of_a_method_are_said_without_markup(scene: EditedScene, tmp_path: Path) -> None:
    table, part = desk(scene, tmp_path), scene.parts[0]
    dragged(table, part, scene.plates[0].point)
    table.controller.received(Result(Job(part, None), [], "no <b>luck</b> [x](y)"))
    assert "no bluck/b x(y)" in table.stage.texts["fit"]
    assert plain("<script>`a`|#") == "scripta"
