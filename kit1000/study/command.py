"""The command `kit1000 study`: plans, simulations and reports over one folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import check_writable, locked
from kit1000.study.conditions import DEFAULT
from kit1000.study.execution import ROBOT
from kit1000.study.operators import operator_of
from kit1000.study.plan import FILE, StudyPlan, make_plan, orders_text, read_plan, write_plan
from kit1000.study.report import write_report
from kit1000.study.simulation import simulate

PEOPLE = 12  # of a plan for which no number is given


@dataclass(frozen=True)
class Request:
    """What is asked for; the options of the command."""

    data: Path
    out: Path
    people: int | None = None
    conditions: tuple[str, ...] = ()
    sensor: str = "ideal"
    snap: str = "none"
    seed: int = 0
    simulate: str | None = None
    judge: str = ROBOT
    report: bool = False


def run(request: Request) -> None:
    """Do it, and print where it went."""
    if request.simulate is not None:
        operator_of(request.simulate)
    if request.report and request.people is None:
        print(write_report(request.out, request.simulate))
        return
    check_writable(request.out)
    with locked(request.out):
        plan, dataset = _plan(request), Dataset(request.data)
        if dataset.id != plan.dataset_id:
            raise InputError(f"{request.data}: is dataset {dataset.id}; the study was planned on {plan.dataset_id}")
        if request.simulate is not None:
            print(simulate(request.out, plan, dataset, request.simulate, request.judge))
        else:
            print(orders_text(plan))
    if request.report:
        print(write_report(request.out, request.simulate))


def _plan(request: Request) -> StudyPlan:
    """The plan of the folder, made first where there is none; an option that it contradicts is refused."""
    if not (request.out / FILE).is_file():
        chosen = (request.people or PEOPLE, request.conditions or DEFAULT, request.sensor, request.snap, request.seed)
        plan = make_plan(Dataset(request.data), *chosen)
        write_plan(request.out, plan)
        return plan
    plan = read_plan(request.out)
    asked = {"people": request.people, "conditions": request.conditions}
    for name, value in asked.items():
        if value and value != getattr(plan, name):
            shown = " ".join(value) if isinstance(value, tuple) else value
            raise InputError(f"--{name} {shown}: {request.out} is planned otherwise; choose another --out")
    return plan
