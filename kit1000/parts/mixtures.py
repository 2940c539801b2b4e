"""Mixtures of part families: which families a dataset draws its parts from, and how often each."""

from __future__ import annotations

from collections.abc import Mapping

from kit1000.rng import stream

# The weights make the mixture as holed, filled and slender as real machine parts (docs/results/data.md). A mixture is
# frozen once a dataset was drawn from it: its plan and every redraw depend on the names and the weights. So it stands
# apart from the catalog, where families are added freely; a mixture that draws a new family has a new name.
MIXTURES: dict[str, dict[str, float]] = {
    "2026": {
        "block": 4.5,
        "bracket": 1.0,
        "bushing": 1.5,
        "cam": 0.8,
        "channel": 1.0,
        "clevis": 0.7,
        "clip": 1.0,
        "connector": 1.0,
        "cover": 0.5,
        "crank": 1.0,
        "dovetail": 0.8,
        "elbow": 1.0,
        "flange": 1.5,
        "foot": 0.5,
        "frame": 3.5,
        "frame_corner": 0.8,
        "gear": 1.0,
        "grille": 1.5,
        "heat_sink": 2.0,
        "hinge": 1.0,
        "hook": 1.5,
        "housing": 0.5,
        "knob": 1.0,
        "lever": 2.5,
        "link": 3.0,
        "motor_mount": 1.5,
        "mounting_plate": 1.5,
        "pillow_block": 0.6,
        "pulley": 2.5,
        "ratchet": 0.7,
        "servo_horn": 0.6,
        "stepped_shaft": 1.5,
        "tee": 1.0,
        "wedge": 2.5,
        "yoke": 0.6,
    }
}
"""Name of a mixture -> family name -> its weight relative to the others."""


def choose_family(root: int, *key: int | str, weights: Mapping[str, float]) -> str:
    """The family of the part that `key` names, drawn from the root seed in proportion to the weights.

    A race: each family gets an exponential finishing time of its own stream, divided by its weight, and the first wins.
    So a mixture with one more family changes only the parts that this family wins (Efraimidis and Spirakis 2006).
    """
    finish = {name: stream(root, *key, "family", name).exponential() / weight for name, weight in weights.items()}
    return min(finish, key=finish.__getitem__)
