"""Where a part is picked and along which axis it goes in."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.editor.picks import find_pick, insertion_axis, level_frame
from kit1000.planner.robot import CUPS
from kit1000.pose import Pose
from kit1000.values import LabelledDepth
from tests.samples.editing import scene_of
from tests.samples.strategies import directions, poses

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


@given(motion=level_moves, seen=poses())
def test_the_level_frame_is_level_below_the_camera(mini: Path, motion: Pose, seen: Pose) -> None:
    image, _ = recorded(mini)
    view = replace(image.view, world_from_camera=seen)
    frame = level_frame(view)
    assert np.abs(frame.rotate(UP) - UP).max() < 1e-12
    assert frame.xyz[2] == 0
    there = level_frame(replace(view, world_from_camera=motion @ seen))
    assert np.abs(there.xyz - (motion @ frame).xyz).max() < 1e-9 * max(1.0, float(np.abs(seen.xyz).max()))


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
