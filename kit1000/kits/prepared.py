"""A part and a kit prepared for contact: what many tests of one body need is computed once and passed on.

Each property is computed when it is first used. All lengths are metres.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from kit1000.kits.contact import contact_features
from kit1000.kits.face import MIN_PROBABILITY, RestingFace, resting_faces
from kit1000.kits.height_fields import HeightField, lower_envelope
from kit1000.kits.seating import SEATED_LIMIT
from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import matmul
from kit1000.values import Kit

CELL = 0.5e-3  # [m] of the kit's height field
FINE_CELL = 0.2e-3  # [m] of the field for the search just beyond the limits
UNDERSIDE_CELL = 1.0e-3  # [m] between the points that represent the underside of a part


class RestingPart(NamedTuple):
    """A part that rests on one of its faces, on the plane z = 0."""

    rotation: np.ndarray  # (3, 3) plane from part
    origin_height: float  # height of the part's frame above the plane [m]
    underside: np.ndarray  # points of its underside, (n, 3) [m]

    @staticmethod
    def on(mesh: Mesh, face: RestingFace) -> RestingPart:
        """The part on a face."""
        rotation = face.plane_from_part.rotation_matrix()
        points = underside_points(Mesh(matmul(mesh.vertices, rotation.T), mesh.faces))
        low = float(points[:, 2].min())
        return RestingPart(rotation, -low, points - [0, 0, low])


class PreparedPart:
    """A part with its resting faces."""

    def __init__(self, mesh: Mesh, min_probability: float = MIN_PROBABILITY) -> None:
        """min_probability: of the resting faces on which the part is tried."""
        self.mesh, self.min_probability = mesh, min_probability

    @cached_property
    def faces(self) -> list[RestingFace]:
        """The faces on which the part is tried, most probable first."""
        return resting_faces(self.mesh, self.min_probability)

    @cached_property
    def all_faces(self) -> list[RestingFace]:
        """All resting faces, however improbable."""
        return resting_faces(self.mesh, 0.0)

    @cached_property
    def resting(self) -> list[RestingPart]:
        """The part on each of these faces."""
        return [RestingPart.on(self.mesh, face) for face in self.faces]


class PreparedKit:
    """A kit with its contact features from above and its height fields."""

    def __init__(self, kit: Kit) -> None:
        self.slot, self.mesh, self.design = kit.slot, kit.mesh, kit.slot.goals[0]
        self.features = contact_features(kit.mesh, np.eye(3), np.zeros(3), 1.0)

    @cached_property
    def field(self) -> HeightField:
        """Its height field, the minimum over neighbouring cells, so that a search on a grid misses no fit."""
        return HeightField.of(self.mesh, CELL, self.slot.depth).minimum_filtered()

    @cached_property
    def fine_field(self) -> HeightField:
        """Its height field for the search just beyond the limits."""
        return HeightField.of(self.mesh, FINE_CELL, self.slot.depth)

    @property
    def height_limit(self) -> float:
        """Height above the goal up to which a part counts as seated [m]."""
        return min(SEATED_LIMIT, self.slot.depth / 3)


def underside_points(mesh: Mesh, more: np.ndarray | None = None) -> np.ndarray:
    """The lower envelope of a mesh on a grid, its vertices and `more` points (k, 3); farthest from the z axis first.

    Returns (n, 3) [m].
    """
    heights, corner = lower_envelope(mesh, UNDERSIDE_CELL)
    i, j = np.nonzero(np.isfinite(heights))
    grid = np.stack([corner[0] + i * UNDERSIDE_CELL, corner[1] + j * UNDERSIDE_CELL, heights[i, j]], 1)
    points = np.concatenate([grid, mesh.vertices, *([] if more is None else [more])])
    order = np.argsort(-np.hypot(points[:, 0], points[:, 1]), kind="stable")
    return np.ascontiguousarray(points[order])
