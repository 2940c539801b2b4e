"""How likely a fit is seated: a decreasing curve of its doubt, less a share of its lead over fits in other poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

DECIMALS = 9  # the last digits of an exponential depend on the processor


class Curve(NamedTuple):
    """A logistic curve, fitted to predictions of which it is known whether they are seated."""

    half: float
    """[m] the doubt at which half of the predictions are seated."""
    spread: float
    """[m]"""
    lead_share: float = 0.0
    """Share of the lead of a fit that is taken off its doubt: another pose may fit as well."""


CURVES = {
    ("depth", "ideal"): Curve(3.5e-3, 0.7e-3, 0.5),
    ("depth", "photoneo"): Curve(3.5e-3, 0.7e-3, 0.5),
    ("depth", "d415"): Curve(10.2e-3, 6.5e-3, 0.5),
    ("depth", "restored"): Curve(1.5e-3, 1.05e-3, 0.125),
    ("columns", "ideal"): Curve(6.0e-3, 1.4e-3),
    ("columns", "photoneo"): Curve(6.0e-3, 1.4e-3),
    ("columns", "d415"): Curve(-6.8e-3, 7.1e-3),
    ("truth", "ideal"): Curve(5.5e-3, 0.4e-3),
    ("truth", "photoneo"): Curve(5.5e-3, 0.4e-3),
    ("truth", "d415"): Curve(5.5e-3, 0.4e-3),
}
"""Curves by source and kind of image. Those of depth are fitted to 210 snaps of parts that are turned over (train) and
100 places (val) on ideal images, whose curve a scanner has too, to 73 snaps and 47 places (val) on the d415 of data
1.0.0, both with completed parts, and to 376 snaps (train) on images of the d415 that a network restored: 206 of one
frame, 100 of 30 frames, and 70 from 0.6 m. The others are fitted to the split val."""


def confidence(doubt: float, lead: float, source: str, kind: str) -> float:
    """The share of fits with such a doubt and lead [m] that are seated, for a source and kind of image of CURVES."""
    curve = CURVES[source, kind]
    doubt -= curve.lead_share * lead
    return round(float(1 / (1 + np.exp((doubt - curve.half) / curve.spread))), DECIMALS)
