"""Records of a study: they come back as written, and whatever does not belong is refused in one clear line."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from kit1000.cli import main
from kit1000.errors import InputError
from kit1000.study import statistics
from kit1000.study.conditions import CROSSED
from kit1000.study.finished_trials import chosen_operator, operators_of, read_participants
from kit1000.study.study_plan import StudyPlan
from kit1000.study.study_records import PERSON, Operator, read_trial, trial_folder, write_trial
from kit1000.study.study_report import write_report
from tests.samples.studies import FITTS, plan_of, trial_of, write_participant, write_study


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Intervals have tests of their own."""
    monkeypatch.setattr(statistics, "RESAMPLES", 200)


@pytest.fixture
def study(tmp_path: Path) -> tuple[Path, StudyPlan]:
    return tmp_path, write_study(tmp_path, plan_of())


def test_a_trial_comes_back(tmp_path: Path) -> None:
    plan = plan_of()
    session = plan.sessions(3)[1]
    trial = trial_of(plan, FITTS, 3, session, 4, 2, 12.345)
    folder = trial_folder(tmp_path, FITTS, 3, session.position, session.condition.name, 4)
    write_trial(folder, trial)
    assert read_trial(folder / "trial.json", plan.id, FITTS, 3) == trial
    assert trial.seated == 2
    assert folder.relative_to(tmp_path).parts[:3] == ("simulated", "fitts", "p003")


def test_everybody_is_read(study: tuple[Path, StudyPlan]) -> None:
    folder, plan = study
    people = read_participants(folder, plan, PERSON)
    assert [person.number for person in people] == [1, 2, 3, 4]
    assert {len(person.trials) for person in people} == {8}
    assert all(set(person.ratings) == set(plan.conditions) for person in people)
    assert {person.preferred for person in people} == {"scene-snap"}
    assert operators_of(folder) == [PERSON]


def first(folder: Path, name: str) -> Path:
    return sorted(folder.rglob(name))[0]


def edited(name: str, **change: object) -> Callable[[Path], None]:
    """Changes fields of the first file of a name."""

    def change_file(folder: Path) -> None:
        path = first(folder, name)
        path.write_text(json.dumps(json.loads(path.read_text()) | change))

    return change_file


def cut(name: str) -> Callable[[Path], None]:
    def cut_file(folder: Path) -> None:
        path = first(folder, name)
        path.write_bytes(path.read_bytes()[:-20])

    return cut_file


def without(name: str, field: str) -> Callable[[Path], None]:
    def change_file(folder: Path) -> None:
        path = first(folder, name)
        row = json.loads(path.read_text())
        del row[field]
        path.write_text(json.dumps(row))

    return change_file


def copied(source: str, target: str) -> Callable[[Path], None]:
    return lambda folder: shutil.copytree(folder / source, folder / target) and None


HOSTILE = [
    (cut("trial.json"), "no record"),
    (cut("participant.json"), "no record"),
    (edited("trial.json", specification_s="12"), "specification_s: expected seconds"),
    (edited("trial.json", specification_s=-1), "specification_s: expected seconds"),
    (edited("trial.json", uploads=True), "uploads: expected a whole number"),
    (edited("trial.json", parts=[]), "parts: expected one result for each"),
    (edited("trial.json", parts=[3]), "expected an object"),
    (edited("trial.json", task=2), "where the plan has"),
    (edited("trial.json", scene="test-s9999"), "where the plan has"),
    (edited("trial.json", study="0"), "study: expected"),
    (edited("trial.json", participant=2), "participant: expected 1"),
    (edited("trial.json", format="x"), "expected a record of the format"),
    (edited("trial.json", comment="nice"), "no field 'comment'"),
    (without("trial.json", "kits"), "kits is missing"),
    (edited("trial.json", operator={"kind": "simulated", "name": "fitts"}), "never mixed"),
    (
        edited("participant.json", operator={"kind": "simulated", "name": "exact"}),
        "simulated operator \\(exact\\) among",
    ),
    (edited("trial.json", operator=None), "nobody known"),
    (edited("ratings.json", ratings={"mental": 5}), "not rated"),
    (edited("ratings.json", ratings=None), "six numbers"),
    (edited("closing.json", preferred="hand-bare"), "preferred: expected one of"),
    (without("participant.json", "consent"), "no consent"),
    (edited("participant.json", judge="me"), "judge: expected robot or test"),
    (copied("people/p001", "people/p0001"), "there twice"),
    (copied("people/p001", "people/p009"), "participants 1 to 4"),
    (copied("people/p001", "people/anna"), "no folder of a participant"),
    (copied("people/p001/1-hand", "people/p001/3-hand"), "no such condition"),
]


@pytest.mark.parametrize(("damage", "message"), HOSTILE, ids=lambda value: value if isinstance(value, str) else "")
def test_hostile_records_are_refused_in_one_line(
    study: tuple[Path, StudyPlan], damage: Callable[[Path], None], message: str
) -> None:
    folder, plan = study
    if not (folder / "people/p001/1-hand").is_dir():
        (folder / "people/p001/1-hand").mkdir()
    damage(folder)
    with pytest.raises(InputError, match=message) as refusal:
        read_participants(folder, plan, PERSON)
    assert "\n" not in str(refusal.value)
    assert str(folder) in str(refusal.value)


def test_a_simulated_folder_among_people_ends_the_report_with_status_2(
    study: tuple[Path, StudyPlan], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, plan = study
    write_study(folder, plan, FITTS)
    shutil.rmtree(folder / "people/p002")
    shutil.copytree(folder / "simulated/fitts/p002", folder / "people/p002")
    assert main(["study", str(folder), "--out", str(folder), "--report"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "never mixed" in error


def test_a_report_is_about_one_kind(study: tuple[Path, StudyPlan]) -> None:
    folder, plan = study
    exact = Operator("simulated", "exact")
    for operator in (FITTS, exact):
        write_study(folder, plan, operator)
    assert operators_of(folder) == [PERSON, exact, FITTS]
    assert chosen_operator(folder, None) == PERSON
    assert chosen_operator(folder, "fitts") == FITTS
    with pytest.raises(InputError, match="paper"):
        chosen_operator(folder, "paper")
    shutil.rmtree(folder / "people")
    with pytest.raises(InputError, match="several simulated operators"):
        chosen_operator(folder, None)
    shutil.rmtree(folder / "simulated")
    with pytest.raises(InputError, match="--participant 1"):
        chosen_operator(folder, None)


def test_ratings_of_a_simulated_operator_are_refused(tmp_path: Path) -> None:
    plan = write_study(tmp_path, plan_of(), FITTS)
    session = plan.sessions(1)[0]
    source = tmp_path / "simulated/fitts/p001"
    write_participant(tmp_path, plan, PERSON, 1)
    path = source / f"{session.position}-{session.condition.name}" / "ratings.json"
    row = json.loads(first(tmp_path / "people", "ratings.json").read_text())
    path.write_text(json.dumps(row | {"operator": {"kind": "simulated", "name": "fitts"}}))
    with pytest.raises(InputError, match="only people can rate"):
        read_participants(tmp_path, plan, FITTS)


@pytest.mark.parametrize("words", [("human", "fitts"), ("simulated", "human"), ("robot", "x")])
def test_an_operator_is_a_person_or_a_model(words: tuple[str, str]) -> None:
    with pytest.raises(InputError, match="operator"):
        Operator(*words)


def test_a_report_of_people_finds_what_was_put_in(study: tuple[Path, StudyPlan]) -> None:
    folder, _ = study
    page = write_report(folder)
    numbers = json.loads((page.parent / "report.json").read_text())
    rows = {row["name"]: row for row in numbers["outcomes"]}
    change = rows["specification"]["contrasts"][0]
    assert change["low"] < -20 < change["high"]
    assert change["n"] == numbers["n"] == 4
    assert rows["success"]["contrasts"][0]["mean"] == pytest.approx(40, abs=15)  # a part of two or three a task
    assert [row["name"] for row in numbers["ratings"]][-1] == "load"
    assert all(row["contrasts"][0]["p_holm"] >= row["contrasts"][0]["p"] for row in numbers["ratings"][:-1])
    assert numbers["preferred"] == {"scene-snap": 4, "hand": 0}
    text = page.read_text()
    assert "simulated" not in text.replace("simulated robot", "").lower()
    before = page.read_bytes()
    assert write_report(folder).read_bytes() == before


def test_every_title_of_a_simulated_report_says_so(tmp_path: Path) -> None:
    plan = write_study(tmp_path, plan_of(4, CROSSED), FITTS)
    page = write_report(tmp_path, "fitts").read_text()
    for mark in ("<head>", "<h1>", "<h2>", 'class="title"'):
        titles = [title.split("</")[0].lower() for title in page.split(mark)[1:]]
        assert titles
        assert all("simulated" in title for title in titles)
    assert "No person took part" in page
    numbers = json.loads((tmp_path / "simulated/fitts/report.json").read_text())
    assert numbers["operator"] == {"kind": "simulated", "name": "fitts"}
    assert len(numbers["outcomes"][0]["contrasts"]) == 6
    assert numbers["ratings"] == []
    assert not numbers["balanced"]  # four conditions need sixteen people
    assert plan.people == 4


def test_outcomes_of_two_judges_are_never_mixed(study: tuple[Path, StudyPlan]) -> None:
    folder, _ = study
    edited("participant.json", judge="test")(folder)
    with pytest.raises(InputError, match="two judges"):
        write_report(folder)
    for path in folder.rglob("participant.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"judge": "test"}))
    text = write_report(folder).read_text()
    assert "by the robot" not in text
    assert "the robot has seated it" not in text
    assert "no robot was at work" in text


def test_who_has_not_finished_is_left_out_and_named(study: tuple[Path, StudyPlan]) -> None:
    folder, _ = study
    first(folder / "people/p004", "trial.json").unlink()
    numbers = json.loads((write_report(folder).parent / "report.json").read_text())
    assert numbers["n"] == 3
    assert numbers["left_out"] == [{"participant": 4, "why": "7 of 8 tasks done"}]
    assert not numbers["balanced"]
    first(folder / "people/p003", "trial.json").unlink()
    with pytest.raises(InputError, match="needs 3 or more"):
        write_report(folder)
