"""What the page says, as functions of values; numbers in millimetres, degrees and percent."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np

from kit1000.editor.keys import Interface
from kit1000.editor.proposals import PartProposals, Proposal
from kit1000.editor.session import LIKELY, SURE, PartEdit, part_name

if TYPE_CHECKING:
    from kit1000.known_shapes.predictor import FoundShape, FoundShapes

Colour = tuple[int, int, int]
KIT_COLOUR: Colour = (205, 201, 194)
OTHER_COLOUR: Colour = (170, 172, 176)
TABLE_COLOUR: Colour = (236, 238, 240)
GHOST_OPACITY = 0.45
SURE_COLOUR: Colour = (34, 150, 76)
LIKELY_COLOUR: Colour = (232, 160, 24)
UNSURE_COLOUR: Colour = (120, 124, 130)
MARKS = {"free": "○", "snapped": "◆", "unsure": "◇", "confirmed": "✔"}
MEANINGS = {"free": "free", "snapped": "snapped", "unsure": "snapped, not sure", "confirmed": "confirmed"}
LONGEST = 300  # characters of a message from elsewhere

CUPS_BEGIN = "Press a part's number, or drag the green cup onto a part."
BEGIN: Mapping[Interface, str] = {
    "scene": "Drag a part onto its cavity, or press its number.",
    "hand": CUPS_BEGIN,
    "hand-bare": "Click the green cup and put it on a part.",
}
TAKE = "**Space** takes it."
CONFIRM: Mapping[Interface, str] = {
    "scene": "**Enter** confirms it.",
    "hand": "**Enter** carries it.",
    "hand-bare": "**Enter** carries it.",
}
ALL_DONE = "**All parts are confirmed, and everything is saved.** You may close the page, or change what you like."
PICK_FIRST = "**Yellow cup**: it carries nothing. First put the green cup on a part."
NOTHING_PICKED = "**Green cup**: it touches no part."
SNAPPED_ALREADY = "It stands at a fit already; move it to see others."
GO_ON = "Now another part."
WAITING = "*Asking the method about this place …*"
ON_TABLE = "It is on the table: drag it onto its cavity."
NOT_OVER_PLATE = "Now move the yellow cup over the cavity of the part."
CHOOSE: Mapping[Interface, str] = {
    "scene": "Choose a part first: drag it, click it, or press its number.",
    "hand": CUPS_BEGIN,
    "hand-bare": "Click a cup first.",
}
HELD = "The robot is at work: nothing can be moved until it has finished."
NOTHING_TO_SNAP_YET = "No likely fit yet: the method is still looking for fits."
NOTHING_TO_SNAP = "No further part has a likely fit that no other part takes."
NOTHING_TO_CARRY = "Nothing to carry: the green cup must touch a part, and the yellow cup be over a plate."
NOTHING_TO_CONFIRM: Mapping[Interface, str] = {
    "scene": "Nothing to confirm: drag a part onto a plate first.",
    "hand": NOTHING_TO_CARRY,
    "hand-bare": NOTHING_TO_CARRY,
}


def no_part(part: int) -> str:
    """A number that is no part's, or that of one which cannot be edited."""
    return f"There is no {part_name(part)} to move: too little of it was seen, or the scene has fewer parts."


def confidence_colour(confidence: float) -> Colour:
    """Green from SURE, amber from LIKELY, grey below."""
    if confidence >= SURE:
        return SURE_COLOUR
    return LIKELY_COLOUR if confidence >= LIKELY else UNSURE_COLOUR


def confidence_text(confidence: float) -> str:
    """A number and a word, so that colour alone carries no information."""
    word = "sure" if confidence >= SURE else "likely" if confidence >= LIKELY else "not sure"
    return f"{100 * confidence:.0f} % {word}"


def part_label(part: int, edit: PartEdit, selected: bool, unsure: bool = False) -> str:
    """The label over a part. unsure: its known shape is not at a pose that the image settles."""
    return f"{'▸ ' if selected else ''}{part + 1}{' ?' if unsure else ''} {MARKS[edit.state]}"


def cup_label(picks: bool, selected: bool) -> str:
    """The label over a cup."""
    return ("▸ " if selected else "") + ("pick" if picks else "place")


def picked(part: int) -> str:
    """The picking cup in the hand, on a part."""
    return f"**Green cup**: on {part_name(part)}. Now move the yellow cup."


def parts_list(
    edits: Mapping[int, PartEdit],
    selected: int | None,
    sought: Collection[int],
    known: FoundShapes | None = None,
    missing: str = "",
) -> str:
    """The state of each part, in Markdown.

    sought: the parts for which the method still looks for fits. known: the shapes that were found. missing: what is
    said of others.
    """
    rows = [f"? {plain(missing)}"] if missing else []
    rows += [shape_text(known.kits).removeprefix(" · ")] if known is not None and known.kits.doubts else []
    for part, edit in edits.items():
        name = f"**{part_name(part)}**" if part == selected else part_name(part)
        sure = f", {100 * edit.confidence:.0f} %" if edit.snapped else ""
        seeks = " · looking for fits …" if part in sought else ""
        shape = "" if known is None else shape_text(known.parts.get(part))
        rows.append(f"{MARKS[edit.state]} {name}: {MEANINGS[edit.state]}{sure}{seeks}{shape}")
    return "  \n".join(rows)  # two spaces end a line in Markdown; a table would change its columns with every word


def not_found(names: Collection[str]) -> str:
    """Which known shapes were not found; empty if there are none."""
    return f"Not found in the image: {', '.join(names)}." if names else ""


def shape_text(found: FoundShape | None) -> str:
    """What is known of the shape of a body, behind its name."""
    if found is None:
        return " · ? no known shape was found here: shown as seen"
    unsure = f" ? not sure: {plain('; '.join(found.doubts))}" if found.doubts else ""
    return f" · {plain(found.name)}{unsure}"


def part_line(part: int, edit: PartEdit) -> str:
    """The part in the hand and its state."""
    taken = f", at a fit that is {confidence_text(edit.confidence)}" if edit.snapped else ""
    return f"**{part_name(part).capitalize()}**: {MEANINGS[edit.state]}{taken}"


def ghost_line(ghost: Proposal, index: int, count: int, shift: tuple[float, float]) -> str:
    """The fit that is shown, the `index`-th of `count`. shift: [m], [rad] from the hand to it."""
    moved = f"{shift[0] * 1e3:.0f} mm and {np.degrees(shift[1]):.0f}° from the hand"
    return f"Ghost {index + 1} of {count}: **{confidence_text(ghost.confidence)}**, {moved}. {TAKE}"


def no_fit(proposals: PartProposals, over_kits: bool, waits: bool) -> str:
    """Why no ghost is shown."""
    if proposals.failure:
        return f"No fit: {plain(proposals.failure)}"
    if not over_kits:
        return "No fit: the part is not over a plate."
    if waits or proposals.found is None:
        return "No fit yet: the method is still at work."
    return "No fit within 28 mm: move the part nearer to its cavity, turn it, or tip it over."


def no_shapes(failure: str) -> str:
    """Why known shapes are not shown."""
    return f"Only what the image shows is shown: {failure}"


def plain(text: str) -> str:
    """A text without what Markdown or HTML would read."""
    return "".join(character for character in text if character not in "<>`*_[]|#\\")[:LONGEST]
