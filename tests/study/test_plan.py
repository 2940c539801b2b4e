"""Laws of a study's plan: exact balance for any seed, and a file that cannot be changed by hand unnoticed."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.study.plan import CONDITIONS, FILE, StudyPlan, places, read_plan, write_plan
from kit1000.study.tasks import SIZES, Task, Tasks, choose_tasks
from tests.samples.studies import plan_of

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
