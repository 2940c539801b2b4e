"""Previews and contact sheets of scenes: what they are drawn from, and that anybody can draw them again."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kit1000.camera import Camera
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.mcap_io import ObservationFile
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.dataset.scene_data import Observation, SceneTruth
from kit1000.errors import InputError
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pictures import dataset_sheets as sheets
from kit1000.pictures.dataset_sheets import geometry_sheet, scene_sheet
from kit1000.pictures.depth_images import depth_picture
from kit1000.pictures.scene_preview import MARK, NOTHING, TABLE, scene_picture, with_goals, with_previews
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import FIRST_PART_LABEL, View
from tests.samples.shapes import box, standing

CAMERA = Camera(128, 72, 92.5, 92.5, 63.5, 35.5)


@pytest.fixture(scope="module")
def recorded(mini: Path) -> list[tuple[Observation, SceneTruth, Mesh]]:
    """All scenes of the small dataset, each with its truth and the mesh of its target."""
    dataset = Dataset(mini)
    scenes = [scene for split in ("train", "val", "test-all") for scene in dataset.split(split, truth=True)]
    return [
        (
            dataset.observation_file(scene.shard).observation(scene.id),
            scene.truth,
            dataset.geometry.part(scene.truth.assembly_id).mesh,
        )
        for scene in scenes
    ]


def plane(normal: np.ndarray, distance: float = 0.7) -> View:
    """An image of the plane through (0, 0, distance) with a normal (3,) in the camera frame."""
    v, u = np.indices((CAMERA.height, CAMERA.width))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    depth = np.round(distance * normal[2] / (rays @ normal) * 8192) / 8192
    return View(CAMERA, Pose.identity(), depth.astype(np.float32))


def unit(*vector: float) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


def same(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    return one is not None and other is not None and np.array_equal(one, other)


# What it is drawn from


def test_the_preview_follows_from_the_observation_file_alone(mini: Path, tmp_path: Path) -> None:
    for path in sorted(mini.glob("*/[0-9][0-9][0-9][0-9].mcap")):
        alone = tmp_path / path.name
        alone.write_bytes(path.read_bytes())
        file = ObservationFile(alone)
        for scene_id in file.scene_ids:
            observation = replace(file.observation(scene_id), preview=None)
            assert same(scene_picture(observation), file.preview(scene_id))


def test_only_depth_masks_and_which_parts_are_drawn_matter(recorded: list) -> None:
    for observation, _, _ in recorded:
        ideal = observation.views["ideal"]
        rows = [
            {"part": row["part"], "drawn": row["drawn"], "pivot": [9.0, 9.0, 9.0], "id": "x", "guess": None}
            for row in observation.queries
        ]
        other = Observation(
            "elsewhere", {"ideal": replace(ideal, world_from_camera=Pose.identity())}, observation.labels
        )
        assert np.array_equal(scene_picture(replace(other, queries=tuple(rows[::-1]))), observation.preview)


def test_the_preview_of_the_truth_follows_from_goals_and_mesh(recorded: list) -> None:
    for observation, truth, mesh in recorded:
        bare = with_previews(replace(observation, preview=None), replace(truth, preview=None), mesh)
        assert same(bare[0].preview, observation.preview)
        assert same(bare[1].preview, truth.preview)


def test_an_observation_file_has_no_preview_of_the_goals(recorded: list, mini: Path) -> None:
    previews = {truth.preview.tobytes() for _, truth, _ in recorded}
    for path in mini.glob("*/[0-9][0-9][0-9][0-9].mcap"):
        file = ObservationFile(path)
        assert previews.isdisjoint(np.asarray(file.preview(scene_id)).tobytes() for scene_id in file.scene_ids)


# What it shows


def test_surfaces_and_holes_have_their_colours() -> None:
    view = plane(unit(0.0, -0.3, -1.0))
    depth = np.where(np.arange(CAMERA.height)[:, None] < 20, np.float32(0), view.depth)
    picture = scene_picture(Observation("s", {"ideal": replace(view, depth=depth)}, np.zeros(depth.shape, np.uint8)))
    assert (picture[:10] == NOTHING).all()
    assert len(np.unique(picture[12:].reshape(-1, 3), axis=0)) == 1
    shares = picture[20, 20] / np.array(TABLE)
    assert np.ptp(shares) < 0.02


def test_exactly_the_parts_of_drawn_queries_are_marked() -> None:
    labels = np.zeros((72, 128), np.uint8)
    labels[20:40, 20:40], labels[20:40, 80:100] = 2, 3
    scene = Observation("s", {"ideal": plane(unit(0.0, 0.0, -1.0))}, labels)
    for drawn in ((), (0,), (1,), (0, 1)):
        rows = tuple({"part": part, "drawn": part in drawn} for part in (0, 1, 1))
        white = (scene_picture(replace(scene, queries=rows)) == MARK).all(2)
        assert [part for part, half in enumerate((white[:, :32], white[:, 32:])) if half.any()] == list(drawn)


def test_goals_change_the_picture_only_where_the_part_would_be() -> None:
    mesh = mesh_from_solid(standing(box(40, 30, 20)))
    view = View(CAMERA, Pose.identity(), plane(unit(0.0, 0.0, -1.0)).depth)
    plain = np.full((36, 64, 3), 90, np.uint8)
    goals = Pose.stack([Pose.from_translation([x, 0.0, 0.6]) for x in (-0.1, 0.1)])
    drawn = with_goals(plain, view, mesh, goals, 0)
    shown = render(CAMERA, view.world_from_camera, [(mesh, goals[0]), (mesh, goals[1])], threads=1).body_ids > 0
    cells = shown.reshape(36, 2, 64, 2)
    changed = (drawn != plain).any(2)
    assert changed[cells.any((1, 3))].all()
    v, u = np.nonzero(changed)
    at = np.argwhere(cells.any((1, 3)))
    assert all(np.abs(at - (y, x)).max(1).min() <= 2 for y, x in zip(v, u, strict=True))
    far = Pose.stack([Pose.from_translation([9.0, 0.0, 0.6]), Pose.from_translation([0.0, 0.0, -1.0])])
    assert np.array_equal(with_goals(plain, view, mesh, far, 0), plain)


# Any image, the same bytes


@pytest.mark.parametrize("size", [(2, 2), (3, 5), (24, 32), (37, 61)])
def test_any_image_has_a_picture(size: tuple[int, int]) -> None:
    draw = np.random.default_rng(size[0])
    camera = Camera(size[1], size[0], 30.0, 31.0, 15.0, 11.0)
    labels = draw.integers(0, 256, size).astype(np.uint8)
    rows = tuple({"part": part, "drawn": True} for part in (0, 100, 253))
    for depth in (np.zeros(size), np.ones(size), draw.integers(0, 8192, size) / 8192):
        view = View(camera, Pose.identity(), depth.astype(np.float32))
        picture = scene_picture(Observation("s", {"d415": view}, labels, rows))
        assert picture.shape == (size[0] // 2, size[1] // 2, 3)


def test_masks_are_needed() -> None:
    with pytest.raises(InputError, match="test-s0000: a preview needs masks"):
        scene_picture(Observation("test-s0000", {"ideal": plane(unit(0.0, 0.0, -1.0))}))


def test_the_pixels_are_the_same_on_every_processor() -> None:
    """A body with a hollow, a hole in the image, and steps of the depth grid: the pixels as first drawn."""
    view = plane(unit(0.1, -0.5, -1.0))
    depth, labels = view.depth.copy(), np.zeros(view.depth.shape, np.uint8)
    depth[20:50, 30:70] -= np.float32(400 / 8192)
    labels[20:50, 30:70] = 1
    depth[30:40, 45:60] += np.float32(200 / 8192)
    depth[10:25, 90:110] -= np.float32(300 / 8192)
    labels[10:25, 90:110] = 3
    depth[60:, :20] = 0
    picture = scene_picture(
        Observation("s", {"ideal": replace(view, depth=depth)}, labels, ({"part": 1, "drawn": True},))
    )
    assert sha256(picture.tobytes()).hexdigest()[:16] == "f09afd8d3aec25de"


WIDTH, HEIGHT = 320, 180  # [px] smaller pictures than usual: rendering takes time
GAP, CAPTION = 8, 30  # [px] between the pictures of a sheet, and below each, at this width


@pytest.fixture(scope="module", autouse=True)
def _small_pictures() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sheets, "SCENE_TILE", (WIDTH, HEIGHT))
        yield


def pixels(png: bytes) -> np.ndarray:
    assert png.startswith(b"\x89PNG")
    return np.asarray(Image.open(io.BytesIO(png)))


def rows_of(image: np.ndarray) -> int:
    """Rows of pictures in a sheet of three columns; a rendered picture may be one pixel higher than HEIGHT."""
    assert image.shape[1:] == (3 * (WIDTH + GAP) + GAP, 3)
    rows, remainder = divmod(image.shape[0] - GAP, HEIGHT + CAPTION + GAP)
    assert remainder in (0, rows)
    return rows


def tile(image: np.ndarray, number: int) -> np.ndarray:
    """One picture of a sheet of three columns."""
    top = GAP + number // 3 * ((image.shape[0] - GAP) // rows_of(image))
    left = GAP + number % 3 * (WIDTH + GAP)
    return image[top : top + HEIGHT, left : left + WIDTH].astype(int)


@pytest.fixture(scope="module")
def whole_sheet(mini: Path) -> np.ndarray:
    return pixels(scene_sheet(Dataset(mini), "test-s0000"))


def test_a_scene_with_ground_truth_has_six_pictures(whole_sheet: np.ndarray) -> None:
    assert rows_of(whole_sheet) == 2
    pictures = [tile(whole_sheet, i) for i in range(6)]
    for i, picture in enumerate(pictures):
        assert picture.std() > 10  # not uniform
        assert all(np.abs(picture - other).mean() > 0.05 for other in pictures[:i])


def test_a_scene_without_ground_truth_has_three_pictures(public: Path, whole_sheet: np.ndarray) -> None:
    image = pixels(scene_sheet(Dataset(public), "test-s0000"))
    assert rows_of(image) == 1
    for i in range(3):
        assert np.array_equal(tile(image, i), tile(whole_sheet, i))


def test_the_pictures_are_cropped_to_the_masks(mini: Path, whole_sheet: np.ndarray) -> None:
    recorded = Dataset(mini).recorded_scene("test-s0000")
    rows, columns = sheets.window_of_bodies(recorded.labels)
    outside = np.ones(recorded.labels.shape, bool)
    outside[rows, columns] = False
    assert not recorded.labels[outside].any()
    tall, wide = rows.stop - rows.start, columns.stop - columns.start
    assert wide / tall == pytest.approx(WIDTH / HEIGHT, rel=0.01)
    cropped = Image.fromarray(depth_picture(recorded.view())[rows, columns])
    cropped = cropped.resize((WIDTH, HEIGHT), Image.Resampling.BICUBIC)
    assert np.array_equal(tile(whole_sheet, 0), np.asarray(cropped).astype(int))


def labels_of(recorded: RecordedScene) -> np.ndarray:
    """The labels in the crop and size of a picture of the sheet. (HEIGHT, WIDTH) uint8."""
    masks = Image.fromarray(recorded.labels[sheets.window_of_bodies(recorded.labels)])
    return np.asarray(masks.resize((WIDTH, HEIGHT), Image.Resampling.NEAREST))


def test_shaded_pictures_are_aligned_with_the_depth_images(mini: Path, whole_sheet: np.ndarray) -> None:
    """Where the masks show bodies, the shaded picture shows no table: outlines agree."""
    recorded = Dataset(mini).recorded_scene("test-s0000")
    bodies = labels_of(recorded) > 0
    scene = tile(whole_sheet, 3)
    background = np.abs(scene - scene[2, 2]).sum(axis=-1) < 12
    assert np.mean(background[bodies]) < 0.02
    assert np.mean(background[~bodies]) > 0.6  # but for shadows


def test_only_parts_of_queries_move_between_the_shaded_pictures(mini: Path, whole_sheet: np.ndarray) -> None:
    lying, seated, guessed = (tile(whole_sheet, i) for i in (3, 4, 5))
    recorded = Dataset(mini).recorded_scene("test-s0000")
    queries = [query for query in recorded.queries if query.track == "snap-tilt"]
    assert queries
    part = labels_of(recorded) == FIRST_PART_LABEL + queries[0].part
    assert np.mean(np.abs(lying - seated).sum(-1)[part] > 12) > 0.5  # the part has moved away
    changed = np.abs(seated - guessed).sum(-1) > 12
    assert 0.001 < changed.mean() < 0.1


def test_a_sheet_of_no_parts_is_rejected(mini: Path) -> None:
    with pytest.raises(InputError, match="no parts in split 'tets'"):
        geometry_sheet(Geometry(mini), "parts", "tets", 2)
