"""The texts of a sitting: consent, raw NASA-TLX without preset values, and the question of preference.

Raw means unweighted (Hart and Staveland 1988; Hart 2006). The questions and the ends of the scales are those of
the paper form, a work of the United States government. Each of the six scales has 21 steps, 0 to 100 by 5. Low is good
on each: performance runs from perfect to failure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

STEP, HIGHEST = 5, 100
VALUES = tuple(range(0, HIGHEST + 1, STEP))
UNSET = "–"
"""The first entry of a list of values; the initial position of a slider would suggest an answer."""
CONSENT_VERSION = "2026-11"
CONSENT = """\
**What happens.** You tell a simulated robot where parts go, with different ways of doing so, in short tasks against a
clock. After each way you rate its load on six scales. It takes about 40 minutes. You may stop at any time, without a
reason.

**What is recorded.** Your participant number, what you do on this page with its times, your ratings. No name, no
picture, no sound, no address. It stays in a folder on this computer; the person in charge can delete it on request, by
the number.

**What it is for.** To compare ways of telling a robot where parts go. You are not tested: the page is."""
PREFERENCE = "Which way would you rather use again?"


PERFORMANCE = "How successful were you in accomplishing what you were asked to do?"
EFFORT = "How hard did you have to work to accomplish your level of performance?"
FRUSTRATION = "How insecure, discouraged, irritated, stressed, and annoyed were you?"


@dataclass(frozen=True)
class Scale:
    """One scale of the questionnaire."""

    name: str
    title: str
    question: str
    low: str
    high: str


LOW_HIGH = "Very low", "Very high"
SCALES = (
    Scale("mental", "Mental demand", "How mentally demanding was the task?", *LOW_HIGH),
    Scale("physical", "Physical demand", "How physically demanding was the task?", *LOW_HIGH),
    Scale("temporal", "Temporal demand", "How hurried or rushed was the pace of the task?", *LOW_HIGH),
    Scale("performance", "Performance", PERFORMANCE, "Perfect", "Failure"),
    Scale("effort", "Effort", EFFORT, *LOW_HIGH),
    Scale("frustration", "Frustration", FRUSTRATION, *LOW_HIGH),
)
NAMES = tuple(scale.name for scale in SCALES)


def raw_load(ratings: Mapping[str, int]) -> float:
    """0 to 100: the mean of the six scales, unweighted."""
    return sum(ratings.values()) / len(NAMES)
