"""Records and reports of a study: they come back as written, and a record that does not belong is refused by path."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from kit1000.errors import InputError
from kit1000.study import statistics
from kit1000.study.plan import StudyPlan
from kit1000.study.questionnaire import NAMES
from kit1000.study.records import ParticipantFiles, TrialRecord, read_participants
from kit1000.study.report import write_report
from tests.samples.studies import plan_of, trial_of, write_study


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Intervals have tests of their own."""
    monkeypatch.setattr(statistics, "RESAMPLES", 200)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    write_study(folder, plan_of())
    return folder


@pytest.fixture
def study(written: Path, tmp_path: Path) -> Path:
    """A study of four people that a test may change."""
    return shutil.copytree(written, tmp_path / "study")


PLAN: StudyPlan = plan_of()


def test_a_trial_comes_back(tmp_path: Path) -> None:
    files, session = ParticipantFiles(tmp_path, PLAN, 3), PLAN.sessions(3)[1]
    trial = trial_of(files, session, 4, 2, 12.345)
    path = files.of_task(session, 4) / "trial.json"
    files.write(path, trial)
    assert files.read(path, TrialRecord) == trial
    assert trial.seated == 2
    assert path.relative_to(tmp_path).parts[:2] == ("people", "p003")


def test_everybody_is_read(study: Path) -> None:
    people = read_participants(study, PLAN)
    assert [person.number for person in people] == [1, 2, 3, 4]
    assert {len(person.trials) for person in people} == {8}
    assert all(set(person.ratings) == set(PLAN.conditions) for person in people)
    assert {person.preferred for person in people} == {"scene-snap"}


def first(folder: Path, name: str) -> Path:
    return sorted(folder.rglob(name))[0]


def edited(name: str, **change: object) -> Callable[[Path], None]:
    """Changes fields of the first file of a name; None removes a field."""

    def change_file(folder: Path) -> None:
        path = first(folder, name)
        row = json.loads(path.read_text()) | change
        path.write_text(json.dumps({key: value for key, value in row.items() if value is not None}))

    return change_file


def cut(name: str) -> Callable[[Path], None]:
    def cut_file(folder: Path) -> None:
        path = first(folder, name)
        path.write_bytes(path.read_bytes()[:-20])

    return cut_file


DAMAGES: list[tuple[Callable[[Path], None], tuple[str, ...]]] = [
    (cut("trial.json"), ("trial.json",)),
    (cut("participant.json"), ("participant.json",)),
    (edited("trial.json", specification_s="12"), ("trial.json", "specification_s", "float")),
    (edited("trial.json", specification_s=-1), ("trial.json", "specification_s", ">= 0")),
    (edited("trial.json", uploads=True), ("trial.json", "uploads", "int")),
    (edited("trial.json", parts=[]), ("trial.json", "parts")),
    (edited("trial.json", parts=[3]), ("trial.json", "parts[0]")),
    (edited("trial.json", task=2), ("trial.json", "plan")),
    (edited("trial.json", scene="test-s9999"), ("trial.json", "test-s9999")),
    (edited("trial.json", study="0"), ("trial.json", "study", PLAN.id)),
    (edited("trial.json", participant=2), ("trial.json", "participant", "1", "2")),
    (edited("trial.json", format="x"), ("trial.json", "format")),
    (edited("trial.json", comment="nice"), ("trial.json", "comment")),
    (edited("trial.json", kits=None), ("trial.json", "kits")),
    (edited("participant.json", consent=None), ("participant.json", "consent")),
    *(
        (edited("ratings.json", ratings=dict.fromkeys(NAMES, 50) | {name: value}), ("ratings.json", name))
        for name, value in (("effort", 7), ("mental", 105), ("mental", -5), ("mental", "50"), ("mentl", 50))
    ),
    (edited("ratings.json", ratings={"mental": 5}), ("ratings.json", "physical")),
    (edited("closing.json", preferred="hand-bare"), ("closing.json", "preferred", "hand-bare")),
]


@pytest.mark.parametrize(("damage", "facts"), DAMAGES)
def test_a_record_that_does_not_belong_is_refused_in_one_line(
    study: Path, damage: Callable[[Path], None], facts: tuple[str, ...]
) -> None:
    assert PLAN.sessions(1)[0].condition.name == "hand"
    damage(study)
    with pytest.raises(InputError) as refusal:
        read_participants(study, PLAN)
    text = str(refusal.value)
    assert "\n" not in text
    assert all(fact in text for fact in (str(study), *facts))


def test_a_report_finds_the_effects_of_its_records(study: Path) -> None:
    path = write_report(study)
    numbers = json.loads((path.parent / "analysis.json").read_text())
    rows = {row["name"]: row for row in numbers["outcomes"]}
    change = rows["specification"]["difference"]
    assert change["low"] < -20 < change["high"]
    assert change["n"] == numbers["n"] == 4
    assert rows["success"]["difference"]["mean"] == pytest.approx(40, abs=15)  # one part of two or three per task
    scales, load = numbers["ratings"][:-1], numbers["ratings"][-1]
    assert len(scales) == 6
    assert load["difference"]["mean"] == pytest.approx(sum(row["difference"]["mean"] for row in scales) / 6)
    assert all(
        row["p_holm"] >= min(row["difference"]["t_p"], row["difference"]["wilcoxon_p"])
        for row in numbers["ratings"][:-1]
    )
    assert numbers["preferred"] == {"scene-snap": 4}
    trials = list(csv.DictReader((path.parent / "trials.csv").read_text().splitlines()))
    assert len(trials) == 32
    assert {row["position_mm"] for row in trials} == {"1.5 1.5", "1.5 1.5 1.5"}
    table = path.read_text()
    assert table.count("\n|") == 2 + len(rows) + 7
    assert write_report(study).read_text() == table


def test_unfinished_participants_are_left_out_and_named(study: Path) -> None:
    first(study / "people/p004", "trial.json").unlink()
    path = write_report(study)
    assert "Left out: participant 4 (7 of 8 tasks done). Orders are not balanced." in path.read_text()
    numbers = json.loads((path.parent / "analysis.json").read_text())
    assert numbers["n"] == 3
    assert numbers["left_out"] == {"4": "7 of 8 tasks done"}
    assert not numbers["balanced"]
    first(study / "people/p003", "trial.json").unlink()
    with pytest.raises(InputError, match=r"2 participants .* 3 or more"):
        write_report(study)
