"""Laws of the reference methods: what each is said to be it is, and controls score what they must."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from baselines.methods import EVERY, GUESSED, METHODS, Method, described, made, method_of, resolved, source_hash
from baselines.points import seen_points
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.motions import error_of, goal_motion, goal_pose
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.testing import check_predictor
from kit1000.values import Query, Truth

Asked = list[tuple[Query, Truth]]
CONTROLS = [name for name, method in METHODS.items() if method.control]


@pytest.fixture(scope="module")
def data(mini: Path) -> Dataset:
    return Dataset(mini)


@pytest.fixture(scope="module")
def asked(data: Dataset) -> Asked:
    split = data.split("train", truth=True)
    return [(query, scene.truth_of(query.id)) for scene in split for query in scene.queries]


def answers(name: str, data: Dataset, asked: Asked, seed: int = 0) -> list[tuple[Query, Truth, Pose]]:
    """A method's answers to the queries of its tracks."""
    method = METHODS[name]
    predictor = made(method, data, seed)
    mine = [(query, truth) for query, truth in asked if query.track in method.tracks]
    handed = [truth if method.uses_true_geometry else None for _, truth in mine]
    motions = [predictor(query, given).goal_from_now for (query, _), given in zip(mine, handed, strict=True)]
    return [(query, truth, motion) for (query, truth), motion in zip(mine, motions, strict=True)]


@pytest.mark.parametrize("name", METHODS)
def test_a_method_says_the_same_in_the_list_and_in_its_code(name: str, data: Dataset) -> None:
    method = METHODS[name]
    assert getattr(made(method, data, 0), "uses_true_geometry", method.uses_true_geometry) == method.uses_true_geometry
    assert set(method.tracks) <= set(EVERY)
    assert described(name, method).startswith(name)
    assert "\n" not in described(name, method)


@pytest.mark.parametrize("name", CONTROLS)
def test_controls_conform(name: str, data: Dataset, asked: Asked) -> None:
    method = METHODS[name]
    mine = [(query, truth) for query, truth in asked if query.track in method.tracks]
    queries, truths = [query for query, _ in mine], [truth for _, truth in mine]
    draws = name in ("truth-noise", "chance")  # along the axes of the world
    check_predictor(
        made(method, data, 0), queries, truths if method.uses_true_geometry else None, name, moves=not draws
    )


def test_the_truth_is_a_goal(data: Dataset, asked: Asked) -> None:
    for _, truth, answer in answers("truth", data, asked):
        np.testing.assert_array_equal(answer.xyz, truth.goal_drawn.xyz)
        np.testing.assert_array_equal(answer.wxyz, truth.goal_drawn.wxyz)


def test_a_symmetric_truth_is_some_goal_turned_about_the_free_axis(data: Dataset, asked: Asked) -> None:
    for _, truth, answer in answers("truth-symmetric", data, asked):
        slot = truth.slot
        turns = np.linspace(0, 2 * np.pi, 100_001) if slot.free_axis is not None else 0.0
        goals = [
            goal_motion(truth.world_from_part, truth.world_from_kit, goal_pose(slot, i, turns))
            for i in range(len(slot.goals))
        ]
        nearest = min(float((goal.inverse() @ answer).angle().min()) for goal in goals)
        shifts = [np.linalg.norm(goal.apply(truth.anchor) - answer.apply(truth.anchor), axis=-1) for goal in goals]
        assert nearest < 1e-4
        assert min(float(shift.min()) for shift in shifts) < 1e-5


def test_noise_is_two_millimetres_and_two_degrees_at_the_anchor(data: Dataset, asked: Asked) -> None:
    for _, truth, answer in answers("truth-noise", data, asked):
        home = truth.goal_drawn.apply(truth.anchor)
        assert np.linalg.norm(answer.apply(truth.anchor) - home) == pytest.approx(2e-3, abs=1e-12)
        assert (answer @ truth.goal_drawn.inverse()).angle() == pytest.approx(np.radians(2), abs=1e-9)


def test_the_guess_is_the_guess(data: Dataset, asked: Asked) -> None:
    found = answers("guess", data, asked)
    assert {query.track for query, _, _ in found} == {"snap", "snap-tilt", "snap-d415"}
    assert all(answer is query.guess for query, _, answer in found)
    assert all(query.guess is None for query, _ in asked if query.track not in GUESSED)
    without = next(query for query, _ in asked if query.guess is None)
    with pytest.raises(InputError, match=f"{without.id}: nobody guesses in track {without.track}"):
        made(METHODS["guess"], data, 0)(without, None)


def test_chance_stays_near_a_guess_and_else_goes_to_the_kits_at_any_yaw(data: Dataset, asked: Asked) -> None:
    for query, _, answer in answers("chance", data, asked):
        if query.guess is not None:
            offset, turn = error_of(answer, query.guess, query.pivot)
            assert np.abs(offset).max() <= 28e-3
            assert np.linalg.norm(turn) <= np.radians(27.5) + 1e-9
            continue
        there = answer.apply(query.pivot)
        assert np.linalg.norm(seen_points(query, query.kit_region) - there, axis=1).min() < 1e-9
        np.testing.assert_allclose(answer.rotate((0.0, 0.0, 1.0)), (0, 0, 1), atol=1e-12)


@pytest.mark.parametrize("name", ["truth-symmetric", "truth-noise", "chance"])
def test_draws_follow_the_seed(name: str, data: Dataset, asked: Asked) -> None:
    drawn = [[(*answer.wxyz, *answer.xyz) for *_, answer in answers(name, data, asked, seed)] for seed in (0, 0, 1)]
    assert drawn[0] == drawn[1]
    assert drawn[0] != drawn[2]


@pytest.mark.parametrize("name", ["truth", "truth-symmetric", "truth-noise"])
def test_a_control_without_the_truth_says_so(name: str, data: Dataset, asked: Asked) -> None:
    with pytest.raises(InputError, match="made from the truth"):
        made(METHODS[name], data, 0)(asked[0][0], None)


def test_points_of_a_mask_are_those_it_shows(asked: Asked) -> None:
    query, _ = asked[0]
    points = seen_points(query, query.part_mask)
    uv = query.view.camera.project(query.view.world_from_camera.inverse().apply(points))
    u, v = np.rint(uv).astype(int).T
    assert query.part_mask[v, u].all()
    assert len(points) == (query.part_mask & (query.view.depth > 0)).sum()
    np.testing.assert_allclose((points.min(0) + points.max(0)) / 2, query.pivot, atol=1e-4)
    few = seen_points(query, query.part_mask, 100)
    assert 50 < len(few) <= 100
    assert (few[:, None] == points).all(2).any(1).all()
    assert seen_points(query, np.zeros_like(query.part_mask), 100).shape == (0, 3)


class Own:
    """A method of one's own.

    More of it.
    """

    tracks = ("place",)
    learned = True

    def __init__(self, dataset: Dataset, seed: int) -> None:
        self.dataset, self.seed = dataset, seed

    def __call__(self, query: Query, truth: Truth | None) -> PredictedMotion:
        return PredictedMotion(Pose.identity(), 1.0)


def test_a_method_of_ones_own_is_made_from_its_module(data: Dataset) -> None:
    method = method_of(f"{__name__}:Own")
    assert method == Method(f"{__name__}:Own", "A method of one's own.", tracks=("place",), learned=True)
    predictor = made(method, data, 3)
    assert isinstance(predictor, Own)
    assert (predictor.dataset, predictor.seed) == (data, 3)
    assert made(method_of("baselines.controls:guess"), data, 0) is resolved("baselines.controls:guess")
    assert method_of("baselines.controls:NoisyGoal").uses_true_geometry
    assert not method_of("baselines.registration:Registration").uses_true_geometry  # its instances know


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("gues", "no method 'gues'; did you mean guess[?] there are truth, .*module:Object of your own"),
        ("nowhere:Object", "nowhere:Object: No module named 'nowhere'"),
        ("baselines.controls:Gues", "baselines.controls has no Gues that could be called"),
        ("baselines.controls:NOISE", "has no NOISE that could be called"),
        ("baselines.controls:", "has no object that could be called"),
    ],
)
def test_a_name_that_is_no_method_is_answered_in_one_line(name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        method_of(name)


def test_the_source_of_a_method_is_its_module_or_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "lone_method.py").write_text("def answer(): ...\n")
    (tmp_path / "wide_method").mkdir()
    (tmp_path / "wide_method/__init__.py").write_text("def answer(): ...\n")
    (tmp_path / "wide_method/deep.py").write_text("")
    lone, wide = (Method(f"{name}:answer", "") for name in ("lone_method", "wide_method"))
    before = source_hash(lone), source_hash(wide)
    assert before == (source_hash(lone), source_hash(wide))
    (tmp_path / "wide_method/deep.py").write_text("x = 1\n")
    assert source_hash(lone) == before[0]
    assert source_hash(wide) != before[1]


def test_a_manifest_can_say_all_that_a_method_is() -> None:
    from kit1000.submission import Manifest

    shared = {"description", "tracks", "uses_true_geometry", "learned", "control", "predicts", "training_data"}
    assert shared <= {field.name for field in fields(Manifest)} & {field.name for field in fields(Method)}
