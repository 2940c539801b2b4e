"""The picture of what a camera seats: a line for each condition of results/camera-conditions.json, the best first.

python docs/pictures/cameras.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kit1000.files import read_json
from kit1000.pictures.charts import Axis, Dot, dot_plot, standalone

OUT = Path(__file__).with_suffix(".svg")
RESULTS = Path(__file__).parents[2] / "results/camera-conditions.json"
NAMES = 156  # [px] the width of names
CLEARANCE = 2.5  # [mm] of the dataset: another one is named


def main() -> None:
    """Draw the picture."""
    OUT.write_text(picture(read_json(RESULTS)["tables"]["seated"]["rows"]), encoding="utf-8")


def picture(rows: list[dict[str, Any]]) -> str:
    """An SVG file of the rows of the table."""
    dots = sorted(map(_dot, rows), key=lambda dot: -(dot.value or 0.0))
    title = "Parts seated, masks given, by frames, distance, places, clearance"
    description = "Share of parts seated under conditions of the camera, with intervals of 95 %."
    return standalone([[dot_plot(title, description, dots, Axis("parts seated, %", 100.0), NAMES)]])


def _dot(row: dict[str, Any]) -> Dot:
    name = row["condition"].replace(", 1 frame", "").replace(" frames", "×").replace(",", "")
    other = "" if row["clearance"] == CLEARANCE else f" {row['clearance']:g} mm"
    share, (low, high) = row["seated"]["rate"], row["seated"]["ci95"]
    name = (name + other).removeprefix("d415 ")
    return Dot(name, 100 * share, 100 * low, 100 * high, f"n = {row['n']}")


if __name__ == "__main__":
    main()
