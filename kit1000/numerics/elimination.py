"""Gaussian elimination of small systems without LAPACK: its last bits do not depend on the processor."""

from __future__ import annotations

from kit1000.numerics.compiled import compiled


@compiled
def solve_positive(matrix, right):
    """(n,) solution for a positive definite matrix (n, n), by Gaussian elimination, which then needs no pivoting."""
    n = len(right)
    a, x = matrix.copy(), right.copy()
    for k in range(n):
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            for j in range(k, n):
                a[i, j] -= factor * a[k, j]
            x[i] -= factor * x[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            x[k] -= a[k, j] * x[j]
        x[k] /= a[k, k]
    return x
