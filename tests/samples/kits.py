"""Parts and their kits for tests: made once a test run, from families whose kits take a tenth of a second or less."""

from __future__ import annotations

from functools import cache

import numpy as np

from kit1000.kits.kit import make_kit
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.values import Kit, Part

QUICK = ("bracket", "cover", "channel", "tee", "foot")


@cache
def sample_part(family: str) -> Part:
    """A part of 45 mm, named after its family."""
    return make_part(family, family, FAMILIES[family].draw(np.random.default_rng(0)), longest=0.045)


@cache
def sample_kit(family: str) -> Kit:
    """The kit of `sample_part`."""
    return make_kit(sample_part(family))
