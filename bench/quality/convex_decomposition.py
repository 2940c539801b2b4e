"""Convex decomposition of parts, for physics engines that collide the convex hull of every mesh.

coacd (Wei et al. 2022) cuts a part where its hull adds too much volume; what a piece adds lies in concavities of the
part. It takes seconds to minutes a part, so pieces are cached: `cache_key` hashes their inputs, `pack_pieces` makes
bytes of them. Its draws are seeded, but its versions differ: the pieces on disk are the record.
"""

from __future__ import annotations

import hashlib
import io
import zipfile

import numpy as np

from kit1000.errors import InputError
from kit1000.mesh import Mesh, mesh_from_solid, solid_from_mesh

SIMPLIFY_TOLERANCE = 0.2e-3  # [m] of the simplification before the decomposition: dense CAD is many times faster
CONCAVITY = 0.05  # threshold of coacd: concavity of a piece, as a fraction of half the part's longest side
# Fewer samples and a shallower search than coacd's defaults: a third of the time, and equally tight pieces.
COACD_OPTIONS = {
    "threshold": CONCAVITY,
    "preprocess_mode": "off",
    "resolution": 1000,
    "mcts_iterations": 60,
    "mcts_nodes": 10,
    "seed": 0,
}
MILLIMETRE = 1e-3  # [m] the unit of coordinates given to coacd


def convex_pieces(mesh: Mesh) -> list[np.ndarray]:
    """The vertices of each convex piece of a closed mesh, (n, 3) [m] in its frame.

    The union of the pieces is the mesh, but for a few tenths of a millimetre and parts of its concavities.
    """
    import coacd

    coacd.set_log_level("error")
    simplified = mesh_from_solid(solid_from_mesh(mesh).simplify(SIMPLIFY_TOLERANCE))
    pieces = coacd.run_coacd(coacd.Mesh(simplified.vertices / MILLIMETRE, np.array(simplified.faces)), **COACD_OPTIONS)
    if not pieces:
        raise InputError("pieces: coacd finds none: is the mesh closed?")
    return [np.asarray(vertices, dtype=np.float64) * MILLIMETRE for vertices, _ in pieces]


def cache_key(mesh: Mesh) -> str:
    """The cache key of a mesh's pieces: a hash of the mesh and of the settings of the decomposition."""
    digest = hashlib.sha256(repr((SIMPLIFY_TOLERANCE, sorted(COACD_OPTIONS.items()))).encode())
    digest.update(mesh.vertices.tobytes())
    digest.update(mesh.faces.tobytes())
    return digest.hexdigest()[:32]


def pack_pieces(pieces: list[np.ndarray]) -> bytes:
    """The bytes of an .npz file with the pieces; the same pieces give the same bytes."""
    file = io.BytesIO()
    np.savez(file, corners=np.concatenate(pieces), counts=np.array([len(piece) for piece in pieces]))
    return file.getvalue()


def unpack_pieces(data: bytes) -> list[np.ndarray] | None:
    """The pieces in the bytes of an .npz file; None when it is damaged."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            corners, counts = arrays["corners"], arrays["counts"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return np.split(corners, np.cumsum(counts)[:-1])
