"""Contact sheets of a dataset: its parts, kits, assemblies and scenes as pictures for visual inspection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from kit1000.camera import Camera
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.own_scenes import is_own
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.pictures.depth_images import depth_picture, mask_picture
from kit1000.pictures.previews import assembly_tile, contact_sheet_png, kit_tile, part_tile
from kit1000.pictures.shading import KIT, ColouredBody, part_colour, shaded_picture
from kit1000.pose import Pose
from kit1000.values import View

SCENE_TILE = (960, 540)  # [px] of one picture of a scene
BORDER = 1.12  # size of the window around all bodies, relative to their extents
ONE_OF = {"parts": "part", "kits": "kit", "assemblies": "assembly"}  # loaders of geometry
GUESS_TRACKS = ("snap-tilt", "snap")  # the guesses of the first that has queries about the scene are shown


def geometry_sheet(geometry: Geometry, what: str, split: str, count: int, ids: Sequence[str] = ()) -> bytes:
    """A PNG of parts, kits or assemblies: of the given ids, or of `count` ids evenly spaced over a split."""
    rows = getattr(geometry, what)
    chosen = list(ids) or _evenly_chosen(sorted(i for i, row in rows.items() if row["split"] == split), count)
    if not chosen:
        raise InputError(f"{geometry.root}: no {what} in split {split!r}")
    for item_id in chosen:
        if item_id not in rows:
            getattr(geometry, ONE_OF[what])(item_id)  # raises, with what there is, before anything is drawn
    return contact_sheet_png(
        [_tile(geometry, what, item_id) for item_id in chosen], [_label(geometry, what, i) for i in chosen]
    )


def scene_sheet(dataset: Dataset, scene_id: str) -> bytes:
    """A PNG of one scene, cropped to its bodies: up to two depth images and the masks; if the split was opened with
    ground truth, also the scene, the parts of queries at their goals, and at their initial guesses.
    """
    recorded = dataset.recorded_scene(scene_id)
    window = window_of_bodies(recorded.labels)
    first, *others = recorded.sensors
    seen = "depth" if is_own(dataset.summary) else f"{first} depth"  # the user's own camera is only similar to the d415
    tiles = {seen: depth_picture(recorded.view(first)), "masks": mask_picture(recorded.labelled_depth())}
    tiles |= {f"{sensor} depth": depth_picture(recorded.view(sensor)) for sensor in others[:1]}  # a row of three
    pictures = [Image.fromarray(tile[window]).resize(SCENE_TILE, Image.Resampling.BICUBIC) for tile in tiles.values()]
    names = list(tiles)
    if recorded.split.truth:
        shaded = _ground_truth_tiles(recorded, window)
        pictures, names = [*pictures, *map(Image.fromarray, shaded.values())], [*names, *shaded]
    return contact_sheet_png(pictures, [f"{scene_id}  {name}" for name in names], columns=3)


def window_of_bodies(labels: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns that contain all bodies with a border, at the aspect ratio of the image."""
    v, u = np.nonzero(labels)
    height, width = labels.shape
    share = max(np.ptp(u) / width, np.ptp(v) / height) * BORDER
    tall, wide = min(round(height * share), height), min(round(width * share), width)
    top = int(np.clip((v.min() + v.max() - tall) // 2, 0, height - tall))
    left = int(np.clip((u.min() + u.max() - wide) // 2, 0, width - wide))
    return slice(top, top + tall), slice(left, left + wide)


def _ground_truth_tiles(recorded: RecordedScene, window: tuple[slice, slice]) -> dict[str, np.ndarray]:
    """The scene as it is, with the parts of queries at their goals, and at the user's initial guesses."""
    _, (assembly, world_from_assembly), *parts = recorded.bodies()
    kits = ColouredBody(assembly, world_from_assembly, KIT)
    colours = [part_colour(i) for i in range(len(parts))]
    lying = [ColouredBody(mesh, pose, colour) for (mesh, pose), colour in zip(parts, colours, strict=True)]
    seated, guessed = list(lying), list(lying)
    present = {query.track for query in recorded.queries}
    shown = next((track for track in GUESS_TRACKS if track in present), None)
    for query in recorded.queries:
        if query.track == shown and query.guess is not None:
            mesh, pose = parts[query.part]
            seated[query.part] = ColouredBody(mesh, recorded.truths[query.id].goal_drawn @ pose, colours[query.part])
            guessed[query.part] = ColouredBody(mesh, query.guess @ pose, colours[query.part])
    camera, pose = _tile_camera(recorded.view(), window)
    tiles = {"scene": lying, "parts at their goals": seated, "parts at the initial guesses": guessed}
    return {name: shaded_picture([kits, *bodies], camera, pose) for name, bodies in tiles.items()}


def _tile_camera(view: View, window: tuple[slice, slice]) -> tuple[Camera, Pose]:
    """The camera of a window of a view, with the size of a tile."""
    rows, columns = window
    whole, (width, height) = view.camera, SCENE_TILE
    across, down = width / (columns.stop - columns.start), height / (rows.stop - rows.start)
    centre = (whole.cx - columns.start + 0.5) * across - 0.5, (whole.cy - rows.start + 0.5) * down - 0.5
    return Camera(width, height, whole.fx * across, whole.fy * down, *centre), view.world_from_camera


def _evenly_chosen(ids: list[str], count: int) -> list[str]:
    return [ids[i] for i in np.unique(np.linspace(0, len(ids) - 1, count).round().astype(int))] if ids else []


def _tile(geometry: Geometry, what: str, item_id: str) -> np.ndarray:
    if what == "parts":
        return part_tile(geometry.part(item_id))
    if what == "kits":
        return kit_tile(geometry.part(item_id), geometry.kit(item_id))
    assembly = geometry.assembly(item_id)
    return assembly_tile(assembly, {m.kit.id: geometry.part(m.kit.id) for m in assembly.mounts})


def _label(geometry: Geometry, what: str, item_id: str) -> str:
    if what == "assemblies":
        return f"{item_id}  {len(geometry.assemblies[item_id]['mounts'])} kits"
    return f"{item_id}  {geometry.parts[item_id]['family']}"
