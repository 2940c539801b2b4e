"""The robustness curves of the README: what each method leaves of a guess's error, from the scores of the submissions.

    python docs/pictures/curves.py

Position on the left, rotation on the right, each at the middle one of three errors of the other kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmark.curve_charts import compared
from benchmark.curves import CURVES, Table
from kit1000.files import read_json
from kit1000.pictures.charts import standalone

OUT = Path(__file__).with_suffix(".svg")
SUBMISSIONS = Path(__file__).parents[2] / "submissions"


def main() -> None:
    """Draw the picture."""
    OUT.write_text(picture(scored_curves(SUBMISSIONS)), encoding="utf-8")


def scored_curves(submissions: Path) -> dict[str, Table]:
    """The curves of all submissions on unknown shapes that have them, the largest error left last."""
    scores = [read_json(path) for path in sorted(submissions.glob("*/scores.json"))]
    unknown = [each for each in scores if each["manifest"].get("reads") != "shapes"]
    curves = {each["method"]: each["curves"] for each in unknown if each["curves"]}
    return dict(sorted(curves.items(), key=lambda item: item[1]["position"][-1]["mean"]))


def picture(curves: dict[str, Table]) -> str:
    """An SVG file of two charts."""
    return standalone([[_middle(compared(curve, curves)) for curve in CURVES]])


def _middle(charts: Sequence[str]) -> str:
    return charts[len(charts) // 2]


if __name__ == "__main__":
    main()
