"""The command `python -m benchmark`: each subcommand is a typed dataclass whose fields are its options."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from kit1000.errors import InputError
from kit1000.usage import run

if TYPE_CHECKING:
    from benchmark.cache import ResultCache

PROGRAM = "python -m benchmark"
ABOUT = """The benchmark of KIT1000: scores with intervals, robustness curves, paired tests, Table I, the leaderboard.

`python -m benchmark COMMAND --help` says more about a command.

Results go to stdout, progress to stderr. Exit status: 0 good, 1 the answer is no,
2 wrong usage or bad input, 3 a fault of kit1000 itself, 130 interrupted."""

Optional = Annotated[Path | None, tyro.conf.arg(metavar="PATH")]
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
One = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SUBMISSION")]
Several = Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SUBMISSION...")]
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Split = Literal["test", "test-all", "val", "train"]


@dataclass(frozen=True)
class Score:
    """Score a submission: print a table, write scores.json."""

    submission: One
    """Folder with manifest.toml and predictions.csv."""
    data: Folder
    """Dataset folder, with its truth."""
    out: Optional = None
    """File for the scores; scores.json in the folder of the submission when absent."""
    per_query: Optional = None
    """File for one row a query, as CSV."""
    split: Split = "test"
    """Which queries; with test the curves are scored too."""
    judge: Literal["near", "all", "never"] = "near"
    """Whom the exact judge of seating is asked about: answers near a limit, all, or none."""
    workers: int = 1
    """Processes for the seating test; any number gives the same scores."""
    cache: Optional = None
    """Folder of results that serve again; below ~/.cache/kit1000 when absent."""
    no_cache: Flag = False
    """Measure all anew and keep nothing."""
    breakdown: Flag = False
    """Print the breakdown too."""

    def run(self) -> int:
        """Score, write and print."""
        from benchmark.per_query import write_per_query
        from benchmark.report import json_text, score_text
        from benchmark.score import read_checked, score
        from kit1000.dataset.reader import Dataset
        from kit1000.files import write_bytes

        workers, kept = _workers(self.workers), _cache(self.cache, self.no_cache)
        submission = read_checked(self.submission, self.data, self.split)
        scored = score(submission, Dataset(self.data), None, self.split, self.judge, workers, kept)
        write_bytes(self.out or self.submission / "scores.json", json_text(scored.summary).encode())
        if self.per_query is not None:
            write_per_query(self.per_query, scored.rows)
        print(score_text(scored.summary, self.breakdown))
        return 0


@dataclass(frozen=True)
class Rescore:
    """Score submissions again and say whether their scores.json is what comes out, to the last digit."""

    submissions: Several
    """Folders with predictions.csv and scores.json."""
    data: Folder
    """Dataset folder, with its truth."""
    workers: int = 1
    """Processes, each with a submission of its own."""

    def run(self) -> int:
        """Score and compare."""
        from benchmark.rescore import rescored

        same = True
        for folder, found in rescored(self.submissions, self.data, _workers(self.workers)):
            told = f"{len(found)} values differ; {found[0]}" if found else "the same scores"
            print(f"{folder}: {told}", flush=True)
            same &= not found
        return 0 if same else 1


@dataclass(frozen=True)
class Curves:
    """Draw the robustness curves of scored submissions: curves.svg, and curves.csv with the numbers."""

    submissions: Several
    """Folders with scores.json; several are drawn into one figure."""
    out: Folder
    """Folder for the two files."""

    def run(self) -> int:
        """Draw, then say where."""
        from benchmark.curves import write_curves

        print(*write_curves(self.submissions, self.out), sep="\n")
        return 0


@dataclass(frozen=True)
class Compare:
    """Say which of two methods is better: paired differences with intervals, and McNemar's test of seating."""

    a: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="A")]
    """Folder of a submission."""
    b: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="B")]
    """Folder of another."""
    data: Folder
    """Dataset folder, with its truth."""
    tracks: tuple[str, ...] = ()
    """Just these tracks; all that both answer when absent."""
    out: Optional = None
    """File for the same as JSON."""
    workers: int = 1
    """Processes for the seating test."""
    cache: Optional = None
    """Folder of results that serve again; below ~/.cache/kit1000 when absent."""
    no_cache: Flag = False
    """Measure all anew and keep nothing."""

    def run(self) -> int:
        """Compare and print."""
        from benchmark.compare import run as compare

        kept = _cache(self.cache, self.no_cache)
        compare(self.a, self.b, self.data, self.tracks, self.out, _workers(self.workers), kept)
        return 0


@dataclass(frozen=True)
class Table1:
    """Set the scores of all submissions beside Table I of the paper."""

    submissions: Folder = Path("submissions")
    """Folder with a folder for each method, scores.json in it."""
    out: Optional = None
    """File to write in place of printing: .md, .json or .html; in an .md file the table there is replaced."""

    def run(self) -> int:
        """Print the table."""
        from benchmark.table1 import run as table1

        table1(self.submissions, self.out)
        return 0


@dataclass(frozen=True)
class Pages:
    """Build the leaderboard as static pages."""

    submissions: Folder = Path("submissions")
    """Folder with a folder for each method, manifest.toml and scores.json in it."""
    out: Folder = Path("site/board")
    """Folder for the pages."""
    data: Optional = None
    """Dataset folder, with its truth: single cases are drawn too."""

    def run(self) -> int:
        """Build, then say where."""
        from benchmark.pages import build

        build(self.submissions, self.out, self.data)
        print(self.out)
        return 0


def _cache(folder: Path | None, none: bool) -> ResultCache | None:
    """Where results are kept."""
    from benchmark.cache import ResultCache, user_folder

    if none and folder is not None:
        raise InputError("--cache and --no-cache: give one of them")
    return None if none else ResultCache(folder or user_folder())


def _workers(count: int) -> int:
    if count < 1:
        raise InputError(f"--workers: expected 1 or more, got {count}")
    return count


COMMANDS = {"score": Score, "rescore": Rescore, "curves": Curves, "compare": Compare, "table1": Table1, "pages": Pages}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run(PROGRAM, COMMANDS, ABOUT, arguments)


if __name__ == "__main__":
    sys.exit(main())
