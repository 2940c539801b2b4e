"""Kits from one depth image: solid below the observed surface, along the normal of the plate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kit1000.perception.image_kinds import Noise
from kit1000.perception.observed.filled_columns import ObservedColumns
from kit1000.perception.observed.fusion import MaskedView
from kit1000.perception.observed.pixels import cropped, oriented_points, subpixel_points
from kit1000.perception.observed.plates import Plane, find_planes, plane_frame
from kit1000.perception.observed.relief import CompletedRelief, SeenRelief, seen_relief
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, View
from kit1000.voxels import Volume

HALF_WIDTH = 0.045  # [m] from the middle of a volume to its sides: no part of 50 mm is wider
HALF_HEIGHT = 0.03  # [m] to its top and bottom: no cavity is deeper, and nothing higher touches a part
Completer = Callable[[SeenRelief], CompletedRelief]
"""Completes what no pixel shows of a plate."""
UPRIGHT = Plane(np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0)


@dataclass(frozen=True, eq=False)
class ObservedKits:
    """The kits in a depth image, which may be cropped."""

    image: LabelledDepth
    noise: Noise
    name: str
    """Name of the image and of the stream of its random draws."""
    half_width: float = HALF_WIDTH
    """[m] from the middle of a volume to its sides."""
    completer: Completer | None = None
    """The network that completes what no pixel shows; None leaves it free where no point of a column was observed."""

    @property
    def view(self) -> View:
        """The depth image."""
        return self.image.view

    @cached_property
    def mask(self) -> np.ndarray:
        """(H, W) bool: the pixels of the kits."""
        return self.image.labels == ASSEMBLY_LABEL

    @cached_property
    def plates(self) -> list[Plane]:
        """The planes of all observed plates, the largest first."""
        points, normals, area = oriented_points(self.view, self.mask, self.noise.window)
        return find_planes(points, normals, area, self.noise, stream(0, "plates", self.name))

    def volume(self, middle: np.ndarray, voxel: float) -> Volume:
        """Signed distances to the kits around a point: solid below what was observed, along the nearest plate's normal.

        A cavity is what its part sweeps along that normal, so its walls run along it. Where no point of its floor was
        observed it has no floor, unless the network completes it.

        Args:
            middle: (3,) [m] world.
            voxel: [m] edge.

        Returns:
            A volume about the middle, its z axis the normal, of `half_width` and HALF_HEIGHT; no voxel is unknown.
        """
        columns, relief = self.columns(middle, voxel), self.relief(middle)
        return columns.filled(largest_only=False, more=None if relief is None else relief.filled(columns.fine))

    def relief(self, middle: np.ndarray) -> CompletedRelief | None:
        """The relief of the plate nearest to a point (3,) [m] of the world, about its foot; None without network."""
        plate = self._nearest(middle)
        if self.completer is None or plate is None:
            return None
        return self.completer(seen_relief(self._cropped_about(middle), plate, middle, self.noise))

    def columns(self, middle: np.ndarray, voxel: float) -> ObservedColumns:
        """What the image shows around a point, for `volume`."""
        nearest = self._nearest(middle) or UPRIGHT
        along = Pose(plane_frame(nearest, middle).wxyz, middle)
        near = self._cropped_about(middle)
        mask = near.labels == ASSEMBLY_LABEL
        points, half_sizes = subpixel_points(near.view, mask), (self.half_width, HALF_HEIGHT)
        return ObservedColumns.of([MaskedView(near.view, mask)], points, along, half_sizes, -HALF_HEIGHT, voxel)

    def _nearest(self, middle: np.ndarray) -> Plane | None:
        """The plate nearest to a point (3,) [m]."""
        return min(self.plates, key=lambda plate: float(np.linalg.norm(plate.point - middle)), default=None)

    def _cropped_about(self, middle: np.ndarray) -> LabelledDepth:
        """The image, cropped to what shows the volume around a point."""
        camera, (height, width) = self.view.camera, self.view.depth.shape
        point = self.view.world_from_camera.inverse().apply(middle)
        u, v = np.rint(camera.project(point)).astype(int)
        radius = np.hypot(np.sqrt(2) * self.half_width, HALF_HEIGHT)
        reach = int(np.ceil(radius * camera.fx / max(point[2] - self.half_width, self.half_width)))
        rows, columns = (
            slice(*np.clip((i - reach, i + reach), (0, 1), (n - 1, n)).tolist()) for i, n in ((v, height), (u, width))
        )
        return cropped(self.image, (rows, columns))
