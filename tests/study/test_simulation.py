"""Simulated operators: laws of their models, and a study carried out by them on a small dataset."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.cli import main
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET
from kit1000.queries.motions import error_of
from kit1000.study.conditions import CONDITIONS
from kit1000.study.finished_trials import read_participants
from kit1000.study.operators import OPERATORS, Aim, Hand, difficulty, drag, operator_of, point
from kit1000.study.study_plan import StudyPlan, read_plan, write_plan
from kit1000.study.tasks import SIZES, Task, Tasks, choose_tasks
from kit1000.values import Query, TrueGeometry
from tests.samples.studies import FITTS

AIM = Aim(
    Pose.from_translation((0.0, 0.4, 0.05)) @ Pose.from_rotvec((0.0, 0.0, 1.0)),
    np.array([0.05, -0.2, 0.02]),
    np.array([0.0, 0.0, 1.0]),
    (np.array([0.2, 0.2, 0.07]),),
)


def near(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    """A method that finds nothing better than the guess."""
    assert query.guess is not None
    return PredictedMotion(query.guess, 0.5)


def hand(name: str, condition: str = "scene", seed: int = 0) -> Hand:
    return Hand(operator_of(name), CONDITIONS[condition], 1.0, np.random.default_rng(seed))


@given(st.sampled_from(sorted(CONDITIONS)), st.integers(0, 99))
def test_the_exact_operator_is_exact(condition: str, seed: int) -> None:
    put = hand("exact", condition, seed).put(AIM)
    assert put.motion is AIM.goal
    assert not put.lapse
    assert put.seconds > 1


@given(st.sampled_from(sorted(CONDITIONS)), st.integers(0, 99))
def test_the_papers_operator_stays_in_the_ball(condition: str, seed: int) -> None:
    put = hand("paper", condition, seed).put(AIM)
    offset, rotvec = error_of(put.motion, AIM.goal, AIM.pivot)
    assert np.abs(offset).max() <= MAX_OFFSET + 1e-12
    assert np.linalg.norm(rotvec) <= MAX_ANGLE + 1e-9


def test_hands_scatter_as_wide_as_their_target() -> None:
    """Across the view the standard deviation is the width of the target over 4.133."""
    errors = {}
    for condition, width in (("scene", 5e-3), ("scene-snap", 20e-3)):
        someone = hand("fitts", condition)
        puts = [someone.put(replace(AIM, others=())) for _ in range(150)]
        errors[condition] = np.array([error_of(put.motion, AIM.goal, AIM.pivot)[0] for put in puts])
        assert errors[condition][:, 0].std() == pytest.approx(width / 4.133, rel=0.18)
        assert errors[condition][:, 1].std() > 1.05 * errors[condition][:, 0].std()  # the view is slanted
        assert np.abs(errors[condition][:, 2]).max() < 1e-12  # on the plate


def test_the_careless_lapse_twice_as_often() -> None:
    people = {name: hand(name) for name in OPERATORS}
    puts = {"exact": 20, "paper": 20, "fitts": 300, "careless": 300}
    rates = {name: np.mean([people[name].put(AIM).lapse for _ in range(n)]) for name, n in puts.items()}
    assert rates["exact"] == rates["paper"] == 0
    assert rates["fitts"] == pytest.approx(0.05, abs=0.038)  # three standard errors
    assert rates["careless"] == pytest.approx(0.10, abs=0.052)


def test_what_is_right_is_always_taken() -> None:
    for name in OPERATORS:
        assert all(hand(name, seed=i).accepts(True) for i in range(50))
    assert not any(hand("exact", seed=i).accepts(False) for i in range(50))


def test_times_follow_fitts() -> None:
    """A movement of 7 widths has 3 bits; twice the distance and width take the same time."""
    assert difficulty(0.7, 0.1) == pytest.approx(3)
    assert point(0.7, 0.1) == pytest.approx(-0.107 + 3 * 0.223 + 0.1)
    assert drag(0.7, 0.1) == pytest.approx(0.135 + 3 * 0.249) == pytest.approx(drag(1.4, 0.2))
    seconds = [hand("exact", name).put(AIM).seconds for name in ("scene-snap", "scene", "hand", "hand-bare")]
    assert seconds == sorted(seconds)


def test_an_unknown_operator_is_answered_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="did you mean fitts"):
        operator_of("fits")


@pytest.fixture(scope="module")
def small_plan(mini: Path) -> StudyPlan:
    """Four people, whose tasks are scenes of a small dataset, as large as they are."""
    split = Dataset(mini).split("test-all", truth=True)
    sizes = {scene.id: len(scene.scene.bodies) - 1 for scene in split}
    tasks = [Task(i, size) for i, size in sizes.items() if _all_asked(split.scene(i), size)]
    assert tasks
    some = tuple(tasks[k % len(tasks)] for k in range(len(SIZES)))
    return StudyPlan(
        Dataset(mini).id,
        "ideal",
        f"{__name__}:near",
        ("scene-snap", "hand"),
        4,
        3,
        Tasks(tasks[0], (some, some)),
    )


def _all_asked(scene: object, size: int) -> bool:
    queries = scene.queries  # type: ignore[attr-defined]
    return {query.part for query in queries if query.track == "snap"} == set(range(size))


def files_of(folder: Path) -> dict[str, bytes]:
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def test_a_simulated_study_is_whole(
    mini: Path, small_plan: StudyPlan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the command. What is done stays; what an interruption took away comes again, to the last byte."""
    write_plan(tmp_path, small_plan)
    arguments = ["study", str(mini), "--out", str(tmp_path), "--simulate", "fitts", "--judge", "test"]
    assert main([*arguments, "--report"]) == 0
    folder = tmp_path / "simulated/fitts"
    assert capsys.readouterr().out.splitlines() == [str(folder), str(folder / "report.html")]
    assert "SIMULATED" in (folder / "report.html").read_text()
    whole, trials = files_of(tmp_path), sorted(folder.rglob("trial.json"))
    stamp = trials[0].stat().st_mtime_ns
    for path in trials[2::3]:
        path.unlink()
    with open(trials[2].parent / "events.jsonl", "ab") as log:
        log.write(b'{"cut": ')
    assert main(arguments) == 0
    assert files_of(tmp_path) == whole
    assert trials[0].stat().st_mtime_ns == stamp
    people = read_participants(tmp_path, read_plan(tmp_path), FITTS)
    assert [len(person.trials) for person in people] == [8] * 4
    assert not any(person.ratings for person in people)
    for trial in (trial for person in people for trial in person.trials):
        assert trial.out_of_time == any(part.outcome == "not uploaded" for part in trial.parts)
        if trial.condition == "scene-snap":
            assert trial.specification_s < 60 * trial.kits
            assert trial.uploads == 1
    rows = [json.loads(line) for name, text in whole.items() if name.endswith("jsonl") for line in text.splitlines()]
    assert {row["operator"] for row in rows} == {"simulated fitts"}
    assert {row["participant"] for row in rows} == {1, 2, 3, 4}
    assert main([*arguments[:-1], "robot"]) == 2
    assert "go on with --judge test, or choose another --out" in capsys.readouterr().err


@pytest.mark.parametrize(
    "option", ["--people 8", "--conditions scene hand", "--sensor d415", "--snap none", "--seed 0"], ids=str.split
)
def test_an_option_that_contradicts_the_plan_is_refused(
    mini: Path, small_plan: StudyPlan, tmp_path: Path, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_plan(tmp_path, small_plan)
    assert main(["study", str(mini), "--out", str(tmp_path), *option.split()]) == 2
    assert f"{option}: {tmp_path} is planned otherwise" in capsys.readouterr().err


def test_tasks_are_those_that_the_robot_manages(mini: Path) -> None:
    """Too few scenes of a size are named; a fixed seed draws the same tasks."""
    dataset = Dataset(mini)
    with pytest.raises(InputError, match=r"scenes with 2 kits.*generate the preset study"):
        choose_tasks(dataset, 2, "ideal", 0, lambda scene: True)
