"""The command `kit1000 study`: plans, sittings and reports in one folder."""

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
    report: bool = False


def run(request: Request) -> None:
    """Carry out a request, and print orders, an address or a path."""
    if request.report:
        if request.participant is not None:
            raise InputError("--participant: is a sitting; leave out --report")
        print(write_report(request.out))
        return
    check_output(request.out, FILE)
    with locked(request.out):
        _work(request)


def _work(request: Request) -> None:
    plan, dataset = _plan(request), Dataset(request.data)
    if dataset.id != plan.dataset_id:
        raise InputError(f"{request.data}: is dataset {dataset.id}; the study was planned on {plan.dataset_id}")
    if request.participant is None:
        print(plan.as_text())
    else:
        try:
            from kit1000.study.sitting import Sitting
        except ModuleNotFoundError as error:
            if error.name != "viser":
                raise
            raise InputError("study: a sitting needs viser: pip install 'kit1000[edit]'") from None
        files = ParticipantFiles(request.out, plan, request.participant)
        Sitting(files, dataset, request.port).run()


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
