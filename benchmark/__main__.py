"""The command `python -m benchmark`: each subcommand is a typed dataclass whose fields are its options."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from kit1000.cli.command_line import check_least, run
from kit1000.cli.options import OptionalInt, OptionalPath
from kit1000.errors import InputError

PROGRAM = "python -m benchmark"
ABOUT = """The benchmark of KIT1000: scores with intervals, robustness curves, paired tests, Table I, the leaderboard.

`python -m benchmark COMMAND --help` shows the options of a command.

Results go to stdout, progress to stderr. Exit status: 0 success, 1 a check failed,
2 wrong usage or bad input, 3 a fault of kit1000 itself, 130 interrupted."""

Folder = Annotated[Path, arg(metavar="DIR")]
One = Annotated[Positional[Path], arg(metavar="SUBMISSION")]
Several = Annotated[Positional[tuple[Path, ...]], arg(metavar="SUBMISSION...")]
Split = Literal["test", "test-all", "val", "train"]


@dataclass(frozen=True)
class Score:
    """Score a submission: print a table, write scores.json."""

    submission: One
    """Folder with manifest.toml and predictions.csv."""
    data: Folder
    """Dataset folder, with ground truth."""
    out: OptionalPath = None
    """File for the scores; scores.json in the folder of the submission if absent."""
    per_query: OptionalPath = None
    """CSV file with one row per query."""
    split: Split = "test"
    """Split to score; with test the curves are scored too."""
    exact: Literal["near", "all", "never"] = "near"
    """Predictions that the exact seating test decides: those near a limit, all, or none."""
    workers: int = 1
    """Number of processes for the seating test; any number gives the same scores."""
    breakdown: bool = False
    """Print the breakdown by properties of the queries too."""

    def run(self) -> int:
        """Score, write and print."""
        from benchmark.evaluate import write_per_query
        from benchmark.report import json_text, score_text
        from benchmark.score import invalid_text, read_checked, score
        from kit1000.dataset.reader import Dataset
        from kit1000.files import write_bytes, write_own

        check_least(workers=(self.workers, 1))
        if self.out is None:
            _check_scores(self.submission / "scores.json")
        submission = read_checked(self.submission, self.data, self.split)
        if warning := invalid_text(submission):
            print(f"{PROGRAM}: {warning}", file=sys.stderr)
        scores = score(submission, Dataset(self.data), None, self.split, self.exact, self.workers)
        print(score_text(scores.summary, self.breakdown))  # before a file that cannot be written
        text = json_text(scores.summary).encode()
        if self.out is None:
            write_bytes(self.submission / "scores.json", text)
        else:
            write_own(self.out, text)
        if self.per_query is not None:
            write_per_query(self.per_query, scores.rows)
        return 0


@dataclass(frozen=True)
class Rescore:
    """Score submissions again and check that their scores.json is the result, to the last digit."""

    submissions: Several
    """Folders with predictions.csv and scores.json."""
    data: Folder
    """Dataset folder, with ground truth."""
    workers: int = 1
    """Number of processes; each scores one submission at a time."""
    refresh: bool = False
    """Write scores.json again if the scores are the same, so that it names the current code."""

    def run(self) -> int:
        """Score and compare."""
        from benchmark.rescore import rescore

        check_least(workers=(self.workers, 1))
        same = True
        for folder, differences in rescore(self.submissions, self.data, self.workers, self.refresh):
            result = f"{len(differences)} values differ; {differences[0]}" if differences else "the same scores"
            print(f"{folder}: {result}", flush=True)
            same &= not differences
        return 0 if same else 1


@dataclass(frozen=True)
class Curves:
    """Draw the robustness curves of scored submissions: curves.svg, and curves.csv with the numbers."""

    submissions: Several
    """Folders with scores.json; several are drawn into one figure."""
    out: Folder
    """Folder for the two files."""

    def run(self) -> int:
        """Draw, then print the files."""
        from benchmark.curve_charts import write_curves

        print(*write_curves(self.submissions, self.out), sep="\n")
        return 0


@dataclass(frozen=True)
class Compare:
    """Compare two methods: paired differences with intervals, and McNemar's test of seating."""

    a: Annotated[Positional[Path], arg(metavar="A")]
    """Folder of the first submission."""
    b: Annotated[Positional[Path], arg(metavar="B")]
    """Folder of the second submission."""
    data: Folder
    """Dataset folder, with ground truth."""
    tracks: tuple[str, ...] = ()
    """Tracks to compare; all that both have if absent."""
    out: OptionalPath = None
    """JSON file for the comparison."""
    workers: int = 1
    """Number of processes for the seating test."""

    def run(self) -> int:
        """Compare and print."""
        from benchmark.compare import run as compare

        check_least(workers=(self.workers, 1))
        compare(self.a, self.b, self.data, self.tracks, self.out, self.workers)
        return 0


@dataclass(frozen=True)
class Table1:
    """Print the scores of all submissions beside Table I of the paper, as Markdown."""

    submissions: Folder = Path("submissions")
    """Folder with a folder for each method, manifest.toml and scores.json in it."""

    def run(self) -> int:
        """Print the table."""
        from benchmark.table1 import as_markdown, read_table

        print(as_markdown(read_table(self.submissions)), end="")
        return 0


@dataclass(frozen=True)
class Table2:
    """Let the robot carry submissions out, and print the shares of parts seated beside Table II of the paper."""

    submissions: Several
    """Submission folders or predictions files, a row each; the true motions are a row anyway."""
    data: Folder
    """Dataset folder, with ground truth."""
    track: Annotated[str, arg(metavar="NAME")] = "snap-d415"
    """Track whose queries are carried out."""
    split: Split = "test"
    """Split of the queries; test-all has every part of a test scene."""
    components: OptionalPath = None
    """JSON file with the measures of segmentation and completion."""
    masks: Literal["given", "predicted"] = "given"
    """Masks by which the robot finds parts in rows that state predicted masks: recorded or predicted ones."""
    scenes: OptionalInt = None
    """Number of scenes, the first ones; all if absent."""
    out: OptionalPath = None
    """JSON file for the numbers."""

    def run(self) -> int:
        """Print the table."""
        from benchmark.table2 import run as table2

        options = (self.track, self.split, self.components, self.scenes, self.out, self.masks)
        print(table2(self.data, self.submissions, *options))
        return 0


@dataclass(frozen=True)
class Pages:
    """Build the leaderboard as static pages."""

    submissions: Folder = Path("submissions")
    """Folder with a folder for each method, manifest.toml and scores.json in it."""
    out: Folder = Path("site/board")
    """Folder for the pages."""
    rescored: bool = False
    """State on every page that `rescore` has reproduced the scores; else that they are as submitted."""

    def run(self) -> int:
        """Build, then print the folder."""
        from benchmark.pages import build

        build(self.submissions, self.out, self.rescored)
        print(self.out)
        return 0


@dataclass(frozen=True)
class Documents:
    """Fill the tables of documents from results/ and submissions/."""

    documents: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE...")]
    """Markdown files with marks."""
    results: Folder = Path("results")
    """Folder of NAME.json files, as the programs of bench/ write them."""
    submissions: Folder = Path("submissions")
    """Folder with a folder for each submission."""

    def run(self) -> int:
        """Name the documents that changed."""
        from benchmark.documents import run as fill

        for path in fill(self.documents, self.results, self.submissions):
            print(f"{path}: filled")
        return 0


def _check_scores(path: Path) -> None:
    """Raise InputError if a file holds anything but scores: only scores may be replaced."""
    from kit1000.files import read_json

    if not path.is_file():
        return
    try:
        known = read_json(path)
    except InputError:
        known = None
    if not isinstance(known, dict) or "protocol" not in known:
        raise InputError(f"{path}: exists and holds no scores: it stays; name another file by --out")


COMMANDS = {
    "score": Score,
    "rescore": Rescore,
    "curves": Curves,
    "compare": Compare,
    "table1": Table1,
    "table2": Table2,
    "documents": Documents,
    "pages": Pages,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run(PROGRAM, COMMANDS, ABOUT, arguments)


if __name__ == "__main__":
    sys.exit(main())
