"""From records to the numbers of a report: one value a person and condition, contrasts of these, and order checks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from kit1000.errors import InputError
from kit1000.planner.execute import SEATED
from kit1000.study.conditions import CONDITIONS
from kit1000.study.execution import ROBOT
from kit1000.study.questionnaire import SCALES, raw_load
from kit1000.study.statistics import FEWEST, Comparison, bca_interval, compare, crossover, holm
from kit1000.study.study_plan import MAIN_OUTCOME, StudyPlan
from kit1000.study.study_records import Operator, Participant, TrialRecord


@dataclass(frozen=True)
class Outcome:
    """Something that is measured of a person in a condition."""

    name: str
    label: str
    unit: str
    of: Callable[[Sequence[TrialRecord]], float | None]
    """From the trials of one person in one condition."""
    good: int
    """1 where more is better, -1 where less is, 0 where neither."""


def _share(trials: Sequence[TrialRecord]) -> float:
    return 100 * sum(trial.seated for trial in trials) / sum(len(trial.parts) for trial in trials)


def _share_by_test(trials: Sequence[TrialRecord]) -> float:
    parts = [part for trial in trials for part in trial.parts]
    return 100 * sum(part.seated_by_test for part in parts) / len(parts)


def _mean(name: str) -> Callable[[Sequence[TrialRecord]], float]:
    return lambda trials: float(np.mean([getattr(trial, name) for trial in trials]))


def _median_error(name: str) -> Callable[[Sequence[TrialRecord]], float | None]:
    def of(trials: Sequence[TrialRecord]) -> float | None:
        errors = [getattr(part, name) for trial in trials for part in trial.parts]
        known = [error for error in errors if error is not None]
        return float(np.median(known)) if known else None

    return of


OUTCOMES = (
    Outcome(MAIN_OUTCOME, "Success, by the robot", "% of parts", _share, 1),
    Outcome("specification", "Specification", "s a task", _mean("specification_s"), -1),
    Outcome("execution", "Execution", "s a task", _mean("execution_s"), -1),
    Outcome("success_by_test", "Success, by the seating test", "% of parts", _share_by_test, 1),
    Outcome("position", "Position error", "mm", _median_error("position_mm"), -1),
    Outcome("rotation", "Rotation error", "°", _median_error("angle_deg"), -1),
    Outcome("uploads", "Uploads", "a task", _mean("uploads"), 0),
    Outcome("refused", "Refused snaps", "a task", _mean("refused"), 0),
)
PLOTTED = 3  # outcomes, the first ones, that have plots and order checks
JUDGED_BY_TEST = (
    replace(OUTCOMES[0], label="Success, by the seating test"),
    *(outcome for outcome in OUTCOMES[1:] if outcome.name != "success_by_test"),
)
"""The same where no robot was at work."""
RATED = tuple((scale.name, scale.title, "0 to 100") for scale in SCALES)
LOAD = ("load", "Mean of the six", "0 to 100")
Table = Mapping[str, Mapping[int, float]]
"""One value by condition, then by participant."""


@dataclass(frozen=True)
class Contrast:
    """A difference of conditions, a number a person."""

    name: str
    short: str
    """The name for the margin of a plot."""
    weights: Mapping[str, float]
    """Weights by condition; they sum to zero."""

    def values(self, table: Table) -> dict[int, float]:
        """Values by participant, of those who have all conditions in question."""
        people = set.intersection(*(set(table[condition]) for condition in self.weights))
        return {i: sum(weight * table[name][i] for name, weight in self.weights.items()) for i in sorted(people)}


def contrasts_of(conditions: Sequence[str]) -> list[Contrast]:
    """The first condition with each other one; and interface, snapping and both together where these are crossed."""
    first = CONDITIONS[conditions[0]]
    pairs = [
        Contrast(
            f"{first.label} minus {other.label}",
            f"{first.short} minus {other.short}",
            {first.name: 1.0, other.name: -1.0},
        )
        for other in (CONDITIONS[name] for name in conditions[1:])
    ]
    if len(conditions) == 2:
        return pairs
    hands = {CONDITIONS[name].interface for name in conditions} - {"scene"}
    crossed = {(CONDITIONS[name].interface == "scene", CONDITIONS[name].snaps) for name in conditions}
    if len(crossed) < 4 or len(hands) != 1:
        return pairs

    cells = {name: (CONDITIONS[name].interface == "scene", CONDITIONS[name].snaps) for name in conditions}
    interface = {name: 0.5 if scene else -0.5 for name, (scene, _) in cells.items()}
    snapping = {name: 0.5 if snaps else -0.5 for name, (_, snaps) in cells.items()}
    both = {name: 1.0 if scene == snaps else -1.0 for name, (scene, snaps) in cells.items()}
    return [
        *pairs,
        Contrast("Scene editing minus hand control", "Scenes minus hands", interface),
        Contrast("Snapping minus none", "Snapping minus none", snapping),
        Contrast("What snapping adds to scene editing, minus to hand control", "Both together", both),
    ]


def analyse(plan: StudyPlan, operator: Operator, participants: Sequence[Participant], seed: int = 0) -> dict[str, Any]:
    """All numbers of a report, as JSON values. seed: of the resampling."""
    tasks = sum(map(len, plan.tasks.sets))
    complete = [person for person in participants if len(person.trials) == tasks]
    left_out = [
        {"participant": person.number, "why": f"{len(person.trials)} of {tasks} tasks done"}
        for person in participants
        if len(person.trials) < tasks
    ]
    if len(complete) < FEWEST:
        raise InputError(f"{len(complete)} participants have done all tasks; a report needs {FEWEST} or more")
    judges = {person.judge for person in participants}
    if len(judges) > 1:
        raise InputError(f"judged by {' and '.join(sorted(judges))}: outcomes of two judges are never mixed")
    [judge] = judges
    contrasts = contrasts_of(plan.conditions)
    outcomes = OUTCOMES if judge == ROBOT else JUDGED_BY_TEST
    tables = [(_head(each), _table(plan, complete, each.of)) for each in outcomes]
    return {
        "format": "kit1000-study-report/1",
        "study": plan.id,
        "dataset_id": plan.dataset_id,
        "operator": asdict(operator),
        "conditions": list(plan.conditions),
        "sensor": plan.sensor,
        "snap": plan.snap,
        "judge": judge,
        "planned": plan.people,
        "n": len(complete),
        "balanced": len(complete) % (len(plan.conditions) ** 2) == 0 and len(complete) == plan.people,
        "left_out": left_out,
        "interruptions": sum(trial.interruptions for person in complete for trial in person.trials),
        "out_of_time": _out_of_time(plan, complete),
        "parts": _parts(plan, complete),
        "outcomes": [_row(head, table, contrasts, seed) for head, table in tables],
        "ratings": _ratings(plan, complete, contrasts, seed),
        "preferred": _preferred(plan, complete),
        "order": _order(plan, complete, outcomes),
        "learning": _learning(plan, complete, seed),
        "robot_and_test_agree": _agreement(complete),
    }


def _trials(person: Participant, condition: str) -> list[TrialRecord]:
    return [trial for trial in person.trials if trial.condition == condition]


def _table(
    plan: StudyPlan, people: Iterable[Participant], of: Callable[[Sequence[TrialRecord]], float | None]
) -> Table:
    table: dict[str, dict[int, float]] = {condition: {} for condition in plan.conditions}
    for person in people:
        for condition in plan.conditions:
            value = of(_trials(person, condition))
            if value is not None:
                table[condition][person.number] = value
    return table


def _head(outcome: Outcome) -> dict[str, Any]:
    head: dict[str, Any] = {"name": outcome.name, "label": outcome.label, "unit": outcome.unit, "good": outcome.good}
    return head | {"main": outcome.name == MAIN_OUTCOME}


def _row(head: Mapping[str, Any], table: Table, contrasts: Sequence[Contrast], seed: int) -> dict[str, Any]:
    """An outcome: its values, their means, and its contrasts."""
    return {
        **head,
        "values": {name: {str(i): value for i, value in values.items()} for name, values in table.items()},
        "means": {name: _mean_row(list(values.values()), seed) for name, values in table.items()},
        "contrasts": [_contrast_row(contrast, table, seed) for contrast in contrasts],
    }


def _mean_row(values: Sequence[float], seed: int) -> dict[str, Any]:
    if not values:
        return {"n": 0, "mean": None, "sd": None, "low": None, "high": None}
    array = np.array(values)
    low, high = bca_interval(array, seed) if len(values) >= FEWEST else (None, None)
    spread = float(array.std(ddof=1)) if len(values) > 1 else None
    return {"n": len(values), "mean": float(array.mean()), "sd": spread, "low": low, "high": high}


def _contrast_row(contrast: Contrast, table: Table, seed: int) -> dict[str, Any]:
    values = list(contrast.values(table).values())
    if len(values) < FEWEST:
        return {"name": contrast.name, "n": len(values)}
    return {"name": contrast.name, "short": contrast.short} | _comparison_row(compare(values, seed))


def _comparison_row(comparison: Comparison) -> dict[str, Any]:
    return asdict(comparison) | {"p": comparison.p}


def _ratings(
    plan: StudyPlan, people: Sequence[Participant], contrasts: Sequence[Contrast], seed: int
) -> list[dict[str, Any]]:
    """The six scales, adjusted for their number after Holm, and their mean; empty without ratings."""
    if not any(person.ratings for person in people):
        return []
    rows = []
    for name, label, unit in (*RATED, LOAD):
        table: dict[str, dict[int, float]] = {condition: {} for condition in plan.conditions}
        for person in people:
            for condition, ratings in person.ratings.items():
                table[condition][person.number] = raw_load(ratings) if name == "load" else float(ratings[name])
        rows.append(_row({"name": name, "label": label, "unit": unit, "good": -1}, table, contrasts, seed))
    for k in range(len(contrasts)):
        tested = [row["contrasts"][k] for row in rows[:-1] if "p" in row["contrasts"][k]]
        for found, adjusted in zip(tested, holm([each["p"] for each in tested]), strict=True):
            found["p_holm"] = adjusted
    return rows


def _preferred(plan: StudyPlan, people: Iterable[Participant]) -> dict[str, int]:
    answers = [person.preferred for person in people if person.preferred is not None]
    return {condition: answers.count(condition) for condition in plan.conditions} if answers else {}


def _order(plan: StudyPlan, people: Sequence[Participant], outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Means by position of the first outcomes; carry-over and period of two conditions."""
    rows = []
    for outcome in outcomes[:PLOTTED]:
        by_position = [
            [value for person in people if (value := outcome.of(_at_position(plan, person, position))) is not None]
            for position in range(1, len(plan.conditions) + 1)
        ]
        row: dict[str, Any] = {"name": outcome.name, "label": outcome.label, "unit": outcome.unit}
        row["by_position"] = [float(np.mean(values)) for values in by_position]
        if len(plan.conditions) == 2:
            table = _table(plan, people, outcome.of)
            one, other = ([table[name][person.number] for person in people] for name in plan.conditions)
            early = [plan.sessions(person.number)[0].condition.name == plan.conditions[0] for person in people]
            found = crossover(one, other, early)
            row["crossover"] = found and asdict(found)
        rows.append(row)
    return rows


def _at_position(plan: StudyPlan, person: Participant, position: int) -> list[TrialRecord]:
    return [trial for trial in person.trials if trial.position == position]


def _learning(plan: StudyPlan, people: Sequence[Participant], seed: int) -> list[dict[str, Any]]:
    """Specification time of the second task of a size minus that of the first, a mean over sizes and conditions."""
    sizes = [task.kits for task in plan.tasks.sets[0]]
    pairs = [(i + 1, j + 1) for i in range(len(sizes)) for j in range(i + 1, len(sizes)) if sizes[i] == sizes[j]]
    rows = []
    for condition in plan.conditions:
        changes = []
        for person in people:
            seconds = {trial.task: trial.specification_s for trial in _trials(person, condition)}
            changes.append(float(np.mean([seconds[later] - seconds[first] for first, later in pairs])))
        rows.append({"condition": condition} | _comparison_row(compare(changes, seed)))
    return rows


def _out_of_time(plan: StudyPlan, people: Iterable[Participant]) -> dict[str, int]:
    trials = [trial for person in people for trial in person.trials if trial.out_of_time]
    return {name: sum(trial.condition == name for trial in trials) for name in plan.conditions}


def _parts(plan: StudyPlan, people: Sequence[Participant]) -> dict[str, dict[str, int]]:
    """Parts by condition and outcome."""
    found: dict[str, dict[str, int]] = {name: {} for name in plan.conditions}
    for person in people:
        for trial in person.trials:
            for part in trial.parts:
                found[trial.condition][part.outcome] = found[trial.condition].get(part.outcome, 0) + 1
    return {name: dict(sorted(counts.items(), key=lambda item: -item[1])) for name, counts in found.items()}


def _agreement(people: Iterable[Participant]) -> dict[str, int]:
    parts = [
        part for person in people for trial in person.trials for part in trial.parts if part.position_mm is not None
    ]
    same = sum((part.outcome == SEATED) == part.seated_by_test for part in parts)
    return {"parts": len(parts), "agree": same}
