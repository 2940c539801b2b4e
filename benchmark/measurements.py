"""A measurement: tables of what a program measured, with the setting in which it did; results/NAME.json holds one.

A program adds rows to tables and prints them; by `--out` it also writes the file. Documents show its tables between
marks, see `benchmark.documents`, so no number that was measured is ever typed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmark.intervals import ENDS, bootstrap_means, wilson_interval
from benchmark.provenance import commit
from benchmark.report import Grid, json_text
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.files import write_bytes
from kit1000.metrics import METRIC_VERSIONS
from kit1000.prediction.predict import hardware

NO_VALUE = "–"  # if nothing was measured
SETTING = (
    "command",
    "commit",
    "date",
    "hardware",
    "dataset_id",
    "data_version",
    "metric_versions",
)  # beside the tables


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    key: str
    """Key of its values in each row."""
    heading: str
    """Heading with the unit, such as `error, mm`."""
    decimals: int | None = None
    """Number of decimals; None for text and whole numbers."""
    percent: bool = False
    """Whether shares from 0 to 1 are shown in percent."""

    def text(self, value: Any) -> str:
        """A value as shown: a number, a text, or an estimate as `mean [low, high]`."""
        if isinstance(value, Mapping):
            middle = value["rate"] if "rate" in value else value["mean"]
            low, high = value["ci95"]
            return f"{self.text(middle)} [{self.text(low)}, {self.text(high)}]"
        if value is None or (isinstance(value, float) and not np.isfinite(value)):
            return NO_VALUE
        if self.decimals is None or isinstance(value, str):
            return str(value)
        return f"{round(100 * value if self.percent else value, self.decimals) + 0.0:,.{self.decimals}f}"


@dataclass
class Table:
    """Rows of values under columns."""

    name: str
    """Name within its measurement, as in the mark of a document."""
    title: str
    """One line that says what is compared, over how many cases."""
    columns: Sequence[Column]
    rows: list[dict[str, Any]] = field(default_factory=list)

    def add(self, **values: Any) -> None:
        """Add a row: values by the keys of columns; numbers of numpy become those of Python."""
        unknown = set(values) - {column.key for column in self.columns}
        if unknown:
            raise InputError(f"table {self.name}: there is no column {', '.join(sorted(unknown))}")
        self.rows.append({key: _plain(value) for key, value in values.items()})

    def grid(self) -> Grid:
        """The rows as shown."""
        cells = [[column.text(row.get(column.key)) for column in self.columns] for row in self.rows]
        words = [column.decimals is None and column.key != "n" for column in self.columns]
        return Grid([column.heading for column in self.columns], cells, words)

    def markdown(self) -> str:
        """The table as Markdown, its title in bold above it."""
        return f"**{self.title}**\n\n{self.grid().markdown()}"


@dataclass
class Measurement:
    """The tables of a program and their setting, which is written down when it begins."""

    setting: dict[str, Any]
    """Values by SETTING."""
    tables: dict[str, Table] = field(default_factory=dict)

    @classmethod
    def begin(cls, dataset: Dataset | None = None) -> Measurement:
        """A measurement without tables, of this command on this machine. dataset: what it measures on, if any."""
        setting = {
            "command": _command(dataset),
            "commit": commit(),
            "date": datetime.now(timezone.utc).strftime("%Y-%m-%d"),
            "hardware": hardware(),
            "dataset_id": dataset.id if dataset else None,
            "data_version": dataset.summary["data_version"] if dataset else None,
            "metric_versions": dict(METRIC_VERSIONS),
        }
        return cls(setting)

    def table(self, name: str, title: str, *columns: Column) -> Table:
        """Add an empty table."""
        self.tables[name] = Table(name, title, columns)
        return self.tables[name]

    def report(self, out: Path | None) -> None:
        """Print the tables and, if `out` is given, write them there as JSON."""
        print(self.text())
        if out is not None:
            self.write(out)

    def text(self) -> str:
        """The tables for a terminal."""
        return "\n\n".join(f"{each.title}\n{each.grid().text('  ')}" for each in self.tables.values())

    def stored(self) -> dict[str, Any]:
        """The setting, and `tables` by name, as JSON holds them."""
        tables = {
            name: {
                "title": each.title,
                "columns": [[c.key, c.heading, c.decimals, c.percent] for c in each.columns],
                "rows": each.rows,
            }
            for name, each in self.tables.items()
        }
        return {**self.setting, "tables": tables}

    def write(self, path: Path) -> None:
        """Write the measurement as JSON."""
        write_bytes(path, json_text(self.stored()).encode())


def read_measurement(path: Path) -> Measurement:
    """The measurement in a file. Raises InputError with the name of the file if it holds none."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        setting = {key: stored[key] for key in SETTING}
        tables = {
            name: Table(name, each["title"], [Column(*column) for column in each["columns"]], each["rows"])
            for name, each in stored["tables"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path}: expected a measurement as a program of bench/ writes it by --out ({error})"
        ) from error
    return Measurement(setting, tables)


def estimate(values: ArrayLike, clusters: Sequence[str] | None = None) -> dict[str, Any]:
    """n, mean, median and the 95 % interval of the mean of (n,) values, by a bootstrap over clusters.

    clusters: n labels; values of equal labels are not independent, such as those of one assembly. None: all are.
    """
    values = np.asarray(values, float)
    if not len(values):
        raise InputError("values: none, and a mean needs at least one")
    labels = np.arange(len(values)) if clusters is None else np.asarray(clusters)
    low, high = np.quantile(bootstrap_means(values[:, None], [labels])[:, 0], ENDS)
    return {"n": len(values), "mean": values.mean(), "median": np.median(values), "ci95": [low, high]}


def rate(passed: ArrayLike) -> dict[str, Any]:
    """n, share and Wilson's 95 % interval of (n,) bool."""
    passed = np.asarray(passed, bool)
    if not len(passed):
        raise InputError("values: none, and a share needs at least one")
    share = float(passed.mean())
    return {"n": len(passed), "rate": share, "ci95": list(wilson_interval(share, len(passed)))}


def _command(dataset: Dataset | None) -> str:
    """The command line as one would type it in the checkout, with DATA for the folder of the dataset."""
    root = Path(__file__).parents[1]
    program = Path(sys.argv[0]).resolve()
    inside = program.is_relative_to(root) and ".venv" not in program.parts
    words = [program.relative_to(root).as_posix() if inside else program.name, *sys.argv[1:]]
    here = {str(dataset.root), str(dataset.root.resolve())} if dataset else set()
    kept: list[str] = []
    for word in words:
        kept.append("DATA" if here & {word, str(Path(word).resolve())} else word)
    if "--out" in kept:  # where it is written changes no measurement
        place = kept.index("--out")
        del kept[place : place + 2]
    return " ".join(["python", *kept])


def _plain(value: Any) -> Any:
    """A value with numbers of numpy as those of Python; infinite and undefined ones are None, which JSON can hold."""
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
