"""Depth images from files and their units: what was saved is read, and what is no depth image is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from kit1000.capture.depth_files import read_depth_files
from kit1000.capture.depth_frames import DepthFrame, mean_depth, metric_depth
from kit1000.errors import InputError

STEPS = np.random.default_rng(0).integers(400, 1200, (96, 128)).astype(np.uint16)


def save_npz(path: Path, values: np.ndarray) -> None:
    np.savez(path, colour=np.zeros((96, 128, 3), np.uint8), depth=values)


SAVED: dict[str, Callable[[Path, np.ndarray], object]] = {
    "a.png": lambda path, values: Image.fromarray(values).save(path),
    "a.tif": lambda path, values: Image.fromarray(values).save(path),
    "a.npy": lambda path, values: np.save(path, values),
    "b.npy": lambda path, values: np.save(path, values[..., None]),
    "a.npz": save_npz,
}


@pytest.mark.parametrize("name", SAVED)
def test_what_was_saved_is_read(tmp_path: Path, name: str) -> None:
    SAVED[name](tmp_path / name, STEPS)
    (frame,) = read_depth_files(tmp_path / name)
    np.testing.assert_array_equal(frame.values, STEPS)
    np.testing.assert_allclose(metric_depth(frame, 1e-3), STEPS * 1e-3, rtol=1e-6)


def test_floats_are_metres_and_several_frames_are_read(tmp_path: Path) -> None:
    metres = (STEPS * 1e-3).astype(np.float32)
    Image.fromarray(metres).save(tmp_path / "a.tiff")
    np.save(tmp_path / "stack.npy", np.stack([metres, metres + 1]))
    (frame,) = read_depth_files(tmp_path / "a.tiff")
    np.testing.assert_array_equal(metric_depth(frame, 1.0), metres)
    frames = read_depth_files(tmp_path / "stack.npy")
    np.testing.assert_array_equal(frames[1].values, metres + 1)


def test_32_bits_go_beyond_what_16_bits_mark_as_missing() -> None:
    hundredths = STEPS.astype(np.int32) * 100
    np.testing.assert_allclose(metric_depth(DepthFrame(hundredths, "depth.npy"), 1e-5), STEPS * 1e-3, rtol=1e-6)


HOSTILE: dict[str, tuple[Callable[[Path], object], str]] = {
    "eight.png": (lambda path: Image.fromarray(STEPS.astype(np.uint8)).save(path), "8 bits"),
    "colour.png": (lambda path: Image.new("RGB", (128, 96)).save(path), "3 channels"),
    "colour.npy": (lambda path: np.save(path, np.zeros((96, 128, 3), np.uint16)), "3 channels"),
    "cloud.npy": (lambda path: np.save(path, np.zeros((96, 128, 3))), "point cloud"),
    "eight.npy": (lambda path: np.save(path, STEPS.astype(np.uint8)), "8 bits"),
    "complex.npy": (lambda path: np.save(path, STEPS.astype(complex)), "complex128"),
    "flat.npy": (lambda path: np.save(path, np.arange(5.0)), "rows and columns"),
    "one.npy": (lambda path: np.save(path, np.array(3.0)), "one number"),
    "no frames.npy": (lambda path: np.save(path, np.zeros((0, 96, 128))), "0 x 96 x 128"),
    "pages.tif": (
        lambda path: Image.fromarray(STEPS).save(path, save_all=True, append_images=[Image.fromarray(STEPS)]),
        "several pages",
    ),
    "wide.png": (lambda path: Image.new("I;16", (9000, 9000)).save(path), "9000 x 9000"),
    "small.png": (lambda path: Image.fromarray(STEPS[:9, :9]).save(path), "9 x 9"),
    "objects.npy": (lambda path: np.save(path, np.array([{}, 1], object)), "cannot be read"),
    "names.npz": (lambda path: np.savez(path, left=STEPS, right=STEPS), "left, right"),
    "cut.png": (lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n\0\0"), "cannot be read"),
    "cut.npz": (lambda path: path.write_bytes(b"PK\3\4 not"), "cannot be read"),
    "cut.npy": (lambda path: path.write_bytes(b"\x93NUMPY\1\0"), "cannot be read"),
    "text.tif": (lambda path: path.write_text("hello"), "cannot be read"),
    "empty.png": (lambda path: path.write_bytes(b""), "cannot be read"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_no_depth_image_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    make, fact = HOSTILE[name]
    make(tmp_path / name)
    with pytest.raises(InputError) as refusal:
        read_depth_files(tmp_path / name)
    assert fact in str(refusal.value)
    assert name in str(refusal.value)
    assert "\n" not in str(refusal.value)


EMPTY = {
    "zeros": np.zeros((96, 128), np.uint16),
    "saturated": np.full((96, 128), 65535, np.uint16),
    "not a number": np.full((96, 128), np.nan, np.float32),
    "infinite": np.full((96, 128), np.inf, np.float32),
    "negative": np.full((96, 128), -1.0),
}


@pytest.mark.parametrize("name", EMPTY)
def test_an_image_without_returns_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=r"0\.0 % of the pixels"):
        metric_depth(DepthFrame(EMPTY[name], "depth.png"), 1.0)


def test_pixels_without_a_return_are_zero_whatever_they_hold() -> None:
    values = STEPS * 1e-3
    values[0, :5] = np.nan, np.inf, -np.inf, -1, 0
    depth = metric_depth(DepthFrame(values, "depth.npy"), 1.0)
    assert not depth[0, :5].any()
    assert (depth[0, 5:] > 0).all()


def test_swapped_bytes_are_named_whatever_the_unit() -> None:
    depths = np.tile(np.arange(600, 728, dtype=np.uint16), (96, 1))
    for unit in (1e-3, 1e-4, 1e-5):
        with pytest.raises(InputError, match="bytes of each value are swapped"):
            metric_depth(DepthFrame(depths.byteswap(), "depth.png"), unit)
    assert metric_depth(DepthFrame(depths, "depth.png"), 1e-3)[0, 0] == np.float32(0.6)


def test_a_median_depth_of_no_table_is_refused() -> None:
    with pytest.raises(InputError, match=r"median depth 8 m, expected 0\.15 to 4"):
        metric_depth(DepthFrame(np.full((96, 128), 8.0), "depth.npy"), 1.0)


@given(st.integers(1, 7), st.integers(0, 2**31))
def test_the_image_of_frames_is_their_median_where_most_see_a_pixel(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    stack = rng.uniform(0.3, 2, (count, 5, 6)).astype(np.float32) * (rng.random((count, 5, 6)) < 0.7)
    mean = mean_depth(list(stack))
    for place in np.ndindex(5, 6):
        seen = stack[(slice(None), *place)]
        seen = seen[seen > 0]
        expected = np.median(seen) if 2 * len(seen) > count else 0
        assert mean[place] == pytest.approx(expected)
    assert mean.dtype == np.float32
