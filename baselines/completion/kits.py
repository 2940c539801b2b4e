"""Kits as one depth image shows them: solid under what was seen, along the normal of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from baselines.completion.columns import extruded
from baselines.completion.pixels import Noise, oriented_points, spread_points, window
from baselines.completion.planes import Plane, find_planes, frame_on
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, View
from kit1000.voxels import Volume

REACH = 0.045  # [m] from the middle of a volume to every side: a part of 50 mm reaches no farther
HIGH = 0.03  # [m] and up and down: no cavity is deeper, and what stands higher meets no part
UPRIGHT = Plane(np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0)


@dataclass(frozen=True, eq=False)
class SeenKits:
    """The kits in an image that may be a window of a larger one."""

    look: LabelledDepth
    noise: Noise
    name: str
    """Of the image: what is drawn at random about it is drawn from its own stream."""

    @property
    def view(self) -> View:
        """The image."""
        return self.look.view

    @cached_property
    def mask(self) -> np.ndarray:
        """(H, W) bool: the pixels of the kits."""
        return self.look.labels == ASSEMBLY_LABEL

    @cached_property
    def plates(self) -> list[Plane]:
        """The planes of all plates that are seen, the largest first."""
        points, normals, area = oriented_points(self.view, self.mask, self.noise.smooth)
        return find_planes(points, normals, area, self.noise.near, self.noise.flat, stream(0, "plates", self.name))

    def volume(self, middle: np.ndarray, voxel: float) -> Volume:
        """Signed distances to what was seen about a place, with all under it along the normal of the nearest plate.

        A cavity is what its part sweeps along that normal, so its walls are as steep as the columns. Where nothing was
        seen of its floor it has none.

        Args:
            middle: (3,) [m] world.
            voxel: [m] edge.

        Returns:
            A volume about the middle along the plate, REACH to every side, HIGH up and down; nowhere unknown.
        """
        nearest = min(self.plates, key=lambda plate: float(np.linalg.norm(plate.point - middle)), default=UPRIGHT)
        along = Pose(frame_on(nearest, middle).wxyz, middle)
        near = self._about(middle)
        mask = near.labels == ASSEMBLY_LABEL
        return extruded(near.view, mask, spread_points(near.view, mask), along, (REACH, HIGH), -HIGH, voxel)

    def _about(self, middle: np.ndarray) -> LabelledDepth:
        """The part of the image that shows what is REACH about a place, and the corners of that."""
        camera, (height, width) = self.view.camera, self.view.depth.shape
        place = self.view.world_from_camera.inverse().apply(middle)
        u, v = np.rint(camera.project(place)).astype(int)
        reach = int(np.ceil(np.hypot(np.sqrt(2) * REACH, HIGH) * camera.fx / max(place[2] - REACH, REACH)))
        rows, columns = (
            slice(*np.clip((i - reach, i + reach), (0, 1), (n - 1, n)).tolist()) for i, n in ((v, height), (u, width))
        )
        return window(self.look, (rows, columns))
