"""PNG files of pictures (W3C Portable Network Graphics, third edition), without filters."""

from __future__ import annotations

import struct
import zlib

import numpy as np

COMPRESSION = 6  # of zlib; higher levels take five times as long for 3 % less
QUICK_COMPRESSION = 3  # in half the time, a sixth larger


def png_bytes(picture: np.ndarray, compression: int = COMPRESSION, software: str | None = None) -> bytes:
    """A PNG of a picture (H, W, 3) uint8 sRGB, without filters: so its areas of one colour compress best.

    software: what the file says that it was made with; nothing when None.
    """
    height, width = picture.shape[:2]
    rows = np.concatenate([np.zeros((height, 1), np.uint8), picture.reshape(height, -1)], axis=1)
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))]  # 8 bits, RGB
    if software is not None:
        chunks.append((b"tEXt", b"Software\0" + software.encode("latin-1")))
    chunks += [(b"IDAT", zlib.compress(rows.tobytes(), compression)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
