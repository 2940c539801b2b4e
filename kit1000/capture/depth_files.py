"""Depth images from files: 16-bit PNG and TIFF, .npy and .npz."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence

from kit1000.capture.depth_frames import DepthFrame, check_size
from kit1000.errors import InputError, Kit1000Error

PICTURES = (".png", ".tif", ".tiff")
ARRAYS = (".npy", ".npz")
SUFFIXES = (*PICTURES, *ARRAYS)
MODES = {"I;16", "I;16B", "I;16L", "I;16N", "I", "F"}  # of Pillow, with one channel and more than 8 bits
NAMES = ("depth", "depth_image", "depths", "image", "arr_0")
"""Names of a depth image among several arrays of a .npz, in this order."""
MOST_BYTES = 2_000_000_000
MOST_FRAMES = 1000  # of a file


def read_depth_files(path: Path) -> list[DepthFrame]:
    """The frames of a file: one, or several where an array is (n, H, W) or a TIFF has pages.

    Raises InputError with one line for anything that is no depth image.
    """
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size / 1e9:.1f} GB, expected one depth image")
    values = _picture(path) if path.suffix.lower() in PICTURES else _array(path)
    if values.ndim == 3 and values.shape[-1] > 4 and 0 < values.shape[0] <= MOST_FRAMES:
        return [DepthFrame(frame, f"{path}, frame {i}") for i, frame in enumerate(values)]
    return [DepthFrame(values, str(path))]


def _picture(path: Path) -> np.ndarray:
    """The pixels (H, W) of a picture, or (n, H, W) of one with n pages, after a look at its header alone."""
    with _one_line(path, "save the image again"), Image.open(path) as picture:
        if picture.mode not in MODES:
            bands = len(picture.getbands())
            what = f"{bands} channels" if bands > 1 else "8 bits a pixel"
            raise InputError(f"{path}: {what}, expected one of 16 bits or of floats: a picture, not depths")
        pages = int(getattr(picture, "n_frames", 1))
        check_size(picture.size[::-1], str(path))
        if pages > MOST_FRAMES or pages * picture.width * picture.height * 4 > MOST_BYTES:
            raise InputError(
                f"{path}: {pages} pages, expected at most {MOST_FRAMES} of {MOST_BYTES // 10**9} GB together"
            )
        if pages == 1:
            return np.asarray(picture)
        return _same_size([np.array(page) for page in ImageSequence.Iterator(picture)], path)


def _same_size(pages: list[np.ndarray], path: Path) -> np.ndarray:
    """(n, H, W) the pages of a picture."""
    if len({page.shape for page in pages}) > 1:
        raise InputError(f"{path}: pages of several sizes: save the depth image alone")
    return np.stack(pages)


def _array(path: Path) -> np.ndarray:
    """The array of a .npy, or the depth among those of a .npz. Nothing pickled is loaded."""
    with _one_line(path, "save the array again with numpy.save"):
        loaded = np.load(path, allow_pickle=False, mmap_mode="r" if path.suffix.lower() == ".npy" else None)
        if isinstance(loaded, np.ndarray):
            return np.array(loaded)
        with loaded:
            names = [name for name in NAMES if name in loaded.files]
            if not names and len(loaded.files) != 1:
                held = ", ".join(loaded.files) or "nothing"
                raise InputError(f"{path}: holds {held}; expected an array named depth")
            return loaded[names[0] if names else loaded.files[0]]


@contextmanager
def _one_line(path: Path, fix: str) -> Iterator[None]:
    """Any exception that damaged bytes raise in libraries becomes an InputError with one line, and warnings nothing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except Kit1000Error:
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:160] or type(error).__name__
        raise InputError(f"{path}: cannot be read: {text}; {fix}") from None
