"""Exports for BOP: images, poses and models agree with the recorded scenes and with their own symmetries."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold
from PIL import Image
from scipy.spatial.distance import pdist

from kit1000.camera import Camera, look_at
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.reader import Dataset
from kit1000.dataset.scene_data import SceneTruth
from kit1000.errors import InputError
from kit1000.export import bop, export
from kit1000.export.bop import (
    DELTA,
    gt_info,
    model_info,
    object_numbers,
    silhouette,
    stored_depth,
    visible_pixels,
    write_bop,
)
from kit1000.generation.build import generate
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.symmetry import Symmetry
from kit1000.values import Assembly, Body, Part, Scene, View
from tests.samples.kits import sample_kit, sample_part
from tests.samples.mini import MINI, l_shape_sources
from tests.samples.shapes import as_part, cylinder

CAMERA = Camera(640, 360, 460.0, 462.0, 318.5, 181.0)
TABLE = mesh_from_solid(Manifold.cube((1.2, 1.6, 0.04), center=True).translate((0, 0, -0.02)))
FAMILIES = ("tee", "foot")
SHIFTED = Pose.from_rotvec([0.0, 0.002, 0.001], [0.001, -0.001, 0.0005])  # what a sensor errs about its own pose


def part_named(part_id: str, family: str) -> Part:
    made = sample_part(family)
    return Part(part_id, family, made.mesh, made.symmetry, {}, made.mass)


class FakeGeometry:
    """Parts and assemblies of one scene, and rows of others that are not exported."""

    def __init__(self, splits: tuple[str, ...] = ("train", "val", "test")) -> None:
        self.rows = [(f"{split}-{i:04d}", split) for split in splits for i in range(2)]
        self.parts = {i: {"split": split, "family": FAMILIES[int(i[-1])]} for i, split in self.rows}
        self.assemblies = {i: {"split": split} for i, split in self.rows}

    def part(self, part_id: str) -> Part:
        return part_named(part_id, self.parts[part_id]["family"])

    def assembly(self, assembly_id: str) -> Assembly:
        plan = AssemblyPlan(0.2, 1.0, (SidePlate(0, 0.6),))
        return build_assembly(assembly_id, [sample_kit(family) for family in FAMILIES], plan)


class FakeScene:
    """Two parts and an assembly on a table; the second part is cut by the border of the image."""

    def __init__(self, geometry: FakeGeometry, scene_id: str) -> None:
        self.id = scene_id
        world_from_camera = look_at((-0.75, 0.02, 0.5), (0.0, 0.02, 0.0))
        names = ("test-0000", "test-0001")
        lying = (
            Pose.from_rotvec([0.3, 0.9, -0.4], [-0.05, -0.12, 0.05]),
            Pose.from_rotvec([0.0, 0.0, 1.0], [-0.25, -0.45, 0.03]),
        )
        standing = Pose.from_rotvec([0, 0, 0.4], [0.0, 0.2, 0.0])
        self.scene = Scene(scene_id, (Body("test-0000", standing), *map(Body, names, lying)))
        meshes = [geometry.assembly("test-0000").mesh, *(geometry.part(name).mesh for name in names)]
        placed = list(zip(meshes, (standing, *lying), strict=True))
        self.frame = render(CAMERA, world_from_camera, [(TABLE, Pose.identity()), *placed], threads=1)
        self.views = {
            "ideal": View(CAMERA, world_from_camera, self.frame.depth),
            "d415": View(CAMERA, world_from_camera @ SHIFTED, self.frame.depth * (self.frame.body_ids % 3 > 0)),
        }
        rows = [{"part_id": name, "unseen": reason} for name, reason in zip(names, (None, "cut"), strict=True)]
        self.truth = SceneTruth(scene_id, "test-0000", standing, tuple(rows), {}, np.zeros((1, 1), np.uint16))

    def view(self, key: str) -> View:
        return self.views[key]


class FakeDataset:
    """The parts of a dataset that the export reads."""

    root, id, summary = "fake", "0123456789abcdef", {"licence": "CC-BY-4.0"}

    def __init__(self) -> None:
        self.geometry = FakeGeometry()
        self.scene = FakeScene(self.geometry, "test-s0001")

    def shards(self, folder: str) -> dict[str, str]:
        return {"test-s0000": "test/0000", "test-s0001": "test/0000"} if folder == "test" else {}

    def split(self, name: str, truth: bool = False) -> SimpleNamespace:
        assert (name, truth) == ("test", True)
        return SimpleNamespace(scene=lambda _: self.scene)


@pytest.fixture(scope="module")
def dataset() -> FakeDataset:
    return FakeDataset()


@pytest.fixture(scope="module")
def folder(dataset: FakeDataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bop") / "data"
    return bop.write_bop(dataset, out, ("test-s0001",), "test")  # type: ignore[arg-type]


@dataclass
class BopImage:
    """One image, read with numpy and JSON as the format specifies."""

    K: np.ndarray
    depth: np.ndarray
    """(H, W) [mm]"""
    gt: list[dict]
    info: list[dict]
    masks: list[np.ndarray]
    visible: list[np.ndarray]
    w2c: np.ndarray

    @classmethod
    def read(cls, scene: Path, image: int) -> BopImage:
        camera, gt, info = (
            json.loads((scene / f"{name}.json").read_text())[str(image)]
            for name in ("scene_camera", "scene_gt", "scene_gt_info")
        )
        stored = np.asarray(Image.open(scene / f"depth/{image:06d}.png"))
        assert stored.dtype == np.uint16
        masks, visible = (
            [np.asarray(Image.open(scene / name / f"{image:06d}_{i:06d}.png")) for i in range(len(gt))]
            for name in ("mask", "mask_visib")
        )
        assert all(set(np.unique(mask)) <= {0, 255} for mask in (*masks, *visible))
        w2c = matrix(camera["cam_R_w2c"], camera["cam_t_w2c"])
        depth = stored * camera["depth_scale"]
        K = np.reshape(camera["cam_K"], (3, 3))
        return cls(K, depth, gt, info, [m > 0 for m in masks], [m > 0 for m in visible], w2c)

    def points(self, mask: np.ndarray) -> np.ndarray:
        """Points (n, 3) [mm] in the camera frame of the pixels of a mask."""
        v, u = np.nonzero(mask & (self.depth > 0))
        rays = np.linalg.solve(self.K, np.stack([u, v, np.ones(len(u))]))
        return (rays * self.depth[v, u]).T


def matrix(rotation: list[float], shift: list[float]) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = np.reshape(rotation, (3, 3)), shift
    return transform


def m2c(gt: dict) -> np.ndarray:
    return matrix(gt["cam_R_m2c"], gt["cam_t_m2c"])


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, normals and faces of an ASCII PLY."""
    head, body = path.read_text("ascii").split("end_header\n")
    assert head.startswith("ply\nformat ascii 1.0\n")
    count = int(head.partition("element vertex ")[2].split()[0])
    rows = [line.split() for line in body.splitlines()]
    numbers = np.array(rows[:count], dtype=float)
    return numbers[:, :3], numbers[:, 3:], np.array(rows[count:], dtype=int)[:, 1:]


def distance_to(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n,) distances of points to a surface."""
    triangles = np.tile(vertices[faces], (len(points), 1, 1))
    repeated = np.repeat(points, len(faces), axis=0)
    near = trimesh.triangles.closest_point(triangles, repeated)
    return np.linalg.norm(near - repeated, axis=1).reshape(len(points), -1).min(1)


def distance_to_model(folder: Path, image: BopImage, i: int, shift: float = 0.0) -> float:
    """Median distance [mm] between the visible points of object i and its model."""
    vertices, _, faces = read_ply(folder / f"models/obj_{image.gt[i]['obj_id']:06d}.ply")
    seen = image.points(image.visible[i])[::11][:150] + [shift, 0, 0]
    pose = m2c(image.gt[i])
    return float(np.median(distance_to(vertices, faces, (seen - pose[:3, 3]) @ pose[:3, :3])))


def test_depth_lands_on_the_models(folder: Path) -> None:
    image = BopImage.read(folder / "test/000001", 0)
    assert len(image.gt) == 3
    for i in range(3):
        assert distance_to_model(folder, image, i) < 0.2
        assert distance_to_model(folder, image, i, shift=3.0) > 0.5


def test_poses_through_the_camera_are_those_of_the_world(folder: Path, dataset: FakeDataset) -> None:
    image = BopImage.read(folder / "test/000001", 0)
    assembly, *parts = dataset.scene.scene.bodies
    for gt, body in zip(image.gt, (*parts, assembly), strict=True):
        expected = body.world_from_body.matrix()
        expected[:3, 3] *= 1e3
        np.testing.assert_allclose(np.linalg.inv(image.w2c) @ m2c(gt), expected, atol=1e-9)


def test_the_visible_pixels_of_each_object_are_in_its_mask(folder: Path, dataset: FakeDataset) -> None:
    image, ids = BopImage.read(folder / "test/000001", 0), dataset.scene.frame.body_ids
    for i, body in enumerate((3, 4, 2)):  # in the picture: 1 the table, 2 the assembly, then the parts
        seen = ids == body
        assert not np.any(seen & ~image.visible[i])
        assert np.sum(image.visible[i] & ~seen) <= 0.02 * seen.sum()  # within DELTA behind something else
        assert not np.any(image.visible[i] & ~image.masks[i])


@pytest.mark.parametrize("i", [0, 1, 2])
def test_counts_are_those_of_a_canvas_three_times_as_large(folder: Path, dataset: FakeDataset, i: int) -> None:
    image = BopImage.read(folder / "test/000001", 0)
    vertices, _, faces = read_ply(folder / f"models/obj_{image.gt[i]['obj_id']:06d}.ply")
    pose = m2c(image.gt[i])
    height, width = image.depth.shape
    large = Camera(3 * width, 3 * height, CAMERA.fx, CAMERA.fy, CAMERA.cx + width, CAMERA.cy + height)
    carried = Mesh((vertices @ pose[:3, :3].T + pose[:3, 3]) / 1e3, faces)
    drawn = render(large, Pose.identity(), [(carried, Pose.identity())]).depth
    inside = 1e3 * drawn[height : 2 * height, width : 2 * width].astype(float)
    info, rows = image.info[i], np.argwhere(drawn > 0)[:, ::-1] - [width, height]
    assert abs(info["px_count_all"] - len(rows)) <= 2  # the last bits of the numbers written
    assert np.sum(image.masks[i] != (inside > 0)) <= 2
    assert info["px_count_valid"] == np.sum(image.depth[image.masks[i]] > 0)
    v, u = np.indices(inside.shape)
    ray = np.linalg.norm(np.linalg.inv(image.K) @ np.stack([u, v, np.ones_like(u)]).reshape(3, -1), axis=0)
    behind = (inside - image.depth) * ray.reshape(inside.shape)
    shown = (inside > 0) & ((behind <= DELTA) | (image.depth == 0))
    assert np.sum(shown != image.visible[i]) <= 2
    assert info["px_count_visib"] == image.visible[i].sum()
    assert info["visib_fract"] == info["px_count_visib"] / info["px_count_all"]
    np.testing.assert_allclose(info["bbox_obj"], [*rows.min(0), *np.ptp(rows, axis=0)], atol=1)
    cut = len(rows) > image.masks[i].sum()
    assert cut == (i == 1)  # the second part reaches over the border


def test_missing_depth_counts_as_visible_and_poses_stay_the_true_ones(
    folder: Path, dataset: FakeDataset, tmp_path: Path
) -> None:
    write_bop(dataset, tmp_path / "d415", split="test", ids=["test-s0001"], sensor="d415")  # type: ignore[arg-type]
    ideal, other = (BopImage.read(path / "test/000001", 0) for path in (folder, tmp_path / "d415"))
    assert other.gt == ideal.gt
    assert np.array_equal(other.w2c, ideal.w2c)
    assert other.info[0]["px_count_valid"] < ideal.info[0]["px_count_valid"]  # the fake sensor misses this part
    assert np.array_equal(other.visible[0], other.masks[0])


def test_models_are_the_parts_in_millimetres(folder: Path, dataset: FakeDataset) -> None:
    told = json.loads((folder / "dataset_info.json").read_text())
    infos = json.loads((folder / "models/models_info.json").read_text())
    assert told["objects"].keys() == infos.keys()
    for number, row in told["objects"].items():
        made = getattr(dataset.geometry, row["kind"])(row["id"]).mesh
        vertices, _, faces = read_ply(folder / f"models/obj_{int(number):06d}.ply")
        mesh, info = Mesh(vertices, faces), infos[number]
        assert mesh.volume == pytest.approx(made.volume * 1e9, rel=1e-6)
        np.testing.assert_allclose(vertices, made.vertices * 1e3, atol=1e-9)
        np.testing.assert_allclose([info[f"min_{axis}"] for axis in "xyz"], vertices.min(0))
        np.testing.assert_allclose([info[f"size_{axis}"] for axis in "xyz"], np.ptp(vertices, axis=0))
        assert info["diameter"] == pytest.approx(pdist(vertices).max())
        if row["kind"] == "part":
            np.testing.assert_allclose(mesh.centroid, 0, atol=1e-5)
        for name in (f"obj_{int(number):06d}.ply", "models_info.json"):
            assert (folder / "models_eval" / name).read_bytes() == (folder / "models" / name).read_bytes()


def test_camera_targets_and_dataset_info(folder: Path, dataset: FakeDataset) -> None:
    camera, info, few, many = (
        json.loads((folder / f"{name}.json").read_text())
        for name in ("camera", "dataset_info", "test_targets_bop19", "test_targets_bop24")
    )
    assert camera == {
        **{name: getattr(CAMERA, name) for name in ("fx", "fy", "cx", "cy", "width", "height")},
        "depth_scale": 0.1,
    }
    assert info["delta_mm"] == 5
    assert (info["dataset_id"], info["sensor"]) == (dataset.id, "ideal")
    assert info["scenes"] == {"test": {"1": "test-s0001"}}
    image = BopImage.read(folder / "test/000001", 0)
    names = [info["objects"][str(gt["obj_id"])] for gt in image.gt]
    assert [(row["kind"], row["id"]) for row in names] == [
        ("part", "test-0000"),
        ("part", "test-0001"),
        ("assembly", "test-0000"),
    ]
    assert few == [{"scene_id": 1, "im_id": 0, "obj_id": image.gt[0]["obj_id"], "inst_count": 1}]  # the other is cut
    assert many == [{"scene_id": 1, "im_id": 0}]


def test_depth_is_rounded_to_a_tenth_of_a_millimetre_and_too_large_depths_are_zero() -> None:
    depth = np.array([[0.0, 1e-3, 0.80012, 6.5535, 6.56, 9.0]], np.float32)
    np.testing.assert_array_equal(stored_depth(depth), [[0, 10, 8001, 65535, 0, 0]])
    near = np.random.default_rng(0).uniform(0.3, 3, (20, 20)).astype(np.float32)
    assert np.abs(stored_depth(near) * 0.1 - near * 1e3).max() <= 0.05 + 1e-4


def test_an_object_out_of_sight_has_no_box() -> None:
    box = mesh_from_solid(Manifold.cube((0.04, 0.04, 0.04), center=True))
    nothing = np.zeros((CAMERA.height, CAMERA.width))
    for place in ([5.0, 0, 1.0], [0, 0, -1.0]):  # far aside, and behind the camera
        seen = silhouette(CAMERA, box, Pose.from_translation(place))
        info = gt_info(seen, visible_pixels(seen.distance, nothing), nothing)
        assert info["px_count_visib"] == info["px_count_all"] == 0
        assert info["visib_fract"] == 0
        assert info["bbox_obj"] == info["bbox_visib"] == [-1, -1, -1, -1]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"split": "curves"}, "no split 'curves' to export; there are train, val, test"),
        ({"split": "val"}, "fake: no scenes in val"),
        ({"split": "test", "ids": ("test-s0000", "x")}, "fake: no scene 'x' in test"),
        ({"sensor": "lidar"}, "no sensor 'lidar'; there are ideal, d415"),
    ],
)
def test_invalid_exports_are_refused_in_one_line(dataset: FakeDataset, asked: dict, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"^{said}"):
        bop.write_bop(dataset, tmp_path / "out", **asked)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_of_an_export_that_fails(
    dataset: FakeDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(bop, "png_bytes", full)
    with pytest.raises(InputError, match=r"cannot write .*: No space left on device"):
        write_bop(dataset, tmp_path / "new")  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "other").touch()
    with pytest.raises(InputError, match=f"{tmp_path} exists already"):
        write_bop(dataset, tmp_path)  # type: ignore[arg-type]


def geometry(*splits: str) -> Geometry:
    """The tables of two parts and two assemblies in each split."""
    rows = {f"{split}-{i:04d}": {"split": split} for split in splits for i in range(2)}
    return cast(Geometry, SimpleNamespace(parts=rows, assemblies=dict(rows)))


def test_numbers_of_objects_do_not_depend_on_a_test_split_that_is_withheld() -> None:
    whole, rest = object_numbers(geometry("train", "val", "test")), object_numbers(geometry("train", "val"))
    assert sorted(whole.values()) == list(range(1, 13))
    assert rest.items() < whole.items()


def symmetric_parts() -> dict[str, Part]:
    return {
        "none": as_part(Manifold.cube((40, 28, 30), center=True)),
        "D2": as_part(Manifold.cube((40, 28, 30), center=True), Symmetry.dihedral(2)),
        "free": as_part(cylinder(30, 40, top=20), Symmetry.free()),
        "free_flipped": as_part(cylinder(30, 40), Symmetry.free_flipped()),
    }


@pytest.mark.parametrize("name", symmetric_parts())
def test_listed_symmetries_leave_the_model_as_it_is(name: str) -> None:
    part = symmetric_parts()[name]
    info = model_info(part.mesh, part.symmetry)
    discrete = [np.reshape(rows, (4, 4)) for rows in info.get("symmetries_discrete", [])]
    assert len(discrete) == part.symmetry.order - 1
    assert not any(np.allclose(turn, np.eye(4)) for turn in discrete)
    vertices = part.mesh.vertices * 1e3
    for turn in discrete:
        assert np.linalg.det(turn) == pytest.approx(1)
        moved = vertices @ turn[:3, :3].T + turn[:3, 3]
        apart = np.linalg.norm(moved[:, None] - vertices, axis=-1).min(1)
        assert apart.max() < 1e-3 * info["diameter"] or "free" in name
    lines = info.get("symmetries_continuous", [])
    assert len(lines) == (part.symmetry.axis is not None)
    for line in lines:  # any turn keeps the distance from the axis and the place along it
        axis, offset = np.array(line["axis"]), np.array(line["offset"])
        along = (vertices - offset) @ axis
        radius = np.linalg.norm(vertices - offset - along[:, None] * axis, axis=1)
        assert len(np.unique(np.round(np.stack([along, radius]), 6), axis=1).T) == 2


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("data")
    generate(MINI, folder / "data", workers=1, sources=l_shape_sources(folder / "files"))
    return Dataset(folder / "data")


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["ideal", "d415"])
def test_bop_scenes_match_the_recorded_scenes(generated: Dataset, sensor: str, tmp_path: Path) -> None:
    export(generated.root, "bop", tmp_path / "bop", sensor=sensor)
    for split in ("train", "val", "test"):
        for number, recorded in enumerate(generated.split(split, truth=True)):
            image = BopImage.read(tmp_path / f"bop/{split}/{number:06d}", 0)
            np.testing.assert_allclose(image.depth / 1e3, recorded.view(sensor).depth, atol=5.1e-5)
            for i, row in enumerate(recorded.truth.parts):
                assert distance_to_model(tmp_path / "bop", image, i) < {"ideal": 0.2, "d415": 4}[sensor]
                if sensor == "ideal":
                    assert image.info[i]["px_count_visib"] == pytest.approx(row["pixels"], rel=0.05)
                    assert image.info[i]["visib_fract"] == pytest.approx(row["visible"], abs=0.05)
