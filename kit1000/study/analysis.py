"""From records to numbers: a value for each participant and condition, and their differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from kit1000.errors import InputError
from kit1000.study.plan import MAIN_OUTCOME, StudyPlan
from kit1000.study.questionnaire import SCALES, raw_load
from kit1000.study.records import Participant, TrialRecord
from kit1000.study.statistics import FEWEST, Comparison, bca_interval, compare, holm

Measure = Callable[[Sequence[TrialRecord]], float | None]
"""The value of the trials of one participant in one condition; None if there is none."""
Values = Mapping[str, Mapping[int, float]]
"""One value by condition, then by participant."""


@dataclass(frozen=True)
class Outcome:
    """A quantity that is measured of each participant in each condition."""

    name: str
    label: str
    unit: str
    measure: Measure


@dataclass(frozen=True)
class Mean:
    """A mean over participants."""

    n: int
    mean: float | None = None
    sd: float | None = None
    low: float | None = None  # 95 % BCa interval
    high: float | None = None


@dataclass(frozen=True)
class Row:
    """An outcome or a scale: its values, their means, and the difference of the conditions."""

    name: str
    label: str
    unit: str
    values: Values
    means: Mapping[str, Mean]
    difference: Comparison | None
    """The first condition minus the second, within participants; None with fewer than FEWEST of them."""
    p_holm: float | None = None
    """The p value adjusted for the six scales."""


@dataclass(frozen=True)
class Analysis:
    """All numbers of a study; the contents of analysis.json."""

    study: str
    dataset_id: str
    conditions: tuple[str, ...]
    sensor: str
    snap: str
    planned: int
    n: int
    balanced: bool  # whether all planned participants have done all tasks
    left_out: Mapping[int, str]  # participants who have not done all tasks, with the reason
    interruptions: int
    out_of_time: Mapping[str, int]  # trials by condition in which a part was not uploaded in time
    parts: Mapping[str, Mapping[str, int]]  # number of parts by condition and outcome
    outcomes: Sequence[Row]
    ratings: Sequence[Row]  # the six scales and their mean
    preferred: Mapping[str, int]  # answers to the last question by condition
    format: str = field(default="kit1000-study-analysis/2", init=False)


def _share(trials: Sequence[TrialRecord]) -> float:
    return 100 * sum(trial.seated for trial in trials) / sum(len(trial.parts) for trial in trials)


def _share_by_test(trials: Sequence[TrialRecord]) -> float:
    return 100 * float(np.mean([part.seated_by_test for trial in trials for part in trial.parts]))


def _mean(name: str) -> Measure:
    return lambda trials: float(np.mean([getattr(trial, name) for trial in trials]))


def _median_error(name: str) -> Measure:
    def measure(trials: Sequence[TrialRecord]) -> float | None:
        errors = [getattr(part, name) for trial in trials for part in trial.parts]
        known = [error for error in errors if error is not None]
        return float(np.median(known)) if known else None

    return measure


OUTCOMES = (
    Outcome(MAIN_OUTCOME, "Success, by the robot", "% of parts", _share),
    Outcome("specification", "Specification", "s per task", _mean("specification_s")),
    Outcome("execution", "Execution", "s per task", _mean("execution_s")),
    Outcome("success_by_test", "Success, by the seating test", "% of parts", _share_by_test),
    Outcome("position", "Position error", "mm", _median_error("position_mm")),
    Outcome("rotation", "Rotation error", "°", _median_error("angle_deg")),
    Outcome("uploads", "Uploads", "per task", _mean("uploads")),
    Outcome("refused", "Refused proposals", "per task", _mean("refused")),
)


def analyse(plan: StudyPlan, participants: Sequence[Participant]) -> Analysis:
    """All numbers of a study."""
    tasks = sum(map(len, plan.tasks.sets))
    people = [person for person in participants if len(person.trials) == tasks]
    if len(people) < FEWEST:
        raise InputError(f"{len(people)} participants have done all tasks; a report needs {FEWEST} or more")
    left_out = {
        person.number: f"{len(person.trials)} of {tasks} tasks done"
        for person in participants
        if len(person.trials) < tasks
    }
    trials = [trial for person in people for trial in person.trials]
    answers = [person.preferred for person in people if person.preferred is not None]
    by_condition = {name: [trial for trial in trials if trial.condition == name] for name in plan.conditions}
    return Analysis(
        study=plan.id,
        dataset_id=plan.dataset_id,
        conditions=plan.conditions,
        sensor=plan.sensor,
        snap=plan.snap,
        planned=plan.people,
        n=len(people),
        balanced=len(people) == plan.people,
        left_out=left_out,
        interruptions=sum(trial.interruptions for trial in trials),
        out_of_time={name: sum(trial.out_of_time for trial in own) for name, own in by_condition.items()},
        parts={
            name: _counts([part.outcome for trial in own for part in trial.parts]) for name, own in by_condition.items()
        },
        outcomes=[_outcome_row(plan, people, outcome) for outcome in OUTCOMES],
        ratings=_ratings(plan, people),
        preferred=_counts(answers),
    )


def _counts(names: Sequence[str]) -> dict[str, int]:
    """How often each name occurs, the most frequent first."""
    return {name: names.count(name) for name in sorted({*names}, key=lambda name: (-names.count(name), name))}


def _outcome_row(plan: StudyPlan, people: Sequence[Participant], outcome: Outcome) -> Row:
    values: dict[str, dict[int, float]] = {condition: {} for condition in plan.conditions}
    for person in people:
        for condition in plan.conditions:
            value = outcome.measure([trial for trial in person.trials if trial.condition == condition])
            if value is not None:
                values[condition][person.number] = value
    return _row(outcome, values)


def _row(outcome: Outcome, values: Values) -> Row:
    first, second = values.values()
    differences = [first[number] - second[number] for number in sorted(first.keys() & second.keys())]
    return Row(
        outcome.name,
        outcome.label,
        outcome.unit,
        values,
        {name: _mean_of(list(own.values())) for name, own in values.items()},
        compare(differences) if len(differences) >= FEWEST else None,
    )


def _mean_of(values: Sequence[float]) -> Mean:
    if not values:
        return Mean(0)
    array = np.array(values)
    low, high = bca_interval(array) if len(values) >= FEWEST else (None, None)
    return Mean(len(values), float(array.mean()), float(array.std(ddof=1)) if len(values) > 1 else None, low, high)


def _ratings(plan: StudyPlan, people: Sequence[Participant]) -> list[Row]:
    """The six scales, adjusted for their number after Holm, and their mean; empty without ratings."""
    if not any(person.ratings for person in people):
        return []

    def row(name: str, label: str, value: Callable[[Mapping[str, int]], float]) -> Row:
        rated = {
            condition: {i.number: value(i.ratings[condition]) for i in people if condition in i.ratings}
            for condition in plan.conditions
        }
        return _row(Outcome(name, label, "0 to 100", lambda _: None), rated)

    scales = [row(scale.name, scale.title, lambda ratings, name=scale.name: float(ratings[name])) for scale in SCALES]
    adjusted = iter(holm([scale.difference.p for scale in scales if scale.difference is not None]))
    scales = [replace(scale, p_holm=next(adjusted)) if scale.difference else scale for scale in scales]
    return [*scales, row("load", "Mean of the six", raw_load)]
