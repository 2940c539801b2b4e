"""Parts as convex pieces, for physics engines that take the hull of every mesh.

coacd (Wei et al. 2022) cuts a part where its hull fills too much; what a piece adds lies in the part's own hollows. It
takes seconds to minutes a part, so pieces are kept: `key_of` names them by what they depend on, `packed` makes them
bytes. Its draws are seeded, yet its releases differ: the pieces on disk are the record.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from typing import Any

import numpy as np

from kit1000.errors import InputError
from kit1000.mesh import Mesh, mesh_from_solid, solid_from_mesh

SIMPLIFY = 0.2e-3  # [m] the surface may move so far before it is cut: dense CAD is many times faster
CONCAVITY = 0.05  # of coacd: how far a piece may be from convex, as a share of half the part's longest side
# Fewer samples and a shallower search than coacd's own: a third of the time, and pieces as tight.
CUTTING = {
    "threshold": CONCAVITY,
    "preprocess_mode": "off",
    "resolution": 1000,
    "mcts_iterations": 60,
    "mcts_nodes": 10,
    "seed": 0,
}
UNIT = 1e-3  # [m] coacd is given millimetres


def convex_pieces(mesh: Mesh) -> list[np.ndarray]:
    """The corners of each convex piece of a closed mesh: (n, 3) [m] in its frame. Together they are it, but for a
    few tenths of a millimetre and what they fill of its hollows.
    """
    coacd = _coacd()
    plain = mesh_from_solid(solid_from_mesh(mesh).simplify(SIMPLIFY))
    cut = coacd.run_coacd(coacd.Mesh(plain.vertices / UNIT, np.array(plain.faces)), **CUTTING)
    if not cut:
        raise InputError("pieces: coacd finds none: is the mesh closed?")
    return [np.asarray(vertices, dtype=np.float64) * UNIT for vertices, _ in cut]


def key_of(mesh: Mesh) -> str:
    """The name of a mesh's pieces: a hash of its numbers and of how it is cut."""
    digest = hashlib.sha256(repr((SIMPLIFY, sorted(CUTTING.items()))).encode())
    digest.update(mesh.vertices.tobytes())
    digest.update(mesh.faces.tobytes())
    return digest.hexdigest()[:32]


def packed(pieces: list[np.ndarray]) -> bytes:
    """Pieces as the bytes of an .npz file; the same pieces give the same bytes."""
    file = io.BytesIO()
    np.savez(file, corners=np.concatenate(pieces), counts=np.array([len(piece) for piece in pieces]))
    return file.getvalue()


def unpacked(data: bytes) -> list[np.ndarray] | None:
    """The pieces in such bytes; None when they are damaged."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            corners, counts = arrays["corners"], arrays["counts"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return np.split(corners, np.cumsum(counts)[:-1])


def _coacd() -> Any:
    try:
        import coacd
    except ImportError:
        raise InputError("pieces: needs coacd: pip install 'kit1000[sim]'") from None
    coacd.set_log_level("error")
    return coacd
