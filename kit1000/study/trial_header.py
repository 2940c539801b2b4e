"""What every line of a trial's log says: who does what, under which plan."""

from __future__ import annotations

from dataclasses import dataclass

from kit1000.editor.records import Header
from kit1000.study.study_plan import Session, StudyPlan
from kit1000.study.study_records import Operator


@dataclass(frozen=True)
class TrialHeader(Header):
    """The stamp of an event."""

    study: str
    participant: int
    operator: str
    """human, or simulated and the model's name."""
    condition: str
    task: int
    """From 1, within the condition; 0 to practise."""


def header_of(plan: StudyPlan, operator: Operator, participant: int, session: Session, task: int) -> TrialHeader:
    """The stamp of the events of a task."""
    condition = session.condition
    scene = session.tasks[task - 1].scene if task else plan.tasks.practice.scene
    return TrialHeader(
        plan.dataset_id,
        scene,
        plan.sensor,
        False,
        plan.snap if condition.snaps else "none",
        condition.interface,
        plan.id,
        participant,
        operator.kind if operator.kind == operator.name else f"{operator.kind} {operator.name}",
        condition.name,
        task,
    )
