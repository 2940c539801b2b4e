"""Previews of recorded scenes: a small colour picture of what a method may see, and one with the goals of the target.

The picture has a pixel for each 2 x 2 pixels of the depth image, and the same bytes on every processor.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import distance_transform_edt

from kit1000.dataset.scene_data import PREVIEW_STEP, Observation, SceneTruth
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.pictures.depth_images import colours_of, mask_light
from kit1000.pictures.shading import Colour, part_colour
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import FIRST_PART_LABEL, View

TABLE: Colour = (80, 86, 98)
NOTHING: Colour = (36, 38, 44)  # where the camera sees no surface
MARK: Colour = (255, 255, 255)  # around the parts of drawn queries
MARK_INNER, MARK_OUTER = 2.5, 5.5  # [px of the depth image] from a part to both borders of its outline
GOAL_LINE = 3.5  # [px of the depth image] width of the outline of a goal
GHOST = 40  # percent: opacity of the target at its goals
MARGIN = 8  # [px of the depth image] around what is drawn over a picture


def with_previews(observation: Observation, truth: SceneTruth, mesh: Mesh) -> tuple[Observation, SceneTruth]:
    """An observation and its truth with their previews; `mesh` is that of the target, whose id the assembly has."""
    seen = replace(observation, preview=(picture := scene_picture(observation)))
    if truth.goals is None:
        return seen, truth
    target = [row["part_id"] for row in truth.parts].index(truth.assembly_id)
    return seen, replace(truth, preview=with_goals(picture, _primary_view(observation), mesh, truth.goals, target))


def scene_picture(observation: Observation) -> np.ndarray:
    """Kits and parts in colour by the masks, lit by the depth image, parts of drawn queries in a white outline.

    Nothing else of the observation is used. (H // 2, W // 2, 3) uint8 sRGB. Raises InputError without masks.
    """
    view, labels = _primary_view(observation), observation.labels
    if labels is None:
        raise InputError(f"{observation.scene_id}: a preview needs masks")
    height, width = (size // PREVIEW_STEP for size in labels.shape)
    valid = view.depth[::PREVIEW_STEP, ::PREVIEW_STEP][:height, :width] > 0
    picture = np.where(valid[..., None], np.array(TABLE), np.array(NOTHING)).astype(np.uint8)
    (top, bottom), (left, right) = window = _window_of(labels > 0)
    light = _cell_means(mask_light(view, labels, TABLE, (slice(top, bottom), slice(left, right))))
    cells = tuple(slice(first // PREVIEW_STEP, last // PREVIEW_STEP) for first, last in window)
    picture[cells] = colours_of(light, valid[cells], NOTHING)
    for part in sorted({row["part"] for row in observation.queries if row["drawn"]}):
        (top, bottom), (left, right) = _window_of(labels == FIRST_PART_LABEL + part)
        away = _distance(labels[top:bottom, left:right] == FIRST_PART_LABEL + part)
        ring = (away > MARK_INNER) & (away <= MARK_OUTER)
        _blend(picture[top // PREVIEW_STEP :, left // PREVIEW_STEP :], ring, MARK, 100)
    return picture


def with_goals(picture: np.ndarray, view: View, mesh: Mesh, world_from_parts: Pose, part: int) -> np.ndarray:
    """A scene's picture with a part, by its index and mesh, at all its goals (n,): faint, with an outline.

    `view` is that of the picture. (H, W, 3) uint8 sRGB.
    """
    goals = picture.copy()
    camera_from_parts = [view.world_from_camera.inverse() @ pose for pose in world_from_parts]
    corners = np.concatenate([pose.apply(mesh.vertices) for pose in camera_from_parts])
    size = (view.camera.width, view.camera.height)
    left, top, camera = view.camera.window(corners, (0, 0), size, MARGIN, PREVIEW_STEP)
    inside, outlines = np.zeros((2, camera.height, camera.width), bool)
    for world_from_part in world_from_parts:
        shown = render(camera, view.world_from_camera, [(mesh, world_from_part)], threads=1).body_ids > 0
        inside |= shown
        outlines |= ~shown & (_distance(shown) <= GOAL_LINE)
    area = goals[top // PREVIEW_STEP :, left // PREVIEW_STEP :]
    _blend(area, inside & ~outlines, part_colour(part), GHOST)
    _blend(area, outlines, part_colour(part), 100)
    return goals


def _primary_view(observation: Observation) -> View:
    """The ideal view, or the first of a preset without it."""
    views = observation.views
    return views["ideal"] if "ideal" in views else views[min(views)]


def _window_of(mask: np.ndarray) -> list[tuple[int, int]]:
    """First and last + 1 of the rows and columns [px] that contain a mask (H, W) with a margin; empty for none."""
    window = []
    for axis, size in enumerate(mask.shape):
        found = np.flatnonzero(mask.any(1 - axis))
        first, last = (max(int(found[0]) - MARGIN, 0), int(found[-1]) + 1 + MARGIN) if len(found) else (0, 0)
        window.append((first // PREVIEW_STEP * PREVIEW_STEP, min(last, size) // PREVIEW_STEP * PREVIEW_STEP))
    return window


def _distance(mask: np.ndarray) -> np.ndarray:
    """(H, W) [px] from each pixel to a mask; infinite without one."""
    return np.asarray(distance_transform_edt(~mask)) if mask.any() else np.full(mask.shape, np.inf)


def _cell_means(image: np.ndarray) -> np.ndarray:
    """(h, w, 3) means over the PREVIEW_STEP x PREVIEW_STEP pixels of an image, in a fixed order."""
    corners = (image[v::PREVIEW_STEP, u::PREVIEW_STEP] for v in range(PREVIEW_STEP) for u in range(PREVIEW_STEP))
    return sum(corners) / PREVIEW_STEP**2  # type: ignore[return-value]


def _blend(picture: np.ndarray, mask: np.ndarray, colour: Colour, percent: int) -> None:
    """Mix a colour into a picture (H, W, 3) where a mask of the depth image is; both begin at the same corner."""
    height, width = (
        min(size // PREVIEW_STEP, limit) for size, limit in zip(mask.shape, picture.shape[:2], strict=False)
    )
    cells = mask[: PREVIEW_STEP * height, : PREVIEW_STEP * width].reshape(height, PREVIEW_STEP, width, PREVIEW_STEP)
    share, whole = percent * cells.sum((1, 3))[..., None], 100 * PREVIEW_STEP**2
    mixed = picture[:height, :width].astype(np.int64) * (whole - share) + np.array(colour) * share
    picture[:height, :width] = (mixed + whole // 2) // whole
