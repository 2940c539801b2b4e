"""The command `kit1000 study`: plans, sittings, simulations and reports in one folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kit1000.dataset.reader import Dataset
from kit1000.editor import SNAP
from kit1000.errors import InputError
from kit1000.files import check_output, locked
from kit1000.study.plan import DEFAULT, FILE, StudyPlan, make_plan, read_plan, write_plan
from kit1000.study.records import ParticipantFiles
from kit1000.study.report import write_report
from kit1000.study.simulation import check_operator, simulate

DEFAULTS: Mapping[str, Any] = {"people": 12, "conditions": DEFAULT, "sensor": "ideal", "snap": SNAP, "seed": 0}
"""Values of a new plan, for absent options."""


@dataclass(frozen=True)
class Request:
    """The options of the command."""

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
    report: bool = False


def run(request: Request) -> None:
    """Carry out a request, and print orders, an address or a path."""
    if request.participant is not None and (request.simulate is not None or request.report):
        raise InputError("--participant: is a sitting of a person; leave out --simulate and --report")
    if request.simulate is not None:
        check_operator(request.simulate)
    if request.simulate is not None or not request.report:
        check_output(request.out, FILE)
        with locked(request.out):
            _work(request)
    if request.report:
        print(write_report(request.out, request.simulate))


def _work(request: Request) -> None:
    plan, dataset = _plan(request), Dataset(request.data)
    if dataset.id != plan.dataset_id:
        raise InputError(f"{request.data}: is dataset {dataset.id}; the study was planned on {plan.dataset_id}")
    if request.simulate is not None:
        print(simulate(request.out, plan, dataset, request.simulate))
    elif request.participant is None:
        print(plan.as_text())
    else:
        try:
            from kit1000.study.sitting import Sitting
        except ModuleNotFoundError as error:
            if error.name != "viser":
                raise
            raise InputError("study: a sitting needs viser: pip install 'kit1000[edit]'") from None
        files = ParticipantFiles(request.out, plan, request.participant)
        Sitting(files, dataset, request.port, request.origin).run()


def _plan(request: Request) -> StudyPlan:
    """The plan of the folder, made first if there is none; an option that contradicts it is refused."""
    stated = {name: value for name in DEFAULTS if (value := getattr(request, name)) not in (None, ())}
    if not (request.out / FILE).is_file():
        plan = make_plan(Dataset(request.data), **{**DEFAULTS, **stated})
        write_plan(request.out, plan)
        return plan
    plan = read_plan(request.out)
    for name, value in stated.items():
        if value != getattr(plan, name):
            shown = " ".join(value) if isinstance(value, tuple) else value
            raise InputError(f"--{name} {shown}: {request.out} is planned otherwise; choose another --out")
    return plan
