"""Export of scenes in the BOP format, for tools of 6DoF object pose estimation: millimetres, row-major matrices.

A BOP scene is one KIT1000 scene with one image. Objects are the parts and, last in each image, the assembly; targets
are the parts with queries. Poses are the true ones, also for a sensor with an error in its camera pose.

The origin of a part's model is the part's centroid, which every symmetry fixes; that of an assembly is at its foot, as
elsewhere in KIT1000. BOP specifies the centre of the bounding box, on which no tool relies.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist
from tqdm import tqdm

from kit1000.camera import Camera
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.png_files import png_bytes
from kit1000.errors import InputError
from kit1000.files import json_bytes, new_folder
from kit1000.mesh import Mesh
from kit1000.pictures.creases import corner_angles
from kit1000.pose import Pose
from kit1000.queries.tracks import SPLITS, Sensor
from kit1000.sim.render import render
from kit1000.symmetry import Symmetry

if TYPE_CHECKING:
    from kit1000.dataset.reader import Dataset, RecordedScene

MM = 1e3  # per metre
PART, ASSEMBLY = "part", "assembly"
KINDS = {PART: "parts", ASSEMBLY: "assemblies"}  # table of each kind
SENSORS: tuple[str, ...] = get_args(Sensor)
DEPTH_SCALE = 0.1  # [mm] of one step of a depth image; the largest depth is 6.55 m
MAX_STEPS = np.iinfo(np.uint16).max
DELTA = 5.0  # [mm] that a visible surface may be behind the measured one
IMAGE = "000000"  # the one image of each scene
NO_BOX = [-1, -1, -1, -1]  # bounding box of an object without visible pixels


class PlacedObject(NamedTuple):
    """An object in a scene."""

    number: int
    mesh: Mesh
    camera_from_body: Pose


@dataclass(frozen=True, eq=False)
class Silhouette:
    """The pixels of an object without occlusion, on a canvas three times the image, for objects cut by its border."""

    distance: np.ndarray  # (H, W) [mm] distance along the ray within the image, 0 outside the object
    all_pixels: np.ndarray  # (n, 2) int (u, v) of all its pixels, also outside the image


def write_bop(
    dataset: Dataset, folder: Path, ids: Sequence[str] = (), split: str | None = None, sensor: str = "ideal"
) -> Path:
    """Write scenes as a BOP dataset into a new folder, which appears when it is complete; returns the folder.

    Args:
        dataset: the dataset; its truth is read.
        folder: must not exist.
        ids: ids of the scenes to write; all of the split when empty.
        split: train, val or test; all three when None.
        sensor: sensor of the depth images: ideal, d415 or photoneo.

    Raises:
        InputError: no such split, scene or sensor, the truth is withheld, or the folder cannot be written.
    """
    if sensor not in SENSORS:
        raise InputError(f"no sensor {sensor!r}; there are {', '.join(SENSORS)}")
    scenes = chosen_scenes(dataset, ids, split)
    numbers = object_numbers(dataset.geometry)
    with new_folder(folder, "BOP dataset") as out:
        used: set[tuple[str, str]] = set()
        camera, targets = None, {name: [] for name in scenes}
        all_scenes = [(name, number, scene) for name, numbered in scenes.items() for number, scene in numbered]
        for name, number, scene in tqdm(all_scenes, desc="scenes", unit="", disable=None):
            recorded = dataset.split(name, truth=True).scene(scene)
            camera = _write_scene(out / name / f"{number:06d}", recorded, dataset, numbers, sensor)
            used |= {(PART if i else ASSEMBLY, body.id) for i, body in enumerate(recorded.scene.bodies)}
            targets[name] += [
                {"scene_id": number, "im_id": 0, "obj_id": numbers[PART, row["part_id"]], "inst_count": 1}
                for row in recorded.truth.parts
                if row["unseen"] is None
            ]
        _write_models(out, dataset, {key: numbers[key] for key in sorted(used)})
        assert camera is not None  # there is at least one scene
        _write_tables(out, camera, targets)
        _write(out / "dataset_info.json", json_bytes(_dataset_info(dataset, scenes, numbers, used, sensor)))
    return folder


def chosen_scenes(dataset: Dataset, ids: Sequence[str], split: str | None) -> dict[str, list[tuple[int, str]]]:
    """The scenes to write by split, each with its number, which is its index in the split."""
    if split is not None and split not in SPLITS:
        raise InputError(f"no split {split!r} to export; there are {', '.join(SPLITS)}")
    available = {name: list(dataset.shards(name)) for name in (SPLITS if split is None else (split,))}
    unknown = sorted(set(ids) - {scene for scenes in available.values() for scene in scenes})
    if unknown:
        raise InputError(f"{dataset.root}: no scene {unknown[0]!r} in {', '.join(available)}")
    chosen = {
        name: [(i, scene) for i, scene in enumerate(scenes) if not ids or scene in ids]
        for name, scenes in available.items()
    }
    chosen = {name: scenes for name, scenes in chosen.items() if scenes}
    if not chosen:
        raise InputError(f"{dataset.root}: no scenes in {', '.join(available)}")
    for name, scenes in chosen.items():
        dataset.split(name, truth=True).scene(scenes[0][1]).truth  # noqa: B018 (raises when it is withheld)
    return chosen


def _write_scene(
    folder: Path, recorded: RecordedScene, dataset: Dataset, numbers: dict[tuple[str, str], int], sensor: str
) -> Camera:
    """Write the files of one scene; returns its camera."""
    view, world_from_camera = recorded.view(sensor), recorded.view("ideal").world_from_camera
    steps = stored_depth(view.depth)
    placed = list(_placed_objects(recorded, dataset, numbers, world_from_camera.inverse()))
    measured = distances(view.camera, steps * DEPTH_SCALE)
    infos = []
    for i, placed_object in enumerate(placed):
        outline = silhouette(view.camera, placed_object.mesh, placed_object.camera_from_body)
        visible = visible_pixels(outline.distance, measured)
        infos.append(gt_info(outline, visible, measured))
        for name, mask in (("mask", outline.distance > 0), ("mask_visib", visible)):
            _write(folder / name / f"{IMAGE}_{i:06d}.png", png_bytes(mask.astype(np.uint8) * np.uint8(255)))
    _write(folder / "depth" / f"{IMAGE}.png", png_bytes(steps))
    camera = {"cam_K": view.camera.K.reshape(-1).tolist(), "depth_scale": DEPTH_SCALE}
    camera |= _pose_entry(world_from_camera.inverse(), "w2c")
    truths = [{"obj_id": each.number} | _pose_entry(each.camera_from_body, "m2c") for each in placed]
    for name, entry in (("camera", camera), ("gt", truths), ("gt_info", infos)):
        _write(folder / f"scene_{name}.json", json_bytes({"0": entry}))  # of the only image, 0
    return view.camera


def _placed_objects(
    recorded: RecordedScene, dataset: Dataset, numbers: dict[tuple[str, str], int], camera_from_world: Pose
) -> Iterator[PlacedObject]:
    """The objects of a scene: the parts p0, p1, ... and then the assembly."""
    assembly, *parts = recorded.scene.bodies
    for body in parts:
        mesh = dataset.geometry.part(body.id).mesh
        yield PlacedObject(numbers[PART, body.id], mesh, camera_from_world @ body.world_from_body)
    mesh = dataset.geometry.assembly(assembly.id).mesh
    yield PlacedObject(numbers[ASSEMBLY, assembly.id], mesh, camera_from_world @ assembly.world_from_body)


def stored_depth(depth: np.ndarray) -> np.ndarray:
    """Depths (H, W) [m] as (H, W) uint16 steps of DEPTH_SCALE; larger depths become 0, no return."""
    steps = np.round(depth.astype(np.float64) * (MM / DEPTH_SCALE))
    return np.where(steps > MAX_STEPS, 0, steps).astype(np.uint16)


def distances(camera: Camera, depth: np.ndarray) -> np.ndarray:
    """Distances (H, W) along the rays, from depths (H, W) along the optical axis, in the same unit; 0 stays 0."""
    v, u = np.indices(depth.shape)
    return depth * np.sqrt(((u - camera.cx) / camera.fx) ** 2 + ((v - camera.cy) / camera.fy) ** 2 + 1)


def silhouette(camera: Camera, mesh: Mesh, camera_from_body: Pose) -> Silhouette:
    """The silhouette of one object. Only its window of the image is rendered."""
    size = np.array((camera.width, camera.height))
    left, top, window = camera.window(camera_from_body.apply(mesh.vertices), -size, 2 * size, margin=1)
    frame = render(window, Pose.identity(), [(mesh, camera_from_body)], threads=1)
    v, u = np.nonzero(frame.body_ids)
    pixels = np.stack([u + left, v + top], axis=-1)
    within = ((pixels >= 0) & (pixels < size)).all(axis=1)
    depth = np.zeros((camera.height, camera.width))
    depth[pixels[within, 1], pixels[within, 0]] = frame.depth[v[within], u[within]]
    return Silhouette(distances(camera, MM * depth), pixels)


def visible_pixels(distance: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels of the object with no measured surface more than DELTA before it; distances (H, W) [mm]."""
    return (distance > 0) & ((distance - measured <= DELTA) | (measured == 0))


def gt_info(outline: Silhouette, visible: np.ndarray, measured: np.ndarray) -> dict[str, Any]:
    """The entry of an object in `scene_gt_info.json`, computed as in the BOP toolkit."""
    visible_count = int(visible.sum())
    inside = outline.distance > 0
    return {
        "px_count_all": len(outline.all_pixels),
        "px_count_valid": int((measured[inside] > 0).sum()),
        "px_count_visib": visible_count,
        "visib_fract": visible_count / len(outline.all_pixels) if len(outline.all_pixels) else 0.0,
        "bbox_obj": _box(outline.all_pixels) if visible_count else NO_BOX,
        "bbox_visib": _box(np.argwhere(visible)[:, ::-1]) if visible_count else NO_BOX,
    }


def _box(pixels: np.ndarray) -> list[int]:
    """Left, top, width and height of pixels (n, 2); width is last minus first, as in the BOP toolkit."""
    low, high = pixels.min(0), pixels.max(0)
    return [*low.tolist(), *(high - low).tolist()]


def _pose_entry(pose: Pose, name: str) -> dict[str, list[float]]:
    """A pose, by its name in BOP: nine numbers of the rotation matrix, row by row, and three of the position [mm]."""
    return {f"cam_R_{name}": pose.rotation_matrix().reshape(-1).tolist(), f"cam_t_{name}": (MM * pose.xyz).tolist()}


def _write_models(out: Path, dataset: Dataset, used: dict[tuple[str, str], int]) -> None:
    """Write the models of the objects that occur, as `models` and the same as `models_eval`."""
    infos = {}
    for (kind, item_id), number in used.items():
        if kind == PART:
            part = dataset.geometry.part(item_id)
            mesh, symmetry = part.mesh, part.symmetry
        else:
            mesh, symmetry = dataset.geometry.assembly(item_id).mesh, Symmetry.none()
        infos[str(number)] = model_info(mesh, symmetry)
        data = ply_bytes(mesh)
        for name in ("models", "models_eval"):
            _write(out / name / f"obj_{number:06d}.ply", data)
    for name in ("models", "models_eval"):
        _write(out / name / "models_info.json", json_bytes(infos))


def _write_tables(out: Path, camera: Camera, targets: dict[str, list[dict[str, int]]]) -> None:
    """Write the camera, and the targets of each split except train."""
    sensor = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    _write(out / "camera.json", json_bytes(sensor | {"depth_scale": DEPTH_SCALE}))
    for split in targets.keys() - {"train"}:
        images = [{"scene_id": i, "im_id": 0} for i in sorted({row["scene_id"] for row in targets[split]})]
        _write(out / f"{split}_targets_bop19.json", json_bytes(targets[split]))
        _write(out / f"{split}_targets_bop24.json", json_bytes(images))


def _dataset_info(
    dataset: Dataset,
    scenes: dict[str, list[tuple[int, str]]],
    numbers: dict[tuple[str, str], int],
    used: Iterable[tuple[str, str]],
    sensor: str,
) -> dict[str, Any]:
    """Metadata outside the BOP format: the dataset's id, and the ids of its objects and scenes by number."""
    objects = {}
    for kind, item_id in used:
        family = getattr(dataset.geometry, KINDS[kind])[item_id].get("family")
        objects[str(numbers[kind, item_id])] = {"kind": kind, "id": item_id} | ({"family": family} if family else {})
    return {
        "name": "KIT1000",
        "dataset_id": dataset.id,
        "licence": dataset.summary["licence"],
        "sensor": sensor,
        "delta_mm": DELTA,
        "objects": objects,
        "scenes": {name: {str(number): scene for number, scene in numbered} for name, numbered in scenes.items()},
    }


def object_numbers(geometry: Geometry) -> dict[tuple[str, str], int]:
    """The BOP number of every object of a dataset by kind and id, also of objects that are not exported.

    Numbers follow the splits, in each the parts before the assemblies: without a withheld test split they are the same.
    """
    numbers: dict[tuple[str, str], int] = {}
    for split in SPLITS:
        for kind, table in KINDS.items():
            rows = getattr(geometry, table)
            for item_id in sorted(i for i, row in rows.items() if row["split"] == split):
                numbers[kind, item_id] = len(numbers) + 1
    return numbers


def model_info(mesh: Mesh, symmetry: Symmetry) -> dict[str, Any]:
    """The entry of a model in `models_info.json`, in millimetres; symmetries rotate about the origin."""
    low, size = MM * mesh.bounds[0], MM * mesh.extents
    info: dict[str, Any] = {"diameter": MM * diameter(mesh)}
    info |= {f"min_{axis}": float(low[i]) for i, axis in enumerate("xyz")}
    info |= {f"size_{axis}": float(size[i]) for i, axis in enumerate("xyz")}
    if symmetry.order > 1:  # without the identity, which is first
        rotations = Pose(symmetry.rotations[1:], np.zeros(3)).matrix()
        info["symmetries_discrete"] = rotations.reshape(-1, 16).tolist()
    if symmetry.axis is not None:
        info["symmetries_continuous"] = [{"axis": symmetry.axis.tolist(), "offset": [0.0, 0.0, 0.0]}]
    return info


def diameter(mesh: Mesh) -> float:
    """The largest distance [m] between two vertices, found among those of the convex hull."""
    corners = mesh.vertices[ConvexHull(mesh.vertices).vertices]
    return float(pdist(corners).max())


def ply_bytes(mesh: Mesh) -> bytes:
    """A mesh as ASCII PLY in millimetres with vertex normals."""
    rows = np.hstack([MM * mesh.vertices, vertex_normals(mesh)]).tolist()
    properties = [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    lines = [
        "ply",
        "format ascii 1.0",
        "comment KIT1000, millimetres",
        f"element vertex {len(mesh.vertices)}",
        *properties,
        f"element face {len(mesh.faces)}",
        "property list uchar int vertex_indices",
        "end_header",
        *(f"{x!r} {y!r} {z!r} {a:.6f} {b:.6f} {c:.6f}" for x, y, z, a, b, c in rows),
        *(f"3 {a} {b} {c}" for a, b, c in mesh.faces.tolist()),
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def vertex_normals(mesh: Mesh) -> np.ndarray:
    """(n, 3) unit normals of the vertices: means of the adjacent face normals, weighted by angle; zero if undefined."""
    sums = np.zeros_like(mesh.vertices)
    np.add.at(sums, mesh.faces, corner_angles(mesh.triangles)[..., None] * mesh.normals[:, None])
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 1e-9)


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
