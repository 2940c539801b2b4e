"""PNG files against the reader of Pillow."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from kit1000.dataset.png_files import COMPRESSION, QUICK_COMPRESSION, png_bytes, read_png


@pytest.mark.parametrize("compression", [COMPRESSION, QUICK_COMPRESSION])
@pytest.mark.parametrize("shape", [(1, 1, 3), (7, 30, 3), (64, 9, 3)])
def test_a_file_is_read_as_the_picture(shape: tuple[int, int, int], compression: int) -> None:
    picture = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    assert np.array_equal(read_png(png_bytes(picture, compression)), picture)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_an_image_of_one_channel_keeps_its_values(dtype: type) -> None:
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (7, 30), dtype=dtype)
    with Image.open(io.BytesIO(png_bytes(image))) as read:
        assert np.array_equal(np.asarray(read), image)


def test_a_file_says_what_it_was_made_with() -> None:
    picture = np.zeros((2, 2, 3), np.uint8)
    with Image.open(io.BytesIO(png_bytes(picture, software="kit1000"))) as read:
        assert read.text == {"Software": "kit1000"}  # pyright: ignore[reportAttributeAccessIssue]
    with Image.open(io.BytesIO(png_bytes(picture))) as read:
        assert read.text == {}  # pyright: ignore[reportAttributeAccessIssue]
