"""PNG files (W3C Portable Network Graphics, third edition): written without filters, by zlib alone.

Pillow compresses by a zlib of its own, which changes with its version; previews in recordings must keep their bytes.
"""

from __future__ import annotations

import io
import struct
import zlib

import numpy as np

COMPRESSION = 6  # of zlib; higher levels take five times as long for 3 % less
QUICK_COMPRESSION = 3  # in half the time, a sixth larger
GREY, RGB = 0, 2  # colour types


def png_bytes(picture: np.ndarray, compression: int = COMPRESSION, software: str | None = None) -> bytes:
    """A PNG of a picture (H, W, 3) uint8 sRGB, or of an image (H, W) uint8 or uint16.

    software: the program that the file names as its maker; none when None.
    """
    height, width = picture.shape[:2]
    samples = np.ascontiguousarray(picture, picture.dtype.newbyteorder(">"))
    rows = np.zeros((height, 1 + samples[:1].nbytes), np.uint8)  # each row begins with its filter, 0 for none
    rows[:, 1:] = samples.reshape(height, -1).view(np.uint8)
    kind = RGB if picture.ndim == 3 else GREY
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8 * picture.itemsize, kind, 0, 0, 0))]
    if software is not None:
        chunks.append((b"tEXt", b"Software\0" + software.encode("latin-1")))
    chunks += [(b"IDAT", zlib.compress(rows.tobytes(), compression)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )


def read_png(data: bytes) -> np.ndarray:
    """The picture (H, W, 3) uint8 sRGB of a PNG."""
    from PIL import Image  # only here: writing needs no Pillow

    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
