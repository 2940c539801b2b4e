"""The exact seating test: boolean intersections of a part's swept volume with the assembly.

The swept volume is what the part covers when it moves out along its insertion axis. A pose is collision-free, and can
be reached along that axis, exactly when its swept volume does not intersect the assembly. A part is seated when its
contact pose lies between two limits, so one boolean at a limit decides that limit. `kit1000.kits.seating` has the same
test as a bisection over one swept solid; here the swept volume stays the few overlapping solids it is built from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np
from manifold3d import Error, Manifold, Mesh64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from kit1000.kits.seating import BISECTION_STEP, HOVER, WALL_COSINE
from kit1000.mesh import Mesh
from kit1000.pose import Pose

VOLUME_TOLERANCE = 1e-5  # relative error of a swept solid's volume beyond which it counts as damaged
SMALLEST_COSINE = 1e-300  # in place of a cosine of 0, so that nothing is divided by 0


@dataclass(frozen=True, eq=False)
class SweptVolume:
    """The volume that a part sweeps when it leaves along its axis: the union of some solids, in the part's frame."""

    solids: tuple[Manifold, ...]
    axis: np.ndarray
    """(3,) unit, part frame: the direction out of the cavity."""

    @staticmethod
    def of(mesh: Mesh, axis: np.ndarray) -> SweptVolume:
        """Extrude every connected patch of backward-facing faces along the axis, over the whole path [m]."""
        axis = axis / np.linalg.norm(axis)
        along = mesh.vertices @ axis
        path = (HOVER + along.max() - along.min()) * axis
        backward = mesh.faces[mesh.normals @ axis < -WALL_COSINE]
        patches = _connected_patches(backward)
        return SweptVolume(tuple(chain.from_iterable(_swept_solids(mesh.vertices, p, path) for p in patches)), axis)

    def is_collision_free(self, assembly: Manifold, assembly_from_part: Pose, offset: float) -> bool:
        """Whether the swept volume of the part, moved by `offset` [m] along its axis, does not meet the assembly."""
        moved = Pose.from_translation(offset * assembly_from_part.rotate(self.axis)) @ assembly_from_part
        matrix = moved.matrix()[:3]
        return all((solid.transform(matrix) ^ assembly).is_empty() for solid in self.solids)


@dataclass(frozen=True)
class ContactInterval:
    """The contact offsets [m], low < offset <= high, with which a predicted pose passes the seating test.

    A contact offset is the signed distance from the predicted pose to contact, along the part's axis, outward positive.
    """

    low: float
    high: float

    @staticmethod
    def of(limit: float, depth: float, cosine: float, height: float) -> ContactInterval:
        """The interval of one pose, as in `kit1000.kits.seating.seating_result`; empty where low is above high.

        Args:
            limit: [m] SEATED or STRICT.
            depth: [m] of the cavity.
            cosine: of the angle between the part's axis at this pose and the slot's axis.
            height: [m] of the pose above the goal.
        """
        deep, far = min(limit, depth / 3) - BISECTION_STEP, limit - BISECTION_STEP
        ends = sorted([(-deep - height) / (cosine or SMALLEST_COSINE), (deep - height) / (cosine or SMALLEST_COSINE)])
        return ContactInterval(max(-far, ends[0]), min(far, ends[1]))

    def has_end_within(self, band: float, offset: float) -> bool:
        """Whether an end lies nearer than a band [m] to an offset [m]; in an infinite band every end does."""
        return self.low <= self.high and any(_is_near(offset, end, band) for end in (self.low, self.high))


def contact_in_interval(
    interval: ContactInterval, offset: float, band: float, is_collision_free: Callable[[float], bool]
) -> bool:
    """Whether the contact offset lies in an interval.

    Args:
        interval: of the pose.
        offset: [m] contact offset by the closed form; it decides at ends that are not within the band.
        band: [m] ends nearer than this to `offset` are decided by the exact test.
        is_collision_free: the exact test at an offset [m]: true from contact outward.
    """

    def at_most(end: float) -> bool:
        return is_collision_free(end) if _is_near(offset, end, band) else offset <= end

    return interval.low <= interval.high and at_most(interval.high) and not at_most(interval.low)


def _is_near(offset: float, end: float, band: float) -> bool:
    return bool(np.isinf(band) or abs(offset - end) < band)


def _connected_patches(faces: np.ndarray) -> list[np.ndarray]:
    """Faces (k, 3) split into patches that are connected by edges, (., 3) each."""
    forward, reverse = _directed_edges(faces)
    _, first, second = np.intersect1d(forward, reverse, return_indices=True)
    links = coo_array((np.ones(len(first), np.int8), (first // 3, second // 3)), shape=(len(faces),) * 2)
    labels = connected_components(links, directed=False)[1]
    return [faces[labels == label] for label in range(labels.max(initial=-1) + 1)]


def _directed_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3 k,) twice: one number for each edge of each face, from start to end and from end to start."""
    start, end = faces.astype(np.int64).ravel(), np.roll(faces.astype(np.int64), -1, axis=1).ravel()
    n = int(faces.max(initial=0)) + 1
    return start * n + end, end * n + start


def _swept_solids(vertices: np.ndarray, patch: np.ndarray, path: np.ndarray) -> Iterator[Manifold]:
    """The solids swept by a patch of faces (k, 3) that moves by `path` (3,) [m].

    One solid, as a rule. It may overlap itself, as under a thread; the intersection test is still right. Where
    manifold3d removes such an overlap, which the volume shows, the patch is halved, again and again.
    """
    solid, triangles = _swept_solid(vertices, patch, path), vertices[patch]
    volume = -float(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]).sum(0) @ path) / 2
    intact = solid.status() == Error.NoError and abs(solid.volume() - volume) <= VOLUME_TOLERANCE * volume
    if intact or len(patch) == 1:
        yield solid
        return
    centres = triangles.mean(1)
    order = np.argsort(centres[:, np.ptp(centres, axis=0).argmax()], kind="stable")
    for half in np.array_split(patch[order], 2):
        for piece in _connected_patches(half):
            yield from _swept_solids(vertices, piece, path)


def _swept_solid(vertices: np.ndarray, patch: np.ndarray, path: np.ndarray) -> Manifold:
    """The solid between a patch and its copy moved by `path`: both of them, and walls along the border."""
    used, corners = np.unique(patch, return_inverse=True)
    bottom, n = corners.reshape(-1, 3), len(used)
    forward, reverse = _directed_edges(bottom)
    border = np.stack([bottom, np.roll(bottom, -1, axis=1)], axis=2).reshape(-1, 2)[~np.isin(forward, reverse)]
    start, end = border.T
    walls = [np.stack([end, start, start + n], 1), np.stack([end, start + n, end + n], 1)]
    faces = np.concatenate([bottom, bottom[:, ::-1] + n, *walls])
    low = vertices[used]
    return Manifold(Mesh64(np.concatenate([low, low + path]), faces.astype(np.uint64)))
