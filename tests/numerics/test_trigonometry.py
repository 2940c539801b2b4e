"""Sine, cosine and tangent against those of the C library, with exact values and symmetries."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kit1000.numerics.trigonometry import LARGEST_ANGLE, cosine, sine, tangent
from tests.samples.checkout import ROOT

GENERATING = ROOT / "kit1000"
SEARCHING = {
    "insertion_search.py",
    "face.py",
    "loose_fits.py",
}  # their angles are rounded, or only decide far from a limit
ANGLES = st.floats(-LARGEST_ANGLE, LARGEST_ANGLE)


@given(st.floats(-math.pi, math.pi))
def test_sine_and_cosine_are_within_a_unit_in_the_last_place(angle: float) -> None:
    assert abs(sine(angle) - math.sin(angle)) <= math.ulp(math.sin(angle))
    assert abs(cosine(angle) - math.cos(angle)) <= math.ulp(math.cos(angle))


@given(ANGLES)
@example(19141.9765625)  # one in a thousand of large angles is two units off
def test_beyond_half_a_turn_within_two(angle: float) -> None:
    assert abs(sine(angle) - math.sin(angle)) <= 2 * math.ulp(math.sin(angle))
    assert abs(cosine(angle) - math.cos(angle)) <= 2 * math.ulp(math.cos(angle))


@pytest.mark.parametrize("angle", [k * math.pi / 12 for k in range(-48, 49)])
def test_at_multiples_of_15_degrees_too(angle: float) -> None:
    for ours, libm in ((sine, math.sin), (cosine, math.cos)):
        assert ours(angle) == pytest.approx(libm(angle), rel=3e-16, abs=1e-300)
    assert tangent(angle) == pytest.approx(math.tan(angle), rel=1e-15, abs=1e-300)


@given(ANGLES)
def test_sine_is_odd_and_cosine_even(angle: float) -> None:
    assert (sine(-angle), cosine(-angle)) == (-sine(angle), cosine(angle))


def test_zero_and_small_angles_are_exact() -> None:
    assert (sine(0.0), cosine(0.0), tangent(0.0)) == (0.0, 1.0, 0.0)
    tiny = np.logspace(-300, -9, 50)
    assert np.array_equal(sine(tiny), tiny)


def test_an_array_gives_an_array_of_the_same_numbers() -> None:
    angles = np.linspace(-7, 7, 30).reshape(5, 2, 3)
    for function in (sine, cosine, tangent):
        assert function(angles).shape == angles.shape
        assert [function(float(a)) for a in angles.ravel()] == function(angles).ravel().tolist()


def test_generation_calls_no_other_sine() -> None:
    folders = ("parts", "kits", "generation")
    files = [path for folder in folders for path in (GENERATING / folder).rglob("*.py") if path.name not in SEARCHING]
    files += [GENERATING / f"{name}.py" for name in ("mesh", "pose", "symmetry", "camera")]
    files += [GENERATING / "queries" / f"{name}.py" for name in ("motions", "guesses")]
    files += [GENERATING / "sim" / f"{name}.py" for name in ("cameras", "crowding", "layout", "settle", "world")]
    for path in files:
        assert not re.search(r"\b(np|math)\.(sin|cos|tan)\(", path.read_text(encoding="utf-8")), path.name
