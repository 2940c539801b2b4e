"""The help on the page, by interface."""

from __future__ import annotations

from collections.abc import Mapping

from kit1000.editor.keys import Interface, Key, keys_of

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
    "hand-bare": (
        ("click a cup", "choose it"),
        ("drag its arrows", "move it"),
        ("drag its arcs", "turn it"),
        LOOK,
    ),
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
CUP_GHOST = (
    "A ghost of the cup shows where the part would fit: green is sure, amber likely, grey not sure. **Space** takes "
    "it, **C** shows another."
)
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
        return PICK, PLACE, *([CUP_GHOST] if snaps else []), CARRY
    return PICK_BARE, PLACE_BARE, CARRY
