"""The exact judge of seating: booleans of what a part sweeps on its way out with all that stands there.

Seated means that contact comes neither too high nor too low, so one boolean at a limit decides on that limit: the part
can be there, and have come there along its axis, when what it sweeps outward meets nothing. `kit1000.kits.seating` has
the same judge as a bisection over one solid; here the swept solid stays in the few sheets that it is made of.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np
from manifold3d import Error, Manifold, Mesh64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from kit1000.kits.seating import HOVER, JUDGE_STEP, STEEP
from kit1000.mesh import Mesh
from kit1000.pose import Pose

SOUND = 1e-5  # share of its volume that a sheet may lose in the making
TINY = 1e-300  # in place of a cosine of 0


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a part sweeps when it leaves along its axis, as solids in the part's frame that together cover it."""

    solids: tuple[Manifold, ...]
    axis: np.ndarray
    """(3,) unit, part frame: the direction out of the cavity."""

    @staticmethod
    def of(mesh: Mesh, axis: np.ndarray) -> Sweep:
        """One sheet for every connected patch of faces that look back, as thick as the way is long."""
        axis = axis / np.linalg.norm(axis)
        along = mesh.vertices @ axis
        way = (HOVER + along.max() - along.min()) * axis
        backs = mesh.faces[mesh.normals @ axis < -STEEP]
        return Sweep(tuple(chain.from_iterable(_sheets(mesh.vertices, patch, way) for patch in _patches(backs))), axis)

    def clear(self, standing: Manifold, standing_from_part: Pose, rise: float) -> bool:
        """Whether the part, raised by `rise` [m] along its carried axis, and its way out are clear of what stands."""
        raised = Pose.from_translation(rise * standing_from_part.rotate(self.axis)) @ standing_from_part
        matrix = raised.matrix()[:3]
        return all((solid.transform(matrix) ^ standing).is_empty() for solid in self.solids)


@dataclass(frozen=True)
class Window:
    """The rises to contact with which a pose passes the seating test: from low to high [m]."""

    low: float
    high: float

    @staticmethod
    def of(limit: float, depth: float, lean: float, lift: float) -> Window:
        """The window of one pose, as `kit1000.kits.seating.verdict` has it; empty where low is above high.

        Args:
            limit: [m] SEATED or STRICT.
            depth: [m] of the cavity.
            lean: cosine between the carried axis and the slot's.
            lift: [m] of the pose above goal height.
        """
        deep, far = min(limit, depth / 3) - JUDGE_STEP, limit - JUDGE_STEP
        ends = sorted([(-deep - lift) / (lean or TINY), (deep - lift) / (lean or TINY)])
        return Window(max(-far, ends[0]), min(far, ends[1]))

    def near(self, rise: float, band: float) -> bool:
        """Whether a rise is nearer than a band [m] to one of the ends; an infinite band takes in every rise."""
        return self.low <= self.high and any(_near(rise, end, band) for end in (self.low, self.high))


def passes(window: Window, rise: float, band: float, clear: Callable[[float], bool]) -> bool:
    """Whether contact comes inside a window: ends nearer than a band [m] to the closed form's rise [m] are judged.

    clear: whether contact comes no higher than a rise [m].
    """

    def at_most(end: float) -> bool:
        return clear(end) if _near(rise, end, band) else rise <= end

    return window.low <= window.high and at_most(window.high) and not at_most(window.low)


def _near(rise: float, end: float, band: float) -> bool:
    return bool(np.isinf(band) or abs(rise - end) < band)


def _patches(faces: np.ndarray) -> list[np.ndarray]:
    """Faces (k, 3) as those that hang together by edges, (., 3) each."""
    there, back = _edges(faces)
    _, first, second = np.intersect1d(there, back, return_indices=True)
    links = coo_array((np.ones(len(first), np.int8), (first // 3, second // 3)), shape=(len(faces),) * 2)
    labels = connected_components(links, directed=False)[1]
    return [faces[labels == label] for label in range(labels.max(initial=-1) + 1)]


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3 k,) one number for each edge of each face as it runs there, and as it runs back."""
    start, end = faces.astype(np.int64).ravel(), np.roll(faces.astype(np.int64), -1, axis=1).ravel()
    n = int(faces.max(initial=0)) + 1
    return start * n + end, end * n + start


def _sheets(vertices: np.ndarray, patch: np.ndarray, way: np.ndarray) -> Iterator[Manifold]:
    """The solids between a patch of faces and itself moved by `way` (3,) [m].

    One, as a rule. It may lie over itself, as a thread does: whether it meets anything is still known. Where manifold3d
    cleans a fold of it away, which its volume shows, the patch is halved, again and again.
    """
    solid, triangles = _sheet(vertices, patch, way), vertices[patch]
    volume = -float(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]).sum(0) @ way) / 2
    sound = solid.status() == Error.NoError and abs(solid.volume() - volume) <= SOUND * volume
    if sound or len(patch) == 1:
        yield solid
        return
    middles = triangles.mean(1)
    order = np.argsort(middles[:, np.ptp(middles, axis=0).argmax()], kind="stable")
    for half in np.array_split(patch[order], 2):
        for piece in _patches(half):
            yield from _sheets(vertices, piece, way)


def _sheet(vertices: np.ndarray, patch: np.ndarray, way: np.ndarray) -> Manifold:
    used, corners = np.unique(patch, return_inverse=True)
    below, n = corners.reshape(-1, 3), len(used)
    there, back = _edges(below)
    border = np.stack([below, np.roll(below, -1, axis=1)], axis=2).reshape(-1, 2)[~np.isin(there, back)]
    start, end = border.T
    walls = [np.stack([end, start, start + n], 1), np.stack([end, start + n, end + n], 1)]
    faces = np.concatenate([below, below[:, ::-1] + n, *walls])
    low = vertices[used]
    return Manifold(Mesh64(np.concatenate([low, low + way]), faces.astype(np.uint64)))
