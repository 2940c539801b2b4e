"""Registration from four cameras: the query's image and those of three cameras around the table.

Only the image of the primary camera has labels. In the others, a pixel that shows a point above the table is of the
kits on their half of the table; on the other half it is of the part whose pixels in the primary image are nearest, seen
from above.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.ndimage import distance_transform_edt

from baselines.heights.scene_heights import CELL, KITS, LOWEST, RECENT, cell_below, part_labels, three_views
from kit1000.numerics.compiled import compiled
from kit1000.perception.sensor_facts import sensor_of
from kit1000.prediction.catalog import Method
from kit1000.registration.predictor import Registration
from kit1000.registration.prepared_image import PreparedImage
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, Query, TrueGeometry, View

REACH = 30e-3  # [m] level, from the pixels that the primary camera sees of a part to its others: it sees half or more

METHODS = {
    "registration-three": Method(
        "baselines.registration_three:FourCameras",
        "registration from four depth images: the query's and those of three cameras around the table",
        label="Registration, four cameras",
        tracks=("snap", "snap-tilt", "place", "place-paper"),
        camera_set="three",
    ),
}


@dataclass(frozen=True, eq=False)
class FourCameras(Registration):
    """Registration that reads further images beside the query's own."""

    @cached_property
    def views(self) -> Callable[[str], list[View]]:
        """Returns the images of the three cameras of a scene; raises InputError if it was recorded without them."""
        return lru_cache(RECENT)(lambda scene_id: three_views(self.dataset.recorded_scene(scene_id, truth=False)))

    def others(self, query: Query) -> tuple[LabelledDepth, ...]:
        """The labelled images of the three cameras of the query's scene."""
        labels = table_labels(query.image)
        return tuple(labelled(view, labels) for view in self.views(query.scene_id))

    def scene(self, query: Query, geometry: TrueGeometry | None = None) -> PreparedImage:
        """The query's image, with those of the three cameras."""
        sensor = sensor_of(self.dataset.summary, query.sensor, query.scene_id)
        return PreparedImage(query, sensor, others=self.others(query))


def table_labels(image: LabelledDepth) -> np.ndarray:
    """(nx, ny) uint8: the label of what stands on each cell of the table, by the image of the primary camera."""
    labels = part_labels(image)
    away, nearest = distance_transform_edt(labels == 0, return_indices=True)  # type: ignore[misc]
    spread = np.where(away * CELL <= REACH, labels[tuple(nearest)], 0).astype(np.uint8)
    spread[:, KITS:] = ASSEMBLY_LABEL
    return spread


def labelled(view: View, table: np.ndarray) -> LabelledDepth:
    """An image with the labels (nx, ny) of the cells of the table below its points; 0 on the table and beside it."""
    camera, pose = view.camera, view.world_from_camera
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    labels = np.zeros(view.depth.shape, np.uint8)
    _label(view.depth, intrinsics, pose.rotation_matrix(), pose.xyz, table, labels)
    return LabelledDepth(view, labels)


@compiled
def _label(depth, intrinsics, rotation, shift, table, labels):
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if depth[v, u] > 0:
                i, j, height = cell_below(u, v, depth[v, u], intrinsics, rotation, shift)
                if height > LOWEST and 0 <= i < table.shape[0] and 0 <= j < table.shape[1]:
                    labels[v, u] = table[i, j]
