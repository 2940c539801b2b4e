"""Laws of a study's plan: exact balance for any seed, and a file that cannot be changed by hand unnoticed."""

from __future__ import annotations

import json
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.errors import InputError
from kit1000.study.conditions import CONDITIONS, CROSSED, conditions_of
from kit1000.study.orders import orders, williams_square
from kit1000.study.study_plan import FILE, StudyPlan, read_plan, write_plan
from kit1000.study.tasks import SIZES, Task, Tasks
from tests.samples.studies import plan_of


@given(st.sampled_from([2, 4]), st.integers(1, 3), st.integers(0, 2**32))
def test_orders_are_exactly_balanced(n: int, cycles: int, seed: int) -> None:
    rows = orders(n, cycles * n * n, seed)
    positions = Counter((p, place.condition) for row in rows for p, place in enumerate(row))
    sets = Counter((place.condition, place.task_set) for row in rows for place in row)
    set_positions = Counter((p, place.task_set) for row in rows for p, place in enumerate(row))
    before = Counter((a.condition, b.condition) for row in rows for a, b in pairwise(row))
    for counts in (positions, sets, set_positions):
        assert len(counts) == n * n
        assert set(counts.values()) == {cycles * n}
    assert len(before) == n * (n - 1)
    assert set(before.values()) == {cycles * n}
    for row in rows:
        assert sorted(place.condition for place in row) == sorted(place.task_set for place in row) == list(range(n))


@given(st.sampled_from([2, 4]), st.integers(0, 2**32), st.integers(1, 6))
def test_every_block_of_people_is_balanced_by_itself(n: int, seed: int, blocks: int) -> None:
    rows = orders(n, 4 * blocks, seed)
    for start in range(0, 4 * blocks, n):
        block = rows[start : start + n]
        assert len({(p, place.condition) for row in block for p, place in enumerate(row)}) == n * n
        assert len({place for row in block for place in row}) == n * n


@given(st.sampled_from([2, 4]), st.integers(0, 2**32))
def test_more_people_change_nobodys_order(n: int, seed: int) -> None:
    assert orders(n, 8, seed) == orders(n, 24, seed)[:8]


def test_numbers_do_not_tell_the_order() -> None:
    firsts = {tuple(row[0].condition for row in orders(2, 8, seed)) for seed in range(20)}
    assert len(firsts) > 8


@pytest.mark.parametrize("people", [-4, 0, 3, 6, 10])
def test_a_number_of_people_that_cannot_be_balanced_is_refused(people: int) -> None:
    with pytest.raises(InputError, match="multiple of 4"):
        orders(2, people, 0)


def test_an_odd_square_is_refused() -> None:
    with pytest.raises(InputError, match="even"):
        williams_square(3)


@pytest.mark.parametrize("names", [(), ("scene",), ("scene", "scene"), ("scene", "hand", "hand-snap")])
def test_conditions_that_cannot_be_balanced_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="two or four"):
        conditions_of(names)
    with pytest.raises(InputError, match="did you mean scene-snap"):
        conditions_of(("scene-snop", "hand"))


def test_each_participant_meets_every_condition_and_task_set_once() -> None:
    plan = plan_of(16, CROSSED)
    for number in range(1, 17):
        sessions = plan.sessions(number)
        assert [each.position for each in sessions] == [1, 2, 3, 4]
        assert {each.condition for each in sessions} == {CONDITIONS[name] for name in CROSSED}
        assert len({task.scene for each in sessions for task in each.tasks}) == 4 * len(SIZES)
    for number in (0, 17):
        with pytest.raises(InputError, match="1 to 16"):
            plan.sessions(number)


def test_a_plan_comes_back_from_its_file(tmp_path: Path) -> None:
    plan = plan_of(8, CROSSED, seed=7)
    write_plan(tmp_path, plan)
    assert read_plan(tmp_path) == plan
    assert read_plan(tmp_path).id == plan.id != plan_of(8, CROSSED, seed=8).id


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"people": 16}, "a plan is not changed"),
        ({"seed": 1}, "a plan is not changed"),
        ({"orders": []}, "a plan is not changed"),
        ({"people": "many"}, "damaged"),
        ({"conditions": ["scene"]}, "two or four"),
        ({"tasks": None}, "damaged"),
        ({"format": "other"}, "expected a plan of the format"),
    ],
)
def test_a_changed_plan_is_refused_in_one_line(tmp_path: Path, change: dict[str, object], message: str) -> None:
    write_plan(tmp_path, plan_of())
    path = tmp_path / FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=message) as refusal:
        read_plan(tmp_path)
    assert "\n" not in str(refusal.value)


def test_a_folder_without_a_plan_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="kit1000 study DATA --people 12"):
        read_plan(tmp_path)


def test_sets_and_conditions_must_agree() -> None:
    with pytest.raises(InputError, match="expected 2 sets"):
        StudyPlan("a", "ideal", "a:b", ("scene", "hand"), 4, 0, Tasks(Task("s", 2), ()))
