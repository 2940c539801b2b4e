"""The command `kit1000 study`: plans, sittings, simulations and reports over one folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kit1000.dataset.reader import Dataset
from kit1000.editor import SNAP
from kit1000.errors import InputError
from kit1000.files import check_writable, locked
from kit1000.study.conditions import DEFAULT
from kit1000.study.execution import ROBOT
from kit1000.study.operators import operator_of
from kit1000.study.simulation import simulate
from kit1000.study.study_plan import FILE, StudyPlan, make_plan, orders_text, read_plan, write_plan
from kit1000.study.study_report import write_report

DEFAULTS: Mapping[str, Any] = {
    "people": 12,
    "conditions": DEFAULT,
    "sensor": "ideal",
    "snap": SNAP,
    "seed": 0,
}
"""Values of a plan where an option is absent."""


@dataclass(frozen=True)
class Request:
    """What is asked for; the options of the command."""

    data: Path
    out: Path
    people: int | None = None
    conditions: tuple[str, ...] = ()
    sensor: str | None = None
    snap: str | None = None
    seed: int | None = None
    participant: int | None = None
    port: int | None = None
    origin: tuple[str, ...] = ()
    simulate: str | None = None
    judge: str = ROBOT
    report: bool = False


def run(request: Request) -> None:
    """Do it, and print where it went."""
    if request.participant is not None and (request.simulate is not None or request.report):
        raise InputError("--participant: is a sitting of a person; leave out --simulate and --report")
    if request.report and request.simulate is None:
        print(write_report(request.out))
        return
    if request.simulate is not None:
        operator_of(request.simulate)
    check_writable(request.out)
    with locked(request.out):
        plan, dataset = _plan(request), Dataset(request.data)
        if dataset.id != plan.dataset_id:
            raise InputError(f"{request.data}: is dataset {dataset.id}; the study was planned on {plan.dataset_id}")
        if request.participant is not None:
            _sit(request, plan, dataset)
        elif request.simulate is not None:
            print(simulate(request.out, plan, dataset, request.simulate, request.judge))
        else:
            print(orders_text(plan))
    if request.report:
        print(write_report(request.out, request.simulate))


def _sit(request: Request, plan: StudyPlan, dataset: Dataset) -> None:
    assert request.participant is not None
    try:
        from kit1000.study.sitting import sit
    except ModuleNotFoundError as error:
        if error.name != "viser":
            raise
        raise InputError("study: a sitting needs viser: pip install 'kit1000[edit]'") from None
    sit(request.out, plan, dataset, request.participant, request.port, request.judge, request.origin)


def _plan(request: Request) -> StudyPlan:
    """The plan of the folder, made first where there is none; an option that it contradicts is refused."""
    asked = {name: value for name in DEFAULTS if (value := getattr(request, name)) not in (None, ())}
    if not (request.out / FILE).is_file():
        plan = make_plan(Dataset(request.data), **{**DEFAULTS, **asked})
        write_plan(request.out, plan)
        return plan
    plan = read_plan(request.out)
    for name, value in asked.items():
        if value != getattr(plan, name):
            shown = " ".join(value) if isinstance(value, tuple) else value
            raise InputError(f"--{name} {shown}: {request.out} is planned otherwise; choose another --out")
    return plan
