"""What one depth image shows of parts and kits, as meshes and as points: the observed surface, and a skirt below it.

A part is closed by a skirt from the border of its observed surface straight down to the table, as a solid column of
which only the top is known. Nothing else is assumed: what the camera did not see has a hole.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import find_objects, median_filter

from kit1000.mesh import Mesh
from kit1000.pictures.depth_images import surface_light
from kit1000.pictures.shading import KIT, part_colour
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

STEEPEST = 12.0  # longest edge of a triangle, in widths of a pixel: a longer one bridges a step in depth
STRIDE = 2  # pixels of a mesh's grid: a browser draws a quarter of the triangles
MEDIAN = 5  # [px] of the filter that a noisy image needs


class ColouredPoints(NamedTuple):
    """Points as a viewer draws them."""

    points: np.ndarray  # (n, 3) [m] world
    colours: np.ndarray  # (n, 3) uint8


@dataclass(frozen=True, eq=False)
class SeenScene:
    """The parts and the kits as one image shows them."""

    parts: dict[int, Mesh]
    """[m] world: the observed surface of each part with its skirt, at its recorded pose; by index."""
    kits: Mesh
    """[m] world."""
    others: Mesh
    """[m] world: the parts that too little is seen of."""


def seen_scene(image: LabelledDepth, editable: Collection[int], noisy: bool) -> SeenScene:
    """What an image shows. editable: indices of the parts that can be edited. noisy: whether it must be smoothed."""
    parts = {}
    for index in editable:
        mask = image.labels == FIRST_PART_LABEL + index
        surface = seen_surface(image.view, mask, noisy, STRIDE)
        if len(surface.faces):
            parts[index] = with_skirt(surface)
    kits = seen_surface(image.view, image.labels == ASSEMBLY_LABEL, noisy, STRIDE)
    known = [0, ASSEMBLY_LABEL, *(FIRST_PART_LABEL + index for index in editable)]
    others = seen_surface(image.view, ~np.isin(image.labels, known), noisy, STRIDE)
    return SeenScene(parts, kits, with_skirt(others))


def seen_surface(view: View, mask: np.ndarray, noisy: bool = False, stride: int = 1) -> Mesh:
    """The surface through the points of a mask (H, W) bool: two triangles between four neighbours, none across steps.

    [m] world. stride: [px] between neighbours.
    """
    found = find_objects(mask.astype(np.uint8))
    if not found:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    box = found[0]
    depth = np.where(mask[box], view.depth[box], 0)
    depth = _smoothed(depth)[::stride, ::stride] if noisy else depth[::stride, ::stride]
    v, u = (np.arange(side.start, side.stop, stride) for side in box)
    grid = np.stack(np.meshgrid(u, v), axis=-1)
    points = view.world_from_camera.apply(view.camera.unproject_pixels(grid, depth))
    faces = _faces(points, depth, stride / view.camera.fx)
    used = np.unique(faces)
    renumbered = np.zeros(depth.size, np.int32)
    renumbered[used] = np.arange(len(used))
    return Mesh(points.reshape(-1, 3)[used], renumbered[faces])


def with_skirt(surface: Mesh, floor: float = 0.0) -> Mesh:
    """A surface, a wall from its border straight down to a floor [m], and its shadow on the floor as the underside."""
    border = _border(surface.faces)
    n = len(surface.vertices)
    below = surface.vertices * (1, 1, 0) + (0, 0, floor)
    a, b = border.T
    walls = np.concatenate([np.stack([b, a, a + n], axis=-1), np.stack([b, a + n, b + n], axis=-1)])
    underside = surface.faces[:, ::-1] + n
    return Mesh(np.concatenate([surface.vertices, below]), np.concatenate([surface.faces, walls, underside]))


def observed(part: Mesh) -> np.ndarray:
    """(n, 3) [m] the observed points of a surface to which `with_skirt` has given a skirt."""
    return part.vertices[: len(part.vertices) // 2]


def coloured_points(image: LabelledDepth) -> dict[int, ColouredPoints]:
    """An image as points in soft light, one for STRIDE x STRIDE pixels, by label of the masks, without the table."""
    view, labels = image.view, image.labels
    kept = np.zeros(labels.shape, bool)
    kept[::STRIDE, ::STRIDE] = ((labels > 0) & (view.depth > 0))[::STRIDE, ::STRIDE]
    v, u = np.nonzero(kept)
    light, kinds = surface_light(view.camera, view.depth, kept), labels[v, u]
    points = view.world_from_camera.apply(view.camera.unproject_pixels(np.stack([u, v], axis=-1), view.depth[v, u]))
    clouds = {}
    for label in np.unique(kinds).tolist():
        bright = np.sqrt(np.clip(light[kinds == label], 0, 1))  # light is linear, a colour its square root
        colour = KIT if label == ASSEMBLY_LABEL else part_colour(label - FIRST_PART_LABEL)
        clouds[label] = ColouredPoints(points[kinds == label], (bright * colour).astype(np.uint8))
    return clouds


def _smoothed(depth: np.ndarray) -> np.ndarray:
    """Depths (h, w) [m] by the median of their neighbours if those are observed too."""
    smooth = median_filter(depth, MEDIAN)
    return np.where((depth > 0) & (smooth > 0), smooth, 0)


def _faces(points: np.ndarray, depth: np.ndarray, pixel: float) -> np.ndarray:
    """(m, 3) triangles between neighbours of a grid (h, w, 3) [m]; pixel: width of a cell at a depth of 1 m."""
    height, width = depth.shape
    index = np.arange(height * width, dtype=np.int32).reshape(height, width)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    corners, z = points.reshape(-1, 3)[faces], depth.reshape(-1)[faces]
    edges = np.square(corners - np.roll(corners, 1, axis=1)).sum(-1).max(-1)
    kept = (z > 0).all(-1) & (edges < np.square(STEEPEST * pixel * z.max(-1)))
    return faces[kept]


def _border(faces: np.ndarray) -> np.ndarray:
    """(k, 2) the edges that only one of the faces (m, 3) has, in its direction."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    most = int(edges.max(initial=0)) + 1
    there, back = edges[:, 0] * most + edges[:, 1], edges[:, 1] * most + edges[:, 0]
    return edges[~np.isin(there, back)].astype(np.int32)
