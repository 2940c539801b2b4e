"""Products without BLAS against those of numpy, and that generation uses no others."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.numerics.linear_algebra import determinant, eigenvectors, length, matmul
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


def test_generation_calls_no_blas() -> None:
    files = [path for folder in GENERATING for path in (ROOT / "kit1000" / folder).rglob("*.py")]
    files += [ROOT / "kit1000" / f"{name}.py" for name in ("mesh", "pose", "symmetry", "camera")]
    files += [ROOT / "kit1000/queries" / f"{name}.py" for name in ("motions", "guesses", "pivots")]
    notes = {"sources.py"}  # in a message, rounded to four digits
    assert not [call for path in files if path.name not in notes for call in _calls_of_blas(path)]
