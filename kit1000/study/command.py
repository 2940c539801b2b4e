"""The command `kit1000 study`: plans, sittings and reports in one folder."""

from __future__ import annotations

from collections.abc import Mapping
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


def run(
    data: Path, out: Path, participant: int | None = None, port: int | None = None, report: bool = False, **plan: Any
) -> None:
    """Plan, serve the sitting of a participant, or report; prints orders, an address or a path.

    plan: values of a new plan; None or empty: that of DEFAULTS.
    """
    if report:
        if participant is not None:
            raise InputError("--participant: is a sitting; leave out --report")
        print(write_report(out))
        return
    check_output(out, FILE)
    with locked(out):
        planned, dataset = _plan(data, out, plan), Dataset(data)
        if dataset.id != planned.dataset_id:
            raise InputError(f"{data}: is dataset {dataset.id}; the study was planned on {planned.dataset_id}")
        if participant is None:
            print(planned.as_text())
            return
        try:
            from kit1000.study.sitting import Sitting
        except ModuleNotFoundError as error:
            if error.name != "viser":
                raise
            raise InputError("study: a sitting needs viser: pip install 'kit1000[edit]'") from None
        Sitting(ParticipantFiles(out, planned, participant), dataset, port).run()


def _plan(data: Path, out: Path, options: Mapping[str, Any]) -> StudyPlan:
    """The plan of the folder, made first if there is none; an option that contradicts it is refused."""
    stated = {name: value for name, value in options.items() if value not in (None, ())}
    if not (out / FILE).is_file():
        plan = make_plan(Dataset(data), **{**DEFAULTS, **stated})
        write_plan(out, plan)
        return plan
    plan = read_plan(out)
    for name, value in stated.items():
        if value != getattr(plan, name):
            shown = " ".join(value) if isinstance(value, tuple) else value
            raise InputError(f"--{name} {shown}: {out} is planned otherwise; choose another --out")
    return plan
