"""The report of a study: `trials.csv` for other programs, `analysis.json` with all numbers, `report.md` to read."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec

from kit1000.files import json_bytes, write_bytes
from kit1000.study.analysis import Analysis, Mean, Row, analyse
from kit1000.study.plan import CONDITIONS, read_plan
from kit1000.study.records import PEOPLE, Participant, TrialRecord, read_participants

TRIALS_FILE, ANALYSIS_FILE, TABLE_FILE = "trials.csv", "analysis.json", "report.md"
COLUMNS = tuple(name for name in TrialRecord.__struct_fields__ if name not in ("format", "study", "parts"))


def write_report(study: Path) -> Path:
    """Write the report about a study's folder beside the records; returns the path of the table."""
    plan = read_plan(study)
    participants = read_participants(study, plan)
    analysis = analyse(plan, participants)
    folder = study / PEOPLE
    write_bytes(folder / TRIALS_FILE, trials_csv(participants).encode())
    write_bytes(folder / ANALYSIS_FILE, json_bytes(msgspec.to_builtins(analysis, str_keys=True)))
    write_bytes(folder / TABLE_FILE, table(analysis).encode())
    return folder / TABLE_FILE


def trials_csv(participants: Iterable[Participant]) -> str:
    """A row for each trial, also of unfinished participants; the errors of the parts stand in one cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*COLUMNS, "seated", "seated_by_test", "position_mm", "angle_deg"])
    for trial in (trial for person in participants for trial in person.trials):
        errors = [[getattr(part, name) for part in trial.parts] for name in ("position_mm", "angle_deg")]
        lists = [" ".join("NA" if error is None else str(error) for error in each) for each in errors]
        by_test = sum(part.seated_by_test for part in trial.parts)
        writer.writerow([*(getattr(trial, name) for name in COLUMNS), trial.seated, by_test, *lists])
    return text.getvalue()


def table(analysis: Analysis) -> str:
    """The Markdown text: who took part, and a table of all outcomes and scales."""
    one, other = (CONDITIONS[name].label for name in analysis.conditions)
    lines = [f"# {one} against {other}", ""]
    lines.append(
        f"{analysis.n} of {analysis.planned} planned participants have done all tasks of study {analysis.study}."
    )
    left_out = "; ".join(f"participant {number} ({why})" for number, why in analysis.left_out.items())
    lines.append(f"Left out: {left_out or 'nobody'}. Orders are {'' if analysis.balanced else 'not '}balanced.")
    late = ", ".join(f"{CONDITIONS[name].label} {count}" for name, count in analysis.out_of_time.items())
    lines.append(f"Tasks in which a part was not uploaded in time: {late}.")
    lines.append("Difference: the first condition minus the second, with the 95 % BCa interval over participants.")
    lines.append("p: of the named test; for the six scales adjusted after Holm.")
    lines += ["", f"| outcome | {one} | {other} | difference | d_z | rank-biserial | p | test |"]
    lines.append("| --- " * 8 + "|")
    lines += [_line(row, analysis.conditions) for row in (*analysis.outcomes, *analysis.ratings)]
    if analysis.preferred:
        answers = ", ".join(f"{CONDITIONS[name].label} {count}" for name, count in analysis.preferred.items())
        lines += ["", f"Preferred: {answers}."]
    return "\n".join(lines) + "\n"


def _line(row: Row, conditions: Sequence[str]) -> str:
    cells = [f"{row.label} [{row.unit}]", *(_mean_text(row.means[name]) for name in conditions)]
    found = row.difference
    if found is None:
        return f"| {' | '.join(cells)} | – | – | – | – | – |"
    effect = "–" if found.d_z is None else f"{found.d_z:.2f}"
    p = found.p if row.p_holm is None else row.p_holm
    cells += [f"{found.mean:+.1f} [{found.low:.1f}, {found.high:.1f}]", effect, f"{found.rank_biserial:.2f}"]
    cells += ["< .001" if p < 0.001 else f"{p:.3f}", found.test]
    return f"| {' | '.join(cells)} |"


def _mean_text(mean: Mean) -> str:
    spread = "" if mean.sd is None else f" ± {mean.sd:.1f}"
    return "–" if mean.mean is None else f"{mean.mean:.1f}{spread}"
