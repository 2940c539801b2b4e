"""The keys and buttons of the page as tables, and the help that is made of them.

W A S D Q E and the arrows are left out: they fly viser's camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Literal, NamedTuple

Interface = Literal["scene", "hand", "hand-bare"]
"""What the hand moves: parts, or two suction cups with the page's help or without."""
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
    Key("deselect", "escape", None, "choose no part"),
    *(Key(f"select-{i}", str(i), None, "") for i in range(1, MOST_PARTS + 1)),
)
BUTTONS: Mapping[str, Mapping[str, str]] = {
    "Fit": {"Take": "take", "Next": "next", "Snap all": "take-all"},
    "Part": {"Confirm": "confirm", "Confirm all": "confirm-all"},
    "History": {"Undo": "undo", "Redo": "redo", "Put all back": "reset-all"},
    "Look": {"Camera": "view-camera", "Top": "view-top", "Plate": "view-slot"},
}
SNAPPING = {"take", "next", "take-all"}
BARE = {"confirm", "undo", "redo", "reset-all", "view-top", "view-slot", "view-camera", "deselect"}
"""What is left of them in bare hand control."""

HAND_HELP = {
    "confirm": "carry the part from the green cup to the yellow one",
    "reset": "put the cup back",
    "view-slot": "look into the plate under the cup",
    "deselect": "choose no cup",
}


@cache
def keys_of(interface: Interface, snaps: bool = True) -> tuple[Key, ...]:
    """The keys of an interface, with their help. snaps: whether a method proposes fits."""
    keys = tuple(key for key in KEYS if _has(interface, snaps, key.verb))
    if interface == "scene":
        return keys
    return tuple(key._replace(help=HAND_HELP.get(key.verb, key.help)) for key in keys)


@cache
def buttons_of(interface: Interface, snaps: bool = True) -> dict[str, dict[str, str]]:
    """The verbs of the buttons of an interface by their text, in named groups."""
    groups = {
        name: {text: verb for text, verb in verbs.items() if _has(interface, snaps, verb)}
        for name, verbs in BUTTONS.items()
    }
    return {name: verbs for name, verbs in groups.items() if verbs}


@cache
def verbs_of(interface: Interface, snaps: bool = True) -> frozenset[str]:
    """What can be commanded."""
    buttons = (verb for verbs in buttons_of(interface, snaps).values() for verb in verbs.values())
    return frozenset((*(key.verb for key in keys_of(interface, snaps)), *buttons))


def _has(interface: Interface, snaps: bool, verb: str) -> bool:
    if interface == "hand-bare":
        return verb in BARE
    if interface == "hand":
        return verb not in SNAPPING | {"confirm-all"}
    return snaps or verb not in SNAPPING


NAMES = {"space": "Space", "enter": "Enter", "escape": "Esc"}
LOOK = ("drag elsewhere", "look around; wheel: nearer")
DRAGS: Mapping[Interface, tuple[tuple[str, str], ...]] = {
    "scene": (
        ("drag a part", "slide it over table and plates"),
        ("Ctrl + drag", "turn it"),
        ("Shift + drag", "raise or lower it"),
        ("Alt + drag", "tilt it"),
        LOOK,
        ("**1 … 9**", "choose a part"),
    ),
    "hand": (
        ("drag a cup", "slide it over parts (green), plates (yellow)"),
        ("Ctrl + drag", "turn it"),
        ("Shift + drag", "raise or lower it"),
        ("Alt + drag", "tilt it"),
        LOOK,
        ("**1 … 9**", "put the green cup on a part"),
    ),
    "hand-bare": (("click a cup", "choose it"), ("drag its arrows", "move it"), ("drag its arcs", "turn it"), LOOK),
}

DRAG_PART = "Drag a part onto its cavity, roughly."
GHOST = (
    "A ghost shows where it fits, and how sure that is: green is sure, amber likely, grey not sure. **Space** takes "
    "it, **C** shows another. No ghost? Turn the part with **Z** and **X**, or tip it over with **Y**."
)
EXACTLY = "Put it exactly: **Z** and **X** turn it, **Y** and **U** tip it over, **R** and **F** raise and lower it."
CONFIRM = "**Enter** confirms. Everything is saved at once; **Ctrl+Z** undoes."
CUPS = "You move the robot's suction cup, not the parts: green is where it picks a part, yellow where it lets it go."
PICK = "Press a part's number, or drag the green cup onto a part."
CARRIED = "The part keeps its place at the cup: as the fins of the two cups differ, so the part turns."
PLACE = f"Drag the yellow cup onto the part's cavity. {CARRIED} **Z** and **X** turn the cup."
PICK_BARE = "Click the green cup and put its tip onto the top of a part, by the arrows."
PLACE_BARE = f"Click the yellow cup; put it so that the part, hanging from it, is in its cavity. {CARRIED}"
CARRY = "**Enter** carries the part. Then comes the next one. **Ctrl+Z** undoes."


def help_text(interface: Interface, snaps: bool = True) -> str:
    """The help on the page, in Markdown. snaps: whether a method proposes fits."""
    steps = [f"**{number}.** {step}" for number, step in enumerate(_steps(interface, snaps), start=1)]
    if interface != "scene":
        steps.insert(0, CUPS)
    rows = [f"| {what} | {does} |" for what, does in DRAGS[interface]]
    rows += [f"| **{shown(key)}** | {key.help} |" for key in keys_of(interface, snaps) if key.help]
    return "\n\n".join(steps) + "\n\n| | |\n| --- | --- |\n" + "\n".join(rows)


def shown(key: Key) -> str:
    """A key as it is printed: Ctrl+Z."""
    name = NAMES.get(key.key, key.key)
    return {"shift": "Shift+", "cmd/ctrl": "Ctrl+", None: ""}[key.modifier] + name


def _steps(interface: Interface, snaps: bool) -> tuple[str, ...]:
    if interface == "scene":
        return DRAG_PART, GHOST if snaps else EXACTLY, CONFIRM
    if interface == "hand":
        return PICK, PLACE, CARRY
    return PICK_BARE, PLACE_BARE, CARRY
