"""The keys of the page: one table, from which keys are bound and the help on the page is written.

W A S D Q E and the arrows are left out: they fly viser's camera.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

Modifier = Literal["shift", "cmd/ctrl"] | None


class Key(NamedTuple):
    """A key, what it does, and the verb that the controller knows it by."""

    verb: str
    key: str
    modifier: Modifier
    help: str


TURN_DEG, FINE_TURN_DEG = 5, 1
STEP_MM = 1
MOST_PARTS = 9

KEYS = (
    Key("take", "space", None, "take the fit that is shown"),
    Key("next", "C", None, "show the next fit"),
    Key("take-all", "space", "shift", "snap all parts that are likely"),
    Key("confirm", "enter", None, "confirm the part"),
    Key("confirm-all", "enter", "shift", "confirm all snapped parts"),
    Key("undo", "Z", "cmd/ctrl", "undo"),
    Key("redo", "Y", "cmd/ctrl", "redo"),
    Key("turn-left", "Z", None, f"turn by {TURN_DEG}° to the left (with shift by {FINE_TURN_DEG}°)"),
    Key("turn-right", "X", None, f"turn by {TURN_DEG}° to the right (with shift by {FINE_TURN_DEG}°)"),
    Key("turn-left-fine", "Z", "shift", ""),
    Key("turn-right-fine", "X", "shift", ""),
    Key("tip-away", "Y", None, "tip over by 90°, away from you"),
    Key("tip-aside", "U", None, "tip over by 90°, to the side"),
    Key("level", "V", None, "stand level on the plate"),
    Key("raise", "R", None, f"raise by {STEP_MM} mm"),
    Key("lower", "F", None, f"lower by {STEP_MM} mm"),
    Key("gizmo", "G", None, "show or hide the gizmo"),
    Key("reset", "N", None, "put the part back where it lies"),
    Key("view-top", "T", None, "look from the top"),
    Key("view-slot", "B", None, "look into the plate under the part"),
    Key("view-camera", "O", None, "look as the camera did"),
    Key("hide-kits", "H", None, "hide or show the kits"),
    Key("deselect", "escape", None, "choose no part"),
    *(Key(f"select-{i}", str(i), None, "") for i in range(1, MOST_PARTS + 1)),
)

NAMES = {"space": "Space", "enter": "Enter", "escape": "Esc"}
DRAGS = (
    ("drag a part", "slide it over table and plates"),
    ("Ctrl + drag", "turn it"),
    ("Shift + drag", "raise or lower it"),
    ("Alt + drag", "tilt it"),
    ("drag elsewhere", "look around; wheel: nearer"),
)
STEPS = (
    "**1.** Drag a part onto its cavity, roughly.",
    "**2.** A ghost shows where it fits, and how sure that is: green is sure, amber likely, grey not sure. "
    "**Space** takes it, **C** shows another. No ghost? Turn the part with **Z** and **X**, or tip it over with **Y**.",
    "**3.** **Enter** confirms. Everything is saved at once; **Ctrl+Z** undoes.",
)


def help_text() -> str:
    """The help on the page, in Markdown."""
    rows = [f"| {what} | {does} |" for what, does in DRAGS]
    rows += [f"| **{shown(key)}** | {key.help} |" for key in KEYS if key.help]
    rows.append("| **1 … 9** | choose a part |")
    return "\n\n".join(STEPS) + "\n\n| | |\n| --- | --- |\n" + "\n".join(rows)


def shown(key: Key) -> str:
    """A key as it is printed: Ctrl+Z."""
    name = NAMES.get(key.key, key.key)
    return {"shift": "Shift+", "cmd/ctrl": "Ctrl+", None: ""}[key.modifier] + name
