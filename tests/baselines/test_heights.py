"""Height maps from three cameras: cells, shells, and queries with all their goals."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baselines.heights.maps import UNSEEN, HeightMap, envelopes
from baselines.heights.scene_heights import CELL, RecordedHeights, RenderedHeights
from baselines.heights.shell import shell_points
from baselines.training.tasks.goal_draws import QueryDraws, goal_motions
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.rng import stream


@given(st.integers(0, 7), st.integers(0, 5), st.floats(0.01, 0.99), st.floats(0.01, 0.99))
def test_a_point_is_read_back_from_the_cell_that_holds_it(i: int, j: int, x: float, y: float) -> None:
    heights = np.arange(48, dtype=np.float32).reshape(8, 6)
    field = HeightMap(np.array([-1.0, 2.0]), 0.5, heights)
    assert field.at(np.array([-1 + (i + x) * 0.5, 2 + (j + y) * 0.5])) == heights[i, j]
    middle = field.points()[i * 6 + j]
    assert middle == pytest.approx((-1 + (i + 0.5) * 0.5, 2 + (j + 0.5) * 0.5, heights[i, j]))


def test_nothing_is_seen_outside_a_map() -> None:
    field = HeightMap(np.zeros(2), 1.0, np.ones((2, 2), np.float32))
    assert (field.at(np.array([(-0.1, 1.0), (1.0, 2.1), (5.0, 5.0)])) == UNSEEN).all()


def test_envelopes_hold_the_highest_and_the_lowest_point_of_each_cell() -> None:
    points = stream(0, "envelopes").uniform(-3, 3, (500, 3))
    top, bottom, seen = envelopes(points, (8, 6), 0.5)
    index = np.floor(points[:, :2] / 0.5 + (4, 3)).astype(int)
    for i, j in np.ndindex(8, 6):
        z = points[(index == (i, j)).all(1), 2].astype(np.float32)
        assert seen[i, j] == (len(z) > 0)
        assert (top[i, j], bottom[i, j]) == ((z.max(), z.min()) if len(z) else (0, 0))


def test_the_shell_of_a_block_has_its_top_its_floor_and_its_walls() -> None:
    heights = np.full((30, 30), UNSEEN, np.float32)
    heights[10:20, 5:25] = 0.02
    shell = shell_points(HeightMap(np.zeros(2), CELL, heights))
    levels = np.unique(shell[:, 2].round(6))
    assert levels[0] == 0
    assert levels[-1] == pytest.approx(0.02)
    assert (np.diff(levels) <= 0.0021).all()
    between = shell[(shell[:, 2] > 0.001) & (shell[:, 2] < 0.019)]
    cells = np.unique(np.floor(between[:, :2] / CELL).astype(int), axis=0)
    assert len(cells) == 2 * 10 + 2 * 20 - 4  # the outline alone


def test_rendered_maps_are_those_of_the_recorded_cameras(mini: Path, tmp_path: Path) -> None:
    dataset = Dataset(mini)
    recorded, rendered = RecordedHeights(dataset), RenderedHeights(dataset, tmp_path)
    for query in [query for query in dataset.split("test").queries() if query.sensor == "ideal"][:3]:
        ours = recorded.of(query)
        for theirs in (rendered.of(query.scene_id), RenderedHeights(dataset, tmp_path).of(query.scene_id)):
            assert (
                np.abs(ours.kits.heights - theirs.kits.heights).max() < 1e-5
            )  # heights are stored in units of 0.01 mm
            assert np.abs(ours.parts[query.part].heights - theirs.parts[query.part].heights).max() < 1e-5
            assert (ours.middle == theirs.middle).all()


def test_a_part_stands_in_its_map_and_nowhere_else(mini: Path, tmp_path: Path) -> None:
    dataset = Dataset(mini)
    scene = next(iter(dataset.split("train", truth=True)))
    heights = RenderedHeights(dataset, tmp_path).of(scene.id)
    for query in [query for query in scene.queries if query.track == "snap"]:
        truth = scene.truth_of(query.id)
        vertices = truth.world_from_part.apply(dataset.geometry.part(truth.part_id).mesh.vertices)
        points = heights.parts[query.part].points()
        assert len(points) > 50
        assert (points.min(0) > vertices.min(0) - 0.003).all()
        assert (points.max(0) < vertices.max(0) + 0.003).all()
        assert points[:, 2].max() == pytest.approx(vertices[:, 2].max(), abs=0.002)


def test_scenes_without_the_three_cameras_are_refused(mini: Path) -> None:
    dataset = Dataset(mini)
    with pytest.raises(InputError, match="three"):
        RecordedHeights(dataset).of(next(dataset.split("val").queries()))


def test_the_drawn_goal_is_among_all_goals_unless_it_is_free_to_turn(mini: Path) -> None:
    for scene in Dataset(mini).split("train", truth=True):
        for truth in scene.truths.values():
            goals = goal_motions(truth)
            apart = (goals.inverse() @ truth.goal_drawn).angle().min()
            assert apart < (1e-6 if truth.slot.free_axis is None else np.radians(7.6))


def test_fresh_guesses_are_within_their_errors_and_stored_ones_are_those_of_the_dataset(
    mini: Path, tmp_path: Path
) -> None:
    dataset = Dataset(mini)
    draws = QueryDraws(dataset, "train", RenderedHeights(dataset, tmp_path))
    assert draws.draw(stream(0, "a"), "place").guess is None
    for guesses in ("ball", "tilt"):
        sample = draws.draw(stream(0, guesses), guesses)
        assert sample.guess is not None
        offsets = sample.goals.apply(sample.query.pivot) - sample.guess.apply(sample.query.pivot)
        turns = (sample.goals @ sample.guess.inverse()).angle()
        assert ((np.abs(offsets).max(1) < 0.0281) & (turns < np.radians(27.51 + 7.5))).any()
    key = draws.queries.keys("snap", 1)[0]
    stored = draws.stored(key)
    assert isinstance(stored.guess, Pose)
    assert stored.query.id == key
    with pytest.raises(InputError, match="no query"):
        draws.stored(f"{key}x")
