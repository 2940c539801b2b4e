"""Refusals of many mesh files in one line: how many there are of each kind."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

DETAIL = re.compile(r"[:;(,].*| of \S+\.\w+$| when read in .*|^\d\S* ")  # of one file: names, counts, what to do
NUMBER = re.compile(r"\d\S*")  # within a reason: of one file too, but its unit stays


def refusal_counts(reasons: Iterable[str]) -> str:
    """The kinds of refusals with their numbers, most frequent first: "3x not closed, 1x empty file"."""
    kinds = Counter(NUMBER.sub("N", DETAIL.sub("", reason)).strip() or reason for reason in reasons)
    ranked = sorted(kinds.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{count}x {kind}" for kind, count in ranked)
