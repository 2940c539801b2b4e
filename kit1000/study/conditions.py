"""The conditions of a study: an interface, and whether a method snaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kit1000.editor.keys import Interface
from kit1000.errors import InputError, did_you_mean


@dataclass(frozen=True)
class Condition:
    """One way to say where parts go."""

    name: str
    label: str
    """For people who read a report."""
    short: str
    """The same for the margin of a plot."""
    interface: Interface
    """scene: parts are dragged; hand: two suction cups are, one part an upload; hand-bare: without aids."""
    snaps: bool

    @property
    def one_part_an_upload(self) -> bool:
        """Whether the robot carries out each part by itself, or all at once."""
        return self.interface != "scene"


CONDITIONS = {
    condition.name: condition
    for condition in (
        Condition("scene-snap", "Scene editing, snapping", "Scene + snap", "scene", True),
        Condition("scene", "Scene editing, by hand", "Scene", "scene", False),
        Condition("hand-snap", "Hand control, snapping", "Hand + snap", "hand", True),
        Condition("hand", "Hand control", "Hand", "hand", False),
        Condition("hand-bare", "Hand control of the paper", "Bare hand", "hand-bare", False),
    )
}
DEFAULT = ("scene-snap", "hand")
"""The comparison of the paper, with the same aids for both hands."""
CROSSED = ("scene-snap", "scene", "hand-snap", "hand")
"""Interface crossed with snapping: which of the two helps?"""
COUNTS = (2, 4)  # an odd number would need twice as many orders to balance what comes before what


def conditions_of(names: Sequence[str]) -> tuple[Condition, ...]:
    """The conditions of these names; two or four different ones."""
    for name in names:
        if name not in CONDITIONS:
            hint = did_you_mean(name, CONDITIONS)
            raise InputError(f"--conditions {name}: {hint}there are {', '.join(CONDITIONS)}")
    if len(names) not in COUNTS or len({*names}) < len(names):
        raise InputError(f"--conditions: expected two or four different ones, got {' '.join(names) or 'none'}")
    return tuple(CONDITIONS[name] for name in names)
