"""Contact sheets of scenes: their pictures with and without ground truth, and that they show the scene."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kit1000.camera import Camera
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.pictures import dataset_sheets as sheets
from kit1000.pictures.dataset_sheets import geometry_sheet, scene_sheet
from kit1000.pictures.depth_images import depth_picture
from kit1000.values import FIRST_PART_LABEL

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


def grey_picture(_: object, camera: Camera, __: object) -> np.ndarray:
    """Replaces `shaded_picture` where only the number of pictures matters."""
    return np.full((camera.height, camera.width, 3), 90, np.uint8)


def test_training_scenes_of_an_open_folder_have_ground_truth(public: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sheets, "shaded_picture", grey_picture)
    assert rows_of(pixels(scene_sheet(Dataset(public), "train-s0000"))) == 2


def test_without_the_d415_its_picture_is_omitted(
    mini: Path, whole_sheet: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sheets.RecordedScene, "sensors", ["ideal"])
    monkeypatch.setattr(sheets, "shaded_picture", grey_picture)
    image = pixels(scene_sheet(Dataset(mini), "test-s0000"))
    for i in range(2):  # depth and masks
        assert np.array_equal(tile(image, i), tile(whole_sheet, i))
    assert [int(np.median(tile(image, i))) for i in range(2, 6)] == [90, 90, 90, 250]  # the truth, then paper


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
