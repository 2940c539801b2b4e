"""The report of a study: `report.json` with all numbers, and `report.html`, which opens from a disk.

A report is about people, or about one simulated operator; then every title says so.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from kit1000.files import json_bytes, write_own
from kit1000.pictures.charts import STYLE as CHART_STYLE
from kit1000.study.analysis import PLOTTED, analyse
from kit1000.study.conditions import CONDITIONS
from kit1000.study.execution import NOMINAL_S, ROBOT
from kit1000.study.finished_trials import chosen_operator, read_participants
from kit1000.study.plots import Column, Difference, difference_plot, outcome_plot, people_plot
from kit1000.study.report_texts import METHOD, MODELS, SIMULATED_MEANS, STYLE
from kit1000.study.statistics import ALPHA, RESAMPLES
from kit1000.study.study_plan import MAIN_OUTCOME, read_plan
from kit1000.study.study_records import SIMULATED

JSON_FILE, PAGE_FILE = "report.json", "report.html"


def write_report(study: Path, simulated: str | None = None, seed: int = 0) -> Path:
    """Write the report beside the records that it is about; returns the path of the page.

    Args:
        study: folder of the study.
        simulated: the operator whose records are meant; None for people, or for the only ones there are.
        seed: of the resampling.
    """
    plan = read_plan(study)
    operator = chosen_operator(study, simulated)
    numbers = analyse(plan, operator, read_participants(study, plan, operator), seed)
    folder = operator.folder(study)
    write_own(folder / JSON_FILE, json_bytes(numbers))
    write_own(folder / PAGE_FILE, page(numbers).encode())
    return folder / PAGE_FILE


def page(numbers: Mapping[str, Any]) -> str:
    """The page of a report."""
    simulated = numbers["operator"]["kind"] == SIMULATED
    who = f"SIMULATED ({numbers['operator']['name']})" if simulated else ""
    success = "the robot has seated it" if numbers["judge"] == ROBOT else "its motion passes the seating test"
    sections = [
        _banner(numbers) if simulated else "",
        _section(who, "Result", _result(numbers)),
        _section(who, "Outcomes", _plots(numbers, who) + _means_table(numbers, numbers["outcomes"])),
        _section(who, "Comparisons", _difference_plots(numbers, who) + _contrasts(numbers["outcomes"])),
        _section(who, "Load", _load(numbers, who)),
        _section(who, "Order and learning", _order(numbers)),
        _section(who, "Who and what", _facts(numbers)),
        _section(who, "Method", METHOD.format(resamples=RESAMPLES, alpha=ALPHA, success=success)),
    ]
    title = f"{who}: user study" if who else "User study"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{STYLE}{CHART_STYLE}</style>\n</head>\n<body>\n<main>\n"
        f"<h1>{escape(title)}</h1>\n"
        f'<p class="soft">{_compared(numbers)}</p>\n'
        + "\n".join(filter(None, sections))
        + "\n</main>\n</body>\n</html>\n"
    )


def _compared(numbers: Mapping[str, Any]) -> str:
    names = " against ".join(escape(_label(name)) for name in numbers["conditions"])
    return f"{names}. {numbers['n']} {_people(numbers)}, study {numbers['study']}."


def _people(numbers: Mapping[str, Any]) -> str:
    return "simulated participants" if numbers["operator"]["kind"] == SIMULATED else "participants"


def _section(who: str, title: str, body: str) -> str:
    return f"<h2>{escape(f'{who}: {title}' if who else title)}</h2>\n{body}" if body else ""


def _banner(numbers: Mapping[str, Any]) -> str:
    name = numbers["operator"]["name"]
    return f'<div class="warning"><p><strong>No person took part.</strong> {MODELS[name]}</p>{SIMULATED_MEANS}</div>'


def _result(numbers: Mapping[str, Any]) -> str:
    main = next(row for row in numbers["outcomes"] if row["name"] == MAIN_OUTCOME)
    lines = []
    for contrast in main["contrasts"]:
        if "p" in contrast:
            verdict = "differ" if contrast["p"] < ALPHA else "no difference is shown"
            lines.append(
                f"<li><strong>{escape(contrast['name'])}</strong>: {_signed(contrast['mean'])} points of success "
                f"[{_signed(contrast['low'])}, {_signed(contrast['high'])}], {_p_text(contrast['p'])} "
                f"({contrast['test']}): {verdict}.</li>"
            )
    judge = "the robot seats" if numbers["judge"] == ROBOT else "pass the seating test (no robot was at work)"
    return f"<p>Main outcome, named before any data: the share of parts that {judge}.</p><ul>{''.join(lines)}</ul>"


def _plots(numbers: Mapping[str, Any], who: str) -> str:
    charts = [_people_chart(numbers, row, who) for row in numbers["outcomes"][:PLOTTED]]
    parts = {CONDITIONS[name].short: counts for name, counts in numbers["parts"].items()}
    charts.append(outcome_plot(_titled(who, "What became of the parts"), "Parts by condition and outcome.", parts))
    return _figures(charts)


def _people_chart(numbers: Mapping[str, Any], row: Mapping[str, Any], who: str) -> str:
    columns = []
    for hue, name in enumerate(numbers["conditions"]):
        mean = row["means"][name]
        values = {f"participant {number}": value for number, value in row["values"][name].items()}
        columns.append(Column(CONDITIONS[name].short, values, mean["mean"], mean["low"], mean["high"], hue))
    words = f"{row['label']}: a line for each participant, and the means with 95 % intervals."
    return people_plot(_titled(who, row["label"]), words, row["unit"], columns)


def _difference_plots(numbers: Mapping[str, Any], who: str) -> str:
    charts = []
    for row in numbers["outcomes"][:PLOTTED]:
        rows = [
            Difference(contrast["short"], contrast["mean"], contrast["low"], contrast["high"])
            for contrast in row["contrasts"]
            if "p" in contrast
        ]
        if any(row.low or row.high for row in rows):  # else nobody has any difference
            words = f"{row['label']}: mean differences with 95 % intervals."
            charts.append(difference_plot(_titled(who, f"{row['label']}: difference"), words, row["unit"], rows))
    return _figures(charts)


def _load(numbers: Mapping[str, Any], who: str) -> str:
    if not numbers["ratings"]:
        if numbers["operator"]["kind"] == SIMULATED:
            return "<p>None: load is a matter of people, and is never simulated.</p>"
        return "<p>No ratings were given.</p>"
    charts = [_people_chart(numbers, row, who) for row in numbers["ratings"]]
    table = _means_table(numbers, numbers["ratings"]) + _contrasts(numbers["ratings"])
    preferred = ", ".join(f"{escape(_label(name))} {count}" for name, count in numbers["preferred"].items())
    asked = f"<p>Which way would you rather use again? {preferred}.</p>" if preferred else ""
    return _figures(charts) + table + asked


def _means_table(numbers: Mapping[str, Any], rows: Iterable[Mapping[str, Any]]) -> str:
    head = ["", *(_label(name) for name in numbers["conditions"])]
    body = []
    for row in rows:
        first = f"{escape(row['label'])} <span class='soft'>{escape(row['unit'])}</span>"
        body.append([first, *(_mean_cell(row["means"][name]) for name in numbers["conditions"])])
    return _table(head, body) + "<p class='soft'>Mean over people, standard deviation, 95 % interval of the mean.</p>"


def _mean_cell(mean: Mapping[str, Any]) -> str:
    if mean["mean"] is None:
        return "–"
    spread = "" if mean["sd"] is None else f" ± {_plain(mean['sd'])}"
    span = "" if mean["low"] is None else f" <span class='soft'>[{_plain(mean['low'])}, {_plain(mean['high'])}]</span>"
    return f"{_plain(mean['mean'])}{spread}{span}"


def _contrasts(rows: Iterable[Mapping[str, Any]]) -> str:
    head = ["", "difference", "95 %", "d_z", "rank-biserial", "t: p", "Wilcoxon: p", "counts"]
    body, adjusted = [], False
    for row in rows:
        for contrast in row["contrasts"]:
            if "p" not in contrast:
                continue
            counted = _p_text(contrast["p"])
            if "p_holm" in contrast:
                adjusted, counted = True, f"{_p_text(contrast['p_holm'])} (Holm)"
            effect = "–" if contrast["d_z"] is None else _signed(contrast["d_z"], 2)
            name = (
                f"{escape(row['label'])}<br><span class='soft'>{escape(contrast['name'])}, n = {contrast['n']}</span>"
            )
            span = f"{_signed(contrast['low'])} to {_signed(contrast['high'])}"
            tests = [_p_text(contrast["t_p"]), _p_text(contrast["wilcoxon_p"])]
            shown = f"{contrast['test']}: {counted}"
            body.append(
                [name, _signed(contrast["mean"]), span, effect, _signed(contrast["rank_biserial"], 2), *tests, shown]
            )
    if not body:
        return ""
    note = "Adjusted for the six scales after Holm. " if adjusted else ""
    return _table(head, body) + f"<p class='soft'>{note}Both tests are shown; the last column says which counts.</p>"


def _order(numbers: Mapping[str, Any]) -> str:
    crossed = any(row.get("crossover") for row in numbers["order"])
    head = ["", *(f"{i}. condition" for i in range(1, len(numbers["conditions"]) + 1))]
    head += ["carry-over", "period"] if crossed else []
    body = []
    for row in numbers["order"]:
        found, cells = row.get("crossover"), []
        if found:
            cells = [
                f"{_signed(found['carry_over'])} ({_p_text(found['carry_over_p'])})",
                f"{_signed(found['period'])} ({_p_text(found['period_p'])})",
            ]
        label = f"{escape(row['label'])} <span class='soft'>{escape(row['unit'])}</span>"
        body.append([label, *(_plain(value) for value in row["by_position"]), *cells])
    learned = [
        [
            escape(_label(row["condition"])),
            _signed(row["mean"]),
            f"{_signed(row['low'])} to {_signed(row['high'])}",
            _p_text(row["p"]),
        ]
        for row in numbers["learning"]
    ]
    words = (
        "<p class='soft'>Carry-over: sum over both conditions of those who met the first one first, minus that of "
        "the others. Period: the second minus the first, whichever condition it was. Neither has much power.</p>"
    )
    return (
        _table(head, body)
        + (words if crossed else "")
        + _table(["Specification, second task of a size minus the first", "s", "95 %", ""], learned)
        + "<p class='soft'>The tasks of a set come in a fixed order: this is learning and a difference of scenes.</p>"
    )


def _facts(numbers: Mapping[str, Any]) -> str:
    left_out = "; ".join(f"participant {row['participant']} ({escape(row['why'])})" for row in numbers["left_out"])
    late = ", ".join(f"{escape(_label(name))} {count}" for name, count in numbers["out_of_time"].items())
    agree = numbers["robot_and_test_agree"]
    tasks = f"dataset {numbers['dataset_id']}, {numbers['sensor']} depth, snapping by {numbers['snap']}"
    items = [
        f"{numbers['n']} of {numbers['planned']} planned {_people(numbers)} have done all tasks.",
        f"Left out: {left_out or 'nobody'}.",
        "All orders are balanced." if numbers["balanced"] else "The orders are not all balanced: people are missing.",
        f"Tasks with a part that time did not suffice for: {late}.",
        f"Sittings that were broken off and went on: {numbers['interruptions']}.",
        f"Robot and seating test agree on {agree['agree']} of {agree['parts']} uploaded parts."
        if numbers["judge"] == ROBOT
        else f"No robot was at work: the seating test judged {agree['parts']} parts, at {NOMINAL_S:.0f} s each.",
        f"Tasks: {escape(tasks)}.",
    ]
    return "<ul>" + "".join(f"<li>{item}</li>" for item in items) + "</ul>"


def _table(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    """A table; the cells of the body are HTML, those of the head text."""
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    rows = "\n".join(f"<tr><th>{row[0]}</th>{''.join(f'<td>{cell}</td>' for cell in row[1:])}</tr>" for row in body)
    return f'<div class="wide"><table>\n<thead><tr>{top}</tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>\n'


def _figures(charts: Sequence[str]) -> str:
    return f'<div class="figures">{"".join(charts)}</div>\n' if charts else ""


def _titled(who: str, title: str) -> str:
    return f"simulated: {title[0].lower()}{title[1:]}" if who else title


def _label(condition: str) -> str:
    return CONDITIONS[condition].label


def _plain(value: float) -> str:
    return f"{value:.1f}" if abs(value) >= 0.05 or value == 0 else f"{value:.3f}"


def _signed(value: float, digits: int = 1) -> str:
    text = f"{value:+.{digits}f}"
    return text.replace("-", "\u2212") if float(text) else f"{0:.{digits}f}"


def _p_text(p: float) -> str:
    return "p < .001" if p < 0.001 else f"p = {p:.3f}".replace("0.", ".", 1)
