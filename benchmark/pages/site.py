"""Writes the site: index.html, table1.html, a page for each method under methods/, a style sheet and a script."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from benchmark import quantities, table1
from benchmark.curve_charts import compared
from benchmark.curves import CURVES
from benchmark.entries import Entry
from benchmark.pages import board as boards
from benchmark.pages import method as methods
from benchmark.pages.board import Board, mean_cell, median_cell, percent, read_board
from kit1000.dataset.scene_data import LICENCE
from kit1000.files import check_output, write_bytes
from kit1000.pictures import charts

TEMPLATES = Path(__file__).parent / "templates"


def build(submissions: Path, out: Path, rescored: bool = False) -> None:
    """Write the pages of all scored submissions of a folder.

    Args:
        submissions: a folder with a folder for each method, `manifest.toml` and `scores.json` in it.
        out: where the pages go; made if it is missing.
        rescored: whether `benchmark.score` has reproduced the scores; stated on every page.
    """
    board = read_board(submissions)
    pages = _environment(board, rescored)
    check_output(out, "board.js")
    write_bytes(out / "style.css", ((TEMPLATES / "style.css").read_text("utf-8") + charts.STYLE).encode())
    write_bytes(out / "board.js", (TEMPLATES / "board.js").read_bytes())
    for entry in board.entries:
        _write(out / "methods" / f"{entry.name}.html", pages, "method.html", _method(entry))
    for entry in board.real:
        values = _method(entry) | {"setting": entry.setting}
        _write(out / "methods" / f"{entry.name}.html", pages, "method.html", values)
    table = {"table": table1.table_of(board.entries), "description": table1.DESCRIPTION, "notes": table1.NOTES}
    _write(out / "table1.html", pages, "table1.html", table)
    _write(out / "index.html", pages, "index.html", _index(board))


def _environment(board: Board, rescored: bool) -> jinja2.Environment:
    pages = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,  # manifests are text of other people
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    pages.globals |= {"board": board, "setting": board.setting, "data_licence": LICENCE, "rescored": rescored}
    functions = (mean_cell, median_cell, percent, methods.track_charts, methods.groups)
    pages.globals |= {function.__name__: function for function in (*functions, methods.case_text)}
    pages.globals["case_titles"] = methods.CASE_TITLES
    return pages


def _write(path: Path, pages: jinja2.Environment, template: str, values: dict[str, Any]) -> None:
    write_bytes(path, pages.get_template(template).render(values).encode())


def _index(board: Board) -> dict[str, Any]:
    drawn = [e for e in board.entries if e.scores["curves"] and not (e.manifest.control or e.knows_shapes)]
    curves = {entry.manifest.display_name: entry.scores["curves"] for entry in drawn}
    return {
        "tables": boards.track_tables(board),
        "columns": boards.columns(),
        "sorted_by": boards.SORTED_BY,
        "runtimes": boards.RUNTIMES,
        "curve_scenes": {entry.manifest.display_name: entry.scores["curve_scenes"] for entry in drawn},
        "curves": [Markup(chart) for curve in CURVES for chart in compared(curve, curves)],
    }


def _method(entry: Entry) -> dict[str, Any]:
    return {
        "entry": entry,
        "quantities": quantities.QUANTITIES,
        "explained": [quantity for quantity in quantities.QUANTITIES if "board" not in quantity.outputs],
        "in_breakdown": quantities.shown_in("breakdown"),
        "in_cases": quantities.shown_in("cases"),
        "curves": methods.curve_charts(entry),
        "tracks": {track: entry.scores["tracks"][track] for track in methods.tracks_of(entry)},
    }
