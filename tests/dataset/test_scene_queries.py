"""Tests of queries: their parts, pivots and guesses, the drawn one, and the independence of the draws."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from scipy.spatial.transform import Rotation

from kit1000.dataset.json_rows import pose_of
from kit1000.dataset.scene_queries import PAPER_TILT, eligible, largest_roll_or_pitch
from kit1000.errors import InputError
from kit1000.pose import Pose, quaternion_angle
from kit1000.queries.guesses import FIXED_LEVELS, LEVELS, level_angle, level_offset
from kit1000.queries.motions import apply_error, error_of
from kit1000.queries.pivots import part_pivots
from kit1000.queries.tracks import CURVES, PAPER_TRACKS, TRACKS, curve_id, curve_levels, has_curves
from kit1000.sim.layout import TUMBLED
from kit1000.values import FIRST_PART_LABEL
from tests.samples.queries import PARTS, SCENE, SceneArguments, images, part, scene_arguments
from tests.samples.strategies import poses

PAPER = {"snap-tilt", "place-paper"}


def test_every_track_has_queries_about_its_parts() -> None:
    found = {(row["track"], row["part"]) for row in scene_arguments().rows()}
    expected = {track: [0, 1, 2, 3] for track in ("snap", "snap-tilt", "snap-d415", "snap-photoneo")}
    expected |= {"place": [0, 1, 3], "place-d415": [0, 1, 3], "place-photoneo": [0, 1, 3], "place-paper": [0, 3]}
    assert found == {(track, i) for track, parts in expected.items() for i in parts}


def test_the_tracks_of_the_paper_ask_nothing_in_a_crowded_scene() -> None:
    asked, crowded = scene_arguments(curves=True).by_id(), scene_arguments(curves=True, crowded=True).by_id()
    assert {row["track"] for row in asked.values()} - {row["track"] for row in crowded.values()} == PAPER
    assert crowded == {i: row for i, row in asked.items() if row["track"] not in PAPER}
    assert {*PAPER_TRACKS.values()} == PAPER


def test_rows_have_the_fields_of_the_format() -> None:
    for row in scene_arguments().rows():
        assert set(row) == {"id", "track", "sensor", "part", "drawn", "pivot", "guess"}
        assert row["id"] == f"{SCENE}-p{row['part']}-{row['track']}"
        assert row["sensor"] == (
            row["track"].partition("-")[2] if row["track"].endswith(("d415", "photoneo")) else "ideal"
        )
        assert (row["guess"] is not None) == row["track"].startswith("snap")
        assert len(row["pivot"]) == 3


def test_truths_contain_the_draws() -> None:
    rows, truths = scene_arguments(curves=True).queries_and_truths()
    parts = scene_arguments().parts
    assert list(truths) == [row["id"] for row in rows]
    for row in rows:
        truth = truths[row["id"]]
        goal, draw = pose_of(truth["goal_drawn"]), truth["draw"]
        assert truth["part"] == row["part"]
        candidate = parts[row["part"]]
        if draw is None:
            assert row["guess"] is None
            assert same(goal @ candidate.world_from_part, candidate.world_from_kit @ candidate.slot.kit_from_part)
        else:
            assert same(goal, candidate.motion(draw["goal"], draw["turn"]))
            offset, rotvec = np.array(draw["offset"]), np.array(draw["rotvec"])
            assert same(pose_of(row["guess"]), apply_error(goal, np.array(row["pivot"]), offset, rotvec))


def same(a: Pose, b: Pose, tolerance: float = 1e-9) -> bool:
    return bool(np.abs(a.xyz - b.xyz).max() < tolerance and quaternion_angle(a.wxyz, b.wxyz) < tolerance)


def test_queries_of_a_sensor_use_its_own_pivot() -> None:
    views, labels = images()
    for row in scene_arguments().rows():
        assert row["pivot"] == part_pivots(views[row["sensor"]], labels)[row["part"]].tolist()


def test_a_part_without_a_return_has_no_query_of_that_sensor() -> None:
    views, labels = images()
    blind = np.where(labels == FIRST_PART_LABEL + 1, 0, views["d415"].depth)
    less = scene_arguments(views=views | {"d415": replace(views["d415"], depth=blind)}).by_id()
    whole = scene_arguments().by_id()
    assert set(whole) - set(less) == {f"{SCENE}-p1-snap-d415", f"{SCENE}-p1-place-d415"}
    only = scene_arguments(views={"ideal": views["ideal"]}).by_id()
    assert only.keys() == {i for i in whole if not i.endswith(("d415", "photoneo"))}


def test_alone_one_track_asks_and_its_queries_are_the_same_as_otherwise() -> None:
    found: Counter[str] = Counter()
    for seed in range(120):
        alone = scene_arguments(seed=seed, alone=True).by_id()
        (track,) = {row["track"] for row in alone.values()}
        if seed < 20:
            everything = scene_arguments(seed=seed).by_id()
            assert alone == {i: row for i, row in everything.items() if row["track"] == track}
        found[track] += 1
    assert found.keys() == TRACKS.keys()
    paper = sum(found[track] for track in PAPER) / 2  # twice as often as others, as they do not ask in crowded scenes
    others = sum(found[track] for track in TRACKS.keys() - PAPER) / 6
    assert 1.5 < paper / others < 2.6


def test_alone_a_track_asks_only_where_it_has_a_part_to_ask_about() -> None:
    tumbled = scene_arguments(parts=scene_arguments().parts[2:3], alone=True)
    crowded = scene_arguments(alone=True, crowded=True)
    snaps = {"snap", "snap-tilt", "snap-d415", "snap-photoneo"}
    for seed in range(20):
        assert {row["track"] for row in replace(tumbled, seed=seed).rows()} < snaps
        assert {row["track"] for row in replace(crowded, seed=seed).rows()}.isdisjoint(PAPER)
    assert not scene_arguments(parts=scene_arguments().parts[4:], alone=True).rows()


def test_the_drawn_part_of_a_track_is_the_target_where_it_has_a_query() -> None:
    for target in range(PARTS):
        rows = scene_arguments(target=target).rows()
        for track in TRACKS:
            chosen = [row["part"] for row in rows if row["track"] == track and row["drawn"]]
            with_query = [row["part"] for row in rows if row["track"] == track]
            assert len(chosen) == 1
            assert chosen == [target] or target not in with_query


def test_another_part_is_drawn_uniformly_where_the_target_has_no_query() -> None:
    views, _ = images()
    arguments = scene_arguments(target=2, views={"ideal": views["ideal"]})
    rows = [row for seed in range(40) for row in replace(arguments, seed=seed).rows() if row["track"] == "place"]
    picked = Counter(row["part"] for row in rows if row["drawn"])
    assert picked.keys() == {0, 1, 3}
    assert min(picked.values()) >= 6


@given(poses())
def test_roll_and_pitch_are_those_of_scipy(pose: Pose) -> None:
    roll, pitch, _ = _scipy_angles(pose)
    assume(abs(pitch) < np.radians(89.9))  # beyond, roll and yaw are one
    assert largest_roll_or_pitch(pose) == pytest.approx(max(abs(roll), abs(pitch)), abs=1e-7)


def _scipy_angles(pose: Pose) -> np.ndarray:
    """Roll, pitch, yaw [rad] about the fixed x, y, z, in this order."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # where x and z fall together it chooses a yaw, and says so
        return Rotation.from_quat(pose.wxyz[[1, 2, 3, 0]]).as_euler("xyz")


@pytest.mark.parametrize("goals", [1, 6])
def test_place_paper_has_only_nearly_level_goals(goals: int) -> None:
    for index in range(40):
        candidate = part(index, tilt_deg=index * 45 / 39, goals=goals)
        angles = [_scipy_angles(candidate.motion(goal))[:2] for goal in range(goals)]
        expected = min(np.abs(pair).max() for pair in angles) <= PAPER_TILT
        assert eligible(TRACKS["place-paper"], candidate) == expected
        assert eligible(TRACKS["place"], candidate)
        assert not eligible(TRACKS["place-paper"], replace(candidate, rest_mode=TUMBLED))


def test_a_part_with_a_free_axis_is_level_if_some_angle_is() -> None:
    # The motion leans by the tilt t towards an azimuth that the free turn chooses: best half way between roll and
    # pitch, where sin(t) = sqrt(2) sin(pitch), sin(roll) = tan(pitch); the smaller limit is that of pitch and roll 15.
    limit = _steepest_free_tilt()
    assert 20 < limit < 22
    for tilt_deg in (5.0, 16.0, limit - 0.1, limit + 0.1, 30.0):
        for index in range(6):
            candidate = part(index, tilt_deg, free=True)
            assert eligible(TRACKS["place-paper"], candidate) == (tilt_deg < limit)


def _steepest_free_tilt() -> float:
    """The largest tilt [deg] of a rotation with roll and pitch of 15 degrees."""
    up = Rotation.from_euler("xyz", [15, 15, 0], degrees=True).inv().apply([0, 0, 1])
    return float(np.degrees(np.arctan2(np.linalg.norm(up[:2]), up[2])))


@pytest.mark.parametrize(
    "change",
    [
        lambda s: replace(s, parts=s.parts[1:3]),
        lambda s: replace(s, parts=s.parts[::-1]),
        lambda s: replace(s, views={"ideal": s.views["ideal"]}),
        lambda s: replace(s, curves=True),
        lambda s: replace(s, parts=(*s.parts[:3], replace(s.parts[3], rest_mode=TUMBLED), s.parts[4])),
        lambda s: replace(s, target=2),
    ],
    ids=["parts left out", "other order", "sensor left out", "curves", "other rest", "other target"],
)
def test_queries_do_not_depend_on_each_other(change: Callable[[SceneArguments], SceneArguments]) -> None:
    before, after = scene_arguments().queries_and_truths(), change(scene_arguments()).queries_and_truths()
    rows = [{row["id"]: row | {"drawn": None} for row in rows} for rows, _ in (before, after)]
    for query_id in rows[0].keys() & rows[1].keys():
        assert rows[0][query_id] == rows[1][query_id]
        assert before[1][query_id] == after[1][query_id]


def test_draws_differ_between_tracks_parts_scenes_and_seeds() -> None:
    variants = [scene_arguments(), scene_arguments(seed=4), scene_arguments(scene_id="test-s0008")]
    offsets = [
        tuple(truth["draw"]["offset"])
        for arguments in variants
        for query_id, truth in arguments.queries_and_truths()[1].items()
        if truth["draw"] is not None
    ]
    assert len({*offsets}) == len(offsets) == 4 * 12


def test_curves_have_every_level_of_one_error_at_fixed_levels_of_the_other() -> None:
    rows, truths = scene_arguments(curves=True).queries_and_truths()
    curves = {row["id"]: row for row in rows if row["track"] == CURVES}
    assert len(curves) == 2 * LEVELS * len(FIXED_LEVELS) == 48
    assert {curve_levels(query_id) for query_id in curves} == {
        (runs, k, j) for runs in ("pos", "rot") for k in range(LEVELS) for j in FIXED_LEVELS
    }
    goals, directions, axes = set(), set(), set()
    for query_id, row in curves.items():
        runs, level, fixed = curve_levels(query_id)
        k, j = (level, fixed) if runs == "pos" else (fixed, level)
        goal = pose_of(truths[query_id]["goal_drawn"])
        offset, rotvec = error_of(pose_of(row["guess"]), goal, np.array(row["pivot"]))
        assert np.linalg.norm(offset) == pytest.approx(level_offset(k), abs=1e-11)
        assert np.linalg.norm(rotvec) == pytest.approx(level_angle(j), abs=1e-11)
        directions |= {tuple(np.round(offset / level_offset(k), 6))} if k else set()
        axes |= {tuple(np.round(rotvec / level_angle(j), 6))} if j else set()
        goals |= {str(truths[query_id]["goal_drawn"])}
        assert row["drawn"]
        assert row["sensor"] == "ideal"
    assert len(goals) == len(directions) == len(axes) == 1


def test_ids_of_curves_are_read_back() -> None:
    assert curve_id(SCENE, 2, "pos", 3, 1) == "curves-s0007-p2-pos3-rot1"
    assert curve_id(SCENE, 2, "rot", 3, 1) == "curves-s0007-p2-rot3-pos1"
    for query_id in ("test-s0007-p2-snap", "curves-s0007-p2-pos3", "curves-s0007-p2-pos3-pos1"):
        with pytest.raises(InputError, match="expected one of the curves, such as"):
            curve_levels(query_id)


def test_ids_are_unique_and_safe_in_a_spreadsheet() -> None:
    ids = [row["id"] for row in scene_arguments(curves=True).rows()]
    assert len(set(ids)) == len(ids)
    for query_id in ids:
        assert query_id[0].isalpha()
        assert set(query_id) <= set("abcdefghijklmnopqrstuvwxyz0123456789-")
        with pytest.raises(ValueError, match="could not convert"):
            float(query_id)


def test_curves_belong_to_the_first_test_scenes() -> None:
    assert [has_curves(i, 40) for i in ("test-s0039", "test-s0040", "val-s0001")] == [True, False, False]
