"""Laws of the clock and of the questionnaire."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.errors import InputError
from kit1000.study.clock import TaskClock, time_limit
from kit1000.study.questionnaire import NAMES, VALUES, checked_ratings, raw_load


class Now:
    def __init__(self) -> None:
        self.seconds = 100.0

    def __call__(self) -> float:
        return self.seconds


@pytest.mark.parametrize("kits", [1, 2, 3])
@pytest.mark.parametrize("robot", [0.0, 40.0])
def test_an_upload_may_start_until_the_last_millisecond(kits: int, robot: float) -> None:
    now = Now()
    clock = TaskClock(kits, now)
    clock.start()
    clock.executed(robot)
    now.seconds += 60.0 * kits - robot - 0.001
    assert clock.may_upload()
    assert clock.left == pytest.approx(0.001)
    now.seconds += 0.002
    assert not clock.may_upload()
    assert clock.left == 0


def test_the_clock_stands_still_while_the_participant_is_not_in_charge() -> None:
    now = Now()
    clock = TaskClock(2, now)
    now.seconds += 5
    assert clock.reading == 0
    clock.start()
    now.seconds += 5
    clock.stop()
    now.seconds += 50
    assert clock.reading == 5
    clock.executed(23)
    clock.start()
    clock.start()  # twice is once
    now.seconds += 1
    assert (clock.specified, clock.execution, clock.reading) == (6, 23, 29)


@given(st.lists(st.tuples(st.sampled_from(["start", "stop", "wait", "run"]), st.floats(0, 50)), max_size=20))
def test_the_clock_never_goes_back(steps: list[tuple[str, float]]) -> None:
    now = Now()
    clock, before = TaskClock(3, now), 0.0
    for kind, seconds in steps:
        if kind == "wait":
            now.seconds += seconds
        elif kind == "run":
            clock.executed(seconds)
        else:
            getattr(clock, kind)()
        assert clock.reading >= before - 1e-9
        assert clock.may_upload() == (clock.reading < time_limit(3))
        before = clock.reading


def test_a_clock_refuses_wrong_numbers() -> None:
    with pytest.raises(InputError, match="kits"):
        time_limit(0)
    with pytest.raises(InputError, match="robot"):
        TaskClock(1, Now()).executed(float("nan"))


@given(st.fixed_dictionaries({name: st.sampled_from(VALUES) for name in NAMES}))
def test_load_is_the_mean_of_the_six_scales(ratings: dict[str, int]) -> None:
    assert checked_ratings(ratings) == ratings
    assert 0 <= raw_load(ratings) == sum(ratings.values()) / 6 <= 100


@pytest.mark.parametrize(
    ("change", "facts"),
    [
        *(({"mental": value}, ("mental", repr(value))) for value in (7, 105, -5, "50", True, 50.0)),
        ({"mentl": 50}, ("mentl", "did you mean mental")),
        *(({name: None}, (name,)) for name in NAMES),
    ],
)
def test_wrong_and_missing_ratings_are_refused(change: dict[str, object], facts: tuple[str, ...]) -> None:
    ratings = {name: value for name, value in (dict.fromkeys(NAMES, 50) | change).items() if value is not None}
    with pytest.raises(InputError) as refusal:
        checked_ratings(ratings)
    assert all(fact in str(refusal.value) for fact in facts)
