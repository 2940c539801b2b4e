"""Sums, products, sines and cosines that are the same on every processor, against numpy and exact numbers."""

from __future__ import annotations

import ast
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kit1000.numerics.linear_algebra import determinant, eigenvectors, length, matmul
from kit1000.numerics.trigonometry import LARGEST_ANGLE, cosine, sine, tangent
from tests.samples.checkout import ROOT

GENERATING = ("parts", "kits", "sim", "generation", "voxels")  # and the base modules, which have one file each
SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS, st.integers(1, 6), st.integers(1, 6), st.integers(1, 6))
def test_matmul_is_the_product_of_numpy(seed: int, m: int, k: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(m, k)), rng.normal(size=(k, n))
    for left, right in ((a, b), (a, b[:, 0]), (a[0], b), (a[0], b[:, 0])):
        np.testing.assert_allclose(matmul(left, right), left @ right, rtol=1e-12, atol=1e-12)
    assert length(a[0]) == pytest.approx(np.linalg.norm(a[0]), rel=1e-14)


@given(SEEDS)
def test_determinants_are_those_of_numpy(seed: int) -> None:
    matrices = np.random.default_rng(seed).normal(size=(5, 3, 3))
    np.testing.assert_allclose(determinant(matrices), np.linalg.det(matrices), rtol=1e-10, atol=1e-12)


@given(SEEDS, st.integers(1, 5), st.sampled_from([1e-12, 1.0, 1e9]))
def test_eigenvectors_diagonalise(seed: int, n: int, scale: float) -> None:
    half = np.random.default_rng(seed).normal(size=(n, n)) * scale
    symmetric = half + half.T
    vectors = eigenvectors(symmetric)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(n), atol=1e-13)
    diagonal = vectors.T @ symmetric @ vectors
    np.testing.assert_allclose(diagonal, np.diag(np.linalg.eigvalsh(symmetric)), atol=1e-12 * scale)


@pytest.mark.parametrize("symmetric", [np.eye(3), np.zeros((3, 3)), np.diag([3.0, 1.0, 2.0])])
def test_eigenvectors_of_a_diagonal_matrix_are_axes(symmetric: np.ndarray) -> None:
    vectors = eigenvectors(symmetric)
    assert set(np.unique(vectors)) == {0.0, 1.0}
    values = np.diag(vectors.T @ symmetric @ vectors).tolist()
    assert values == sorted(values)


def _calls_of_blas(path: Path) -> list[str]:
    """Calls of functions of numpy that run in BLAS or LAPACK; a norm along an axis does not."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            name = ast.unparse(node.func)
            along = any(keyword.arg == "axis" for keyword in node.keywords)
            if name in ("np.dot", "np.matmul", "np.inner", "np.vdot", "np.tensordot") or (
                re.fullmatch(r"np\.linalg\.\w+", name) and not along
            ):
                found.append(f"{path.name}:{node.lineno}: {name}")
    return found


def generating_files() -> list[Path]:
    """The modules whose numbers reach a dataset."""
    files = [path for folder in GENERATING for path in (ROOT / "kit1000" / folder).rglob("*.py")]
    files += [ROOT / "kit1000" / f"{name}.py" for name in ("mesh", "pose", "symmetry", "camera")]
    return files + [ROOT / "kit1000/queries" / f"{name}.py" for name in ("motions", "guesses", "pivots")]


def test_generation_calls_no_blas() -> None:
    notes = {"sources.py"}  # in a message, rounded to four digits
    assert not [call for path in generating_files() if path.name not in notes for call in _calls_of_blas(path)]


WITH_OTHER_SINES = {"loose_fits.py", "stereo.py"}  # their angles are rounded, or only decide far from a limit
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
    for path in generating_files():
        if path.name in WITH_OTHER_SINES:
            continue
        assert not re.search(r"\b(np|math)\.(sin|cos|tan)\(", path.read_text(encoding="utf-8")), path.name
