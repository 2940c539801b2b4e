"""Products of small matrices whose last bit is the same on every x86-64 processor.

BLAS picks a kernel for the processor it runs on, and kernels add in different orders; LAPACK and the norm of a single
vector call BLAS. Whatever reaches a file, or decides anything during generation, is therefore computed here, by loops
of numpy that are compiled once for all processors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

NEGLIGIBLE = 1e-18  # beside the largest entry: rotating it away changes no bit of the diagonal
SWEEPS = 12  # of the Jacobi method: it converges quadratically, and five are enough for any 3 x 3 matrix


def matmul(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """`a @ b` of (..., k) by (k,) or (k, n)."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    return np.einsum("...k,k->..." if b.ndim == 1 else "...k,kn->...n", a, b)


def length(vector: ArrayLike) -> float:
    """Euclidean norm of a vector (k,)."""
    return float(np.sqrt(matmul(vector, vector)))


def determinant(matrices: np.ndarray) -> np.ndarray:
    """(...,) determinants of (..., 3, 3) matrices, by the triple product of their rows."""
    a, b, c = np.moveaxis(matrices, -2, 0)
    return np.einsum("...i,...i->...", a, np.cross(b, c))


def eigenvectors(symmetric: np.ndarray) -> np.ndarray:
    """(n, n) unit eigenvectors of a symmetric matrix (n, n) as columns, by ascending eigenvalue.

    The cyclic Jacobi method (Golub and Van Loan, Matrix Computations, 8.5).
    """
    matrix, vectors = np.array(symmetric, float), np.eye(len(symmetric))
    for _ in range(SWEEPS):
        for p, q in zip(*np.triu_indices(len(matrix), 1), strict=True):
            if abs(matrix[p, q]) <= NEGLIGIBLE * abs(matrix).max():
                continue
            ratio = (matrix[q, q] - matrix[p, p]) / (2 * matrix[p, q])
            tangent = (1.0 if ratio >= 0 else -1.0) / (abs(ratio) + np.sqrt(ratio * ratio + 1))
            cosine = 1 / np.sqrt(tangent * tangent + 1)
            rotation = np.eye(len(matrix))
            rotation[[p, q], [p, q]] = cosine
            rotation[p, q], rotation[q, p] = tangent * cosine, -tangent * cosine
            matrix = matmul(rotation.T, matmul(matrix, rotation))
            matrix[p, q] = matrix[q, p] = 0.0
            vectors = matmul(vectors, rotation)
    return vectors[:, np.argsort(np.diag(matrix), kind="stable")]
