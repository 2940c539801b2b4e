"""The part of a query: bounds of its shape as an image shows it, or its true shape, where it lies now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import map_coordinates

from kit1000.perception.observed.parts import AROUND, HALF_WIDTH, ObservedPart, PartBounds
from kit1000.perception.observed.pixels import pixel_points
from kit1000.pose import Pose
from kit1000.values import LabelledDepth, TrueGeometry
from kit1000.voxels import Grid, Volume, signed_distance, surface_points
from kit1000.voxels.grid import DEFAULT_TRUNCATION

if TYPE_CHECKING:
    from kit1000.perception.completion.parts import CompletedPart, PartCompleter

VOXEL = 1e-3  # [m] of the part's volumes
SEEN_POINTS = 1500  # points of the part's surface that are read
SLIMMER, WIDER = 1.0, -1.5  # logits above which the part is solid, for cavities of a slimmer and of a wider part


@dataclass(frozen=True, eq=False)
class PartShape:
    """What registration knows about the shape of a part, as the part lies now."""

    bounds: PartBounds
    points: np.ndarray
    """(n, 3) [m] world: on its seen surface."""
    middle: np.ndarray
    """(3,) [m] world: about its middle."""
    half_width: float
    """[m] from the middle to the sides, at least HALF_WIDTH."""
    height: float | None = None
    """[m] of the part as it lies, if that is known better than by its volume."""
    completed: CompletedPart | None = None
    """The part as a network completed it; None: no network did."""

    @cached_property
    def surface(self) -> np.ndarray:
        """(n, 3) [m] world: points on the surface of the filled part."""
        points = surface_points(self.bounds.filled)
        return points[:: max(1, len(points) // SEEN_POINTS)]

    def gap(self, one: Pose, other: Pose) -> float:
        """[m] mean distance between the surfaces of the filled part after two motions; 0 for a symmetry of the part."""
        filled = self.bounds.filled
        places = filled.grid.indices((one.inverse() @ other).apply(self.surface))
        distances = map_coordinates(filled.values, places.T, order=1, mode="nearest")
        return float(np.abs(distances).mean()) * DEFAULT_TRUNCATION * filled.grid.voxel_size if len(places) else 0.0

    def solid_above(self, logit: float) -> Volume:
        """The part where a network finds it likelier than a logit; the filled part if no network completed it."""
        return self.bounds.filled if self.completed is None else self.completed.solid_above(logit, VOXEL)


def seen_part(
    observed: ObservedPart,
    measured: LabelledDepth,
    completer: PartCompleter | None,
    restores: bool,
    filled_only: bool = False,
) -> PartShape:
    """The part as images show it.

    Args:
        observed: the part in the restored image.
        measured: the calibrated image before restoration.
        completer: the network that completes the part; None fills columns.
        restores: whether the sensor bends edges; the network then reads the measured image.
        filled_only: whether the filled part is taken for the true one.
    """
    completed = None
    if completer is not None:
        from kit1000.perception.completion.parts import CompletedPart

        completed = CompletedPart(observed, completer, measured if restores else None)
    images: Sequence[LabelledDepth] = (observed.image, *observed.others)
    points = np.concatenate([pixel_points(image.view, image.labels == observed.label) for image in images])
    points = points[:: max(1, len(points) // SEEN_POINTS)]
    bounds = observed.bounds(VOXEL) if completed is None else completed.bounds(VOXEL)
    known_height = completed is not None and not restores and len(points)  # its highest point is seen
    return PartShape(
        PartBounds(*[bounds.filled] * 3) if filled_only else bounds,
        points,
        observed.middle,
        observed.half_width,
        float(points[:, 2].max()) if known_height else None,
        completed,
    )


def true_part(geometry: TrueGeometry) -> PartShape:
    """The part as it is; its middle is that of its extents, as the pivot of a noisy image may be centimetres off."""
    corners = geometry.world_from_part.apply(geometry.part.vertices)
    middle = (corners.min(0) + corners.max(0)) / 2
    half_width = max(HALF_WIDTH, float(np.sqrt(np.square(corners - middle).sum(-1).max())) + AROUND)
    side = 2 * round(half_width / VOXEL)
    grid = Grid.centred(Pose.from_translation(middle), (side, side, side), VOXEL)
    solid = signed_distance(grid, [(geometry.part, geometry.world_from_part)], threads=1)
    points = surface_points(solid)
    points = points[:: max(1, len(points) // SEEN_POINTS)]
    return PartShape(PartBounds(solid, solid, solid), points, middle, half_width)
