"""Environments of gymnasium: they pass its own check, and score as the metrics do."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kit1000.errors import InputError
from kit1000.gym import AssemblyEnv, motion_vector
from kit1000.metrics import seatings
from kit1000.pose import Pose

gymnasium = pytest.importorskip("gymnasium", reason="pip install 'kit1000[gym]'")
SNAP, PLACE = "kit1000.gym:kit1000/Snap-v0", "kit1000.gym:kit1000/Place-v0"


def make(name: str, data: Path, **options: Any) -> AssemblyEnv:
    return gymnasium.make(name, data=data, **{"split": "val", **options}).unwrapped


@pytest.mark.parametrize(("name", "sensor"), [(SNAP, "ideal"), (SNAP, "d415"), (PLACE, "ideal")])
def test_the_check_of_gymnasium_passes_without_a_warning(mini: Path, name: str, sensor: str) -> None:
    check_env = pytest.importorskip("gymnasium.utils.env_checker").check_env
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(make(name, mini, split="train", sensor=sensor))


def test_the_true_motion_scores_one_and_the_guess_as_the_metrics_say(mini: Path) -> None:
    env = make(SNAP, mini, split="test-all")
    for name in env.scenes:
        observation, _ = env.reset(options={"query": name})
        truth = env.dataset.truth_of(env.query)
        _, reward, terminated, truncated, info = env.step(motion_vector(truth.goal_drawn))
        assert (reward, terminated, truncated) == (1.0, True, False)
        assert info["position"] < 1e-6
        guess = Pose(observation["guess"][:4], observation["guess"][4:])
        expected = seatings(Pose.stack([guess]), [truth], env.dataset.geometry).seated[0]
        assert env.step(observation["guess"])[1] == float(expected)


def test_a_seed_chooses_the_query(mini: Path) -> None:
    env = make(SNAP, mini, split="train")
    chosen = [env.reset(seed=seed)[1]["query"] for seed in (*range(8), *range(8))]
    assert chosen[:8] == chosen[8:]
    assert len(set(chosen)) > 1


def test_an_observation_is_that_of_the_query(mini: Path) -> None:
    env = make(SNAP, mini)
    observation, info = env.reset(seed=0)
    assert info == {"query": env.query.id}
    np.testing.assert_array_equal(observation["depth"], env.query.view.depth)
    np.testing.assert_array_equal(observation["part"], env.query.part_mask)
    observation["depth"][:] = 0  # the user's own
    assert env.query.view.depth.any()
    found = make(SNAP, mini, masks="found").reset(options={"query": env.query.id})[0]
    both = (found["part"] & observation["part"]).sum()
    assert both > 0.8 * observation["part"].sum()


def test_environments_run_beside_each_other(mini: Path) -> None:
    envs = gymnasium.make_vec(SNAP, num_envs=2, vectorization_mode="async", data=mini, split="train")
    observation, _ = envs.reset(seed=1)
    _, reward, terminated, _, info = envs.step(observation["guess"])
    envs.close()
    assert reward.shape == (2,)
    assert terminated.all()
    assert info["position"].shape == (2,)


@pytest.mark.parametrize("action", [np.zeros(7), np.ones(6), np.full(7, np.nan)])
def test_what_is_no_motion_is_refused(mini: Path, action: np.ndarray) -> None:
    env = make(SNAP, mini)
    env.reset(seed=0)
    with pytest.raises(InputError, match="action: expected a quaternion"):
        env.step(action)


def test_unknown_options_are_refused(mini: Path) -> None:
    for wrong in ({"task": "stack"}, {"sensor": "sonar"}, {"masks": "guessed"}):
        with pytest.raises(InputError):
            make(SNAP, mini, **wrong)
    with pytest.raises(InputError, match="no query 'p7'"):
        make(SNAP, mini).reset(options={"query": "p7"})
