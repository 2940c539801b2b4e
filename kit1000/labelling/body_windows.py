"""The bodies that a labelled depth image shows: for each a window of the image with its mask as a signed distance.

Everything is in the camera frame: the pose of the camera in the world plays no part in a registration. Images are
(h, w), rows first; lengths in m, distances in an image in px.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, find_objects, gaussian_filter, map_coordinates

from kit1000.camera import Camera
from kit1000.values import LabelledDepth

MARGIN = 24  # [px] of a window around its mask: fattened edges and first poses stay inside
SMOOTHING = 1.0  # [px] of a signed distance before its gradient is taken
OTHERS_REACH = 2  # [px] about another body, where an outline may be its own


@dataclass(frozen=True, eq=False)
class BodyWindow:
    """A body as an image shows it."""

    label: int
    """Its value in the masks."""
    camera: Camera
    """The camera of the window: its principal point is shifted, so its pixels are those of the image."""
    corner: tuple[int, int]
    """Row and column of the window's first pixel in the image."""
    depth: np.ndarray
    """(h, w) float64 [m] measured; 0 for no return."""
    mask: np.ndarray
    """(h, w) bool: the pixels of the body."""
    others: np.ndarray
    """(h, w) bool: the pixels of other bodies, and those next to them."""

    @cached_property
    def distance(self) -> np.ndarray:
        """(h, w) [px] signed distance to the border of the mask, negative inside."""
        outside, inside = (np.asarray(distance_transform_edt(mask)) for mask in (~self.mask, self.mask))
        return np.where(self.mask, 0.5 - inside, outside - 0.5)

    @cached_property
    def rays(self) -> np.ndarray:
        """(h, w, 3) the points of the pixels at a depth of 1."""
        return self.camera.unproject(np.ones_like(self.depth))

    @cached_property
    def points(self) -> np.ndarray:
        """(n, 3) [m] measured points of the mask."""
        kept = self.mask & (self.depth > 0)
        return self.rays[kept] * self.depth[kept][:, None]

    def distances_at(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance (n,) [px] and its gradient (n, 2) by u and v, at places (n, 2) of the window."""
        places = uv[:, ::-1].T
        value = map_coordinates(self.distance, places, order=1, mode="nearest")
        down, across = (map_coordinates(slope, places, order=1, mode="nearest") for slope in self._gradient)
        return value, np.stack([across, down], axis=-1)

    @cached_property
    def _gradient(self) -> tuple[np.ndarray, np.ndarray]:
        smooth = gaussian_filter(self.distance, SMOOTHING)
        return np.asarray(np.gradient(smooth, axis=0)), np.asarray(np.gradient(smooth, axis=1))


def body_windows(image: LabelledDepth) -> dict[int, BodyWindow]:
    """The bodies of an image by their label: `ASSEMBLY_LABEL` the kits, `FIRST_PART_LABEL` + i part i."""
    found = {}
    for label, box in enumerate(find_objects(image.labels), start=1):
        if box is not None:
            found[label] = _seen(image, label, box)
    return found


def _seen(image: LabelledDepth, label: int, box: tuple[slice, slice]) -> BodyWindow:
    (height, width), camera = image.labels.shape, image.view.camera
    top, left = max(box[0].start - MARGIN, 0), max(box[1].start - MARGIN, 0)
    window = np.s_[top : min(box[0].stop + MARGIN, height), left : min(box[1].stop + MARGIN, width)]
    labels = image.labels[window]
    others = binary_dilation((labels != label) & (labels > 0), iterations=OTHERS_REACH)
    mask = labels == label
    rows, columns = mask.shape
    shifted = Camera(columns, rows, camera.fx, camera.fy, camera.cx - left, camera.cy - top)
    return BodyWindow(label, shifted, (top, left), image.view.depth[window].astype(float), mask, others & ~mask)
