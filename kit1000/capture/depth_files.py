"""Depth images from files: 16-bit PNG and TIFF, .npy and .npz."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

from kit1000.capture.depth_frames import DepthFrame
from kit1000.errors import InputError

PICTURES = (".png", ".tif", ".tiff")
ARRAYS = (".npy", ".npz")
SUFFIXES = (*PICTURES, *ARRAYS)
MODES = {"I;16", "I;16B", "I;16L", "I;16N", "I", "F"}  # of Pillow, with one channel and more than 8 bits
NAMES = ("depth", "depth_image", "depths", "image", "arr_0")
"""Names of a depth image among several arrays of a .npz, in this order."""
MOST_BYTES = 2_000_000_000


def read_depth_files(path: Path) -> list[DepthFrame]:
    """The frames of a file: one, or several where an array is (n, H, W).

    Raises InputError with one line for anything that is no depth image.
    """
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size / 1e9:.1f} GB, expected one depth image")
    values = _picture(path) if path.suffix.lower() in PICTURES else _array(path)
    if values.ndim == 3 and values.shape[-1] > 4 and values.shape[0] <= 1000:
        return [DepthFrame(frame, f"{path}, frame {i}") for i, frame in enumerate(values)]
    return [DepthFrame(values, str(path))]


def _picture(path: Path) -> np.ndarray:
    """The pixels of a picture, after a look at its header alone."""
    try:
        with Image.open(path) as picture:
            if picture.mode not in MODES:
                bands = len(picture.getbands())
                what = f"{bands} channels" if bands > 1 else "8 bits a pixel"
                raise InputError(f"{path}: {what}, expected one of 16 bits or of floats: a picture, not depths")
            return np.asarray(picture)
    except InputError:
        raise
    except (OSError, ValueError, SyntaxError, struct.error, Image.DecompressionBombError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read: {_line(error)}; save the image again") from None


def _array(path: Path) -> np.ndarray:
    """The array of a .npy, or the depth among those of a .npz. Nothing pickled is loaded."""
    try:
        loaded = np.load(path, allow_pickle=False, mmap_mode="r" if path.suffix.lower() == ".npy" else None)
        if isinstance(loaded, np.ndarray):
            return np.array(loaded)
        with loaded:
            names = [name for name in NAMES if name in loaded.files]
            if not names and len(loaded.files) != 1:
                held = ", ".join(loaded.files) or "nothing"
                raise InputError(f"{path}: holds {held}; expected an array named depth")
            return loaded[names[0] if names else loaded.files[0]]
    except InputError:
        raise
    except (OSError, ValueError, EOFError, MemoryError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: cannot be read: {_line(error)}; save the array again with numpy.save") from None


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__
