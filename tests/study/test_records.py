"""A study's plan and records: exact balance, files that come back, and what does not belong is refused by path."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.study import statistics
from kit1000.study.plan import CONDITIONS, FILE, StudyPlan, places, read_plan, write_plan
from kit1000.study.questionnaire import NAMES
from kit1000.study.records import ParticipantFiles, TrialRecord, read_participants
from kit1000.study.report import write_report
from kit1000.study.tasks import SIZES, Task, Tasks, choose_tasks
from tests.samples.studies import plan_of, trial_of, write_study

SEEDS = st.integers(0, 2**32)


@given(SEEDS, st.integers(0, 20))
def test_orders_and_sets_are_balanced_in_every_block_of_four(seed: int, block: int) -> None:
    rows = [places(seed, 4 * block + member) for member in range(1, 5)]
    assert len({row[0] for row in rows}) == 4
    for row in rows:
        assert sorted(place.condition for place in row) == sorted(place.task_set for place in row) == [0, 1]


def test_numbers_do_not_reveal_the_order() -> None:
    firsts = {tuple(places(seed, number)[0].condition for number in range(1, 9)) for seed in range(20)}
    assert len(firsts) > 8


def test_each_participant_meets_every_condition_and_task_once() -> None:
    plan = plan_of(8)
    for number in range(1, 9):
        sessions = plan.sessions(number)
        assert [each.position for each in sessions] == [1, 2]
        assert {each.condition for each in sessions} == {CONDITIONS[name] for name in plan.conditions}
        assert len({task.scene for each in sessions for task in each.tasks}) == 2 * len(SIZES)
    assert plan_of(4).sessions(3) == plan.sessions(3)  # further people change nothing


@pytest.mark.parametrize(
    ("values", "facts"),
    [
        *(({"people": people}, ("--people", "4", str(people))) for people in (-4, 0, 3, 6, 10)),
        *(({"conditions": names}, ("--conditions", "two")) for names in ((), ("scene",), ("scene", "scene"))),
        ({"conditions": ("scene-snop", "hand")}, ("scene-snop", "scene-snap", "hand-bare")),
    ],
)
def test_a_plan_that_cannot_be_balanced_is_refused(values: dict[str, object], facts: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as refusal:
        plan_of(**values)  # type: ignore[arg-type]
    assert all(fact in str(refusal.value) for fact in facts)


def test_wrong_participants_and_sets_are_refused() -> None:
    for number in (0, 17):
        with pytest.raises(InputError, match="1 to 16"):
            plan_of(16).sessions(number)
    with pytest.raises(InputError, match="2 sets"):
        StudyPlan("a", "ideal", "a:b", ("scene", "hand"), 4, 0, Tasks(Task("s", 2), ()))


def test_a_plan_comes_back_from_its_file(tmp_path: Path) -> None:
    plan = plan_of(8, seed=7)
    write_plan(tmp_path, plan)
    assert read_plan(tmp_path) == plan
    assert read_plan(tmp_path).id == plan.id != plan_of(8, seed=8).id


CHANGES = [{"people": 16}, {"people": "many"}, {"seed": 1}, {"orders": []}, {"conditions": ["scene"]}, {"tasks": None}]


@pytest.mark.parametrize("change", [*CHANGES, {"format": "other"}])
def test_a_changed_plan_is_refused_in_one_line(tmp_path: Path, change: dict[str, object]) -> None:
    write_plan(tmp_path, plan_of())
    path = tmp_path / FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError) as refusal:
        read_plan(tmp_path)
    assert "\n" not in str(refusal.value)


@dataclass
class Bodies:
    """The bodies of a scene with this number of kits."""

    bodies: range


@dataclass
class FakeScene:
    id: str
    scene: Bodies


class FakeDataset:
    """Forty scenes of one to four kits."""

    root = Path("data")
    scene_ids = tuple(f"s{i}" for i in range(40))

    def split(self, name: str, truth: bool) -> FakeDataset:
        return self

    def __len__(self) -> int:
        return len(self.scene_ids)

    def scene(self, scene_id: str) -> FakeScene:
        return FakeScene(scene_id, Bodies(range(2 + int(scene_id[1:]) % 4)))


def test_tasks_have_the_sizes_of_the_paper_and_scenes_that_the_robot_solves(mini: Path) -> None:
    def solvable(scene: FakeScene) -> bool:
        return int(scene.id[1:]) > 5

    tasks = choose_tasks(FakeDataset(), "ideal", 0, solvable)  # type: ignore[arg-type]
    assert [[task.kits for task in one] for one in tasks.sets] == [list(SIZES)] * 2
    scenes = [task.scene for one in tasks.sets for task in one] + [tasks.practice.scene]
    assert len({*scenes}) == 9
    assert all(int(scene[1:]) > 5 for scene in scenes)
    assert tasks == choose_tasks(FakeDataset(), "ideal", 0, solvable)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"of 5 scenes with 2 kits.*the preset study"):
        choose_tasks(Dataset(mini), "ideal", 0, lambda scene: True)


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


def beside(name: str) -> Callable[[Path], None]:
    """Adds a folder that the plan does not have."""
    return lambda folder: (folder / "people" / name).mkdir()


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
    *((beside(name), (name,)) for name in ("p005", "p001-copy", "p001/1-scene", "p001/1-hand/task-5")),
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
