"""The budgets of words: pages stay short enough to be read."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.samples.checkout import ROOT

WORDS = {"guides": 800, "reference": 1500, "methods": 1200, "docs": 1000, "README.md": 900}  # a page
TOGETHER = 36_000
GENERATED = re.compile(r"<!-- result:.*?<!-- end -->", re.DOTALL)
PAGES = sorted((ROOT / "docs").rglob("*.md"))


def words(path: Path) -> int:
    """The words of a page outside generated tables."""
    return len(GENERATED.sub("", path.read_text(encoding="utf-8")).split())


@pytest.mark.parametrize("path", [ROOT / "README.md", *PAGES], ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_page_keeps_its_budget(path: Path) -> None:
    most = WORDS.get(path.name, WORDS.get(path.parent.name))
    assert most is None or words(path) <= most


def test_the_documentation_keeps_its_budget() -> None:
    assert sum(map(words, PAGES)) <= TOGETHER
