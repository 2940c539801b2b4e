"""Measured numbers: pages hold what results/ and scores.json hold, and no sentence states one by hand."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from benchmark.documents import filled
from benchmark.entries import Entry, read_entries
from benchmark.measurements import read_measurement
from tests.samples.checkout import ROOT

DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
RECORDS = ("log/", "results/release-faults.md")  # dated records, and facts of another project with their source
BLOCKS = re.compile(r"<!-- result:.*?<!-- end -->|^```.*?^```|^\|.*?$|^    .*?$", re.DOTALL | re.MULTILINE)
NUMBER = r"\d+(?:\.\d+)?"
MEASURED = [  # how a sentence says what was measured
    rf"\[{NUMBER}, ?{NUMBER}\]",  # an interval
    rf"\b(?:takes?|took|lasts?|needs?)\b[^.]{{0,40}} {NUMBER} ?(?:s|ms|seconds|minutes|hours)\b",
    rf"\b{NUMBER} ?%[^.]{{0,40}}\b(?:are|is|was|were) (?:seated|right|wrong|lost)\b",
    rf"\b(?:seats?|seated|wins?|losses|AUROC|IoU|ECE)\b[^.;:]{{0,40}}\b{NUMBER} ?%",
    rf"\b(?:median|mean) (?:error )?(?:is|of|was|are)\b[^.]{{0,20}}{NUMBER} ?(?:mm|°|s|ms|px)",
    rf"\b{NUMBER} (?:times|x) (?:faster|slower|as fast|as long)",
    rf"\({NUMBER} of {NUMBER}\)|\bn = {NUMBER}",
]
OF_THE_PAPER = re.compile(r"\bpaper|^Its ", re.IGNORECASE)


def sentences(text: str) -> list[str]:
    return re.split(r"(?<=[.!?])\s+|\n\n", BLOCKS.sub("", text))


@cache
def submissions() -> tuple[Entry, ...]:
    return read_entries(ROOT / "submissions")


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_tables_of_a_page_are_those_of_the_results(path: Path) -> None:
    assert filled(path, ROOT / "results", submissions()) == path.read_text("utf-8"), "make results"


def stated(text: str) -> list[str]:
    """The sentences that state a measured number."""
    return [
        sentence
        for sentence in sentences(text)
        if any(re.search(pattern, sentence) for pattern in MEASURED) and not OF_THE_PAPER.search(sentence)
    ]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_sentence_states_a_measured_number(path: Path) -> None:
    if not any(word in path.as_posix() for word in RECORDS):
        assert stated(path.read_text("utf-8")) == []


@pytest.mark.parametrize(
    "sentence",
    [
        "It seats 85.1 % of the parts.",
        "Registration takes about 1.3 s a query.",
        "The share is higher [72, 93] here.",
        "The median error is 0.6 mm.",
        "Ours is 13 times faster.",
        "With masks 84 % are seated.",
        "The scenes (40 of 47) end well.",
    ],
)
def test_a_measured_number_would_be_noticed(sentence: str) -> None:
    assert stated(f"Text.\n{sentence}\nMore text.") == [sentence]


def test_every_result_is_shown_on_a_page_and_can_be_read() -> None:
    shown = {name for path in DOCUMENTS for name in re.findall(r"<!-- result: (\S+)", path.read_text("utf-8"))}
    files = {path.stem: read_measurement(path) for path in sorted((ROOT / "results").glob("*.json"))}
    assert set(files) <= shown
    assert all(not found.setting["commit"].startswith("unknown") for found in files.values())
