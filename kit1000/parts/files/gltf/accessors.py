"""Accessors of glTF: typed arrays in buffers, interleaved, normalized or sparse, as the standard defines them."""

from __future__ import annotations

from typing import Any

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.parts.files.gltf.document import Document
from kit1000.parts.files.gltf.required_extensions import MESHOPT

TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
LARGEST = {5120: 127.0, 5121: 255.0, 5122: 32767.0, 5123: 65535.0}  # of what 1 is in normalized integers
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def floats(document: Document, index: Any, width: int) -> np.ndarray:
    """(n, width) float64 the values of an accessor; normalized integers become -1 to 1 or 0 to 1."""
    entry = document.entry("accessors", index)
    values = _values(document, entry, index, width).astype(np.float64)
    kind = entry["componentType"]
    if not entry.get("normalized", False):
        return values
    if kind not in LARGEST:
        raise _damaged(index, "normalized numbers that are no small integers")
    return np.maximum(values / LARGEST[kind], -1.0)


def integers(document: Document, index: Any, width: int = 1) -> np.ndarray:
    """(n, width) int64 the values of an accessor of whole numbers."""
    entry = document.entry("accessors", index)
    if entry.get("componentType") == 5126:
        raise _damaged(index, "indices that are no integers")
    return _values(document, entry, index, width).astype(np.int64)


def count_of(document: Document, index: Any) -> int:
    """The number of elements of an accessor."""
    count = document.entry("accessors", index).get("count")
    if not isinstance(count, int) or count < 0:
        raise _damaged(index, "no count")
    return count


def _values(document: Document, entry: dict[str, Any], index: Any, width: int) -> np.ndarray:
    """(n, width) the values as they are stored, sparse ones put in place."""
    count, kind = count_of(document, index), entry.get("componentType")
    if kind not in TYPES or WIDTHS.get(str(entry.get("type"))) != width:
        raise _damaged(index, f"type {str(entry.get('type'))[:20]} of component {str(kind)[:20]}")
    dtype = np.dtype(TYPES[kind])
    sparse = entry.get("sparse")
    if "bufferView" in entry:
        values = _viewed(document, entry["bufferView"], entry.get("byteOffset", 0), dtype, count, width, index)
    elif sparse is None:
        raise _damaged(index, "no data, and no extension that would hold them")
    else:
        _check_size(document, count * width * dtype.itemsize, index)
        values = np.zeros((count, width), dtype)
    if sparse is None:
        return values
    changed = int(sparse["count"])
    where, what = sparse["indices"], sparse["values"]
    kinds = np.dtype(TYPES[where["componentType"]])
    places = _viewed(document, where["bufferView"], where.get("byteOffset", 0), kinds, changed, 1, index)[:, 0]
    if len(places) and places.max() >= count:
        raise _damaged(index, "sparse indices beyond its count")
    values = np.array(values)
    values[places] = _viewed(document, what["bufferView"], what.get("byteOffset", 0), dtype, changed, width, index)
    return values


def _check_size(document: Document, size: int, index: Any) -> None:
    """Raise MeshRefused for an accessor of zeros that is far larger than all that the file describes."""
    described = sum(int(entry.get("byteLength", 0)) for entry in document.entries("buffers") if isinstance(entry, dict))
    if size > 1000 * max(described, 1 << 16):
        raise _damaged(index, "more elements than its data explain")


def _viewed(
    document: Document, view_index: Any, offset: int, dtype: np.dtype, count: int, width: int, index: Any
) -> np.ndarray:
    """(count, width) values in a view of a buffer, `offset` bytes after its beginning."""
    view = document.entry("bufferViews", view_index)
    _check_meshopt(document, view)
    data = document.buffer(view.get("buffer", -1))
    size, begin = width * dtype.itemsize, view.get("byteOffset", 0) + offset
    stride = view.get("byteStride") or size
    end = min(len(data), view.get("byteOffset", 0) + view.get("byteLength", 0))
    if min(begin, offset) < 0 or stride < size or (count and begin + stride * (count - 1) + size > end):
        raise _damaged(index, "values beyond the end of their buffer")
    steps = (stride, dtype.itemsize)
    return np.array(np.ndarray((count, width), dtype, data, begin, steps)) if count else np.zeros((0, width), dtype)


def _check_meshopt(document: Document, view: dict[str, Any]) -> None:
    """Raise MeshRefused for a view whose only data are compressed by meshopt."""
    buffer = document.entry("buffers", view.get("buffer", -1))
    names = MESHOPT & view.get("extensions", {}).keys()
    if names and "uri" not in buffer and MESHOPT & buffer.get("extensions", {}).keys():
        raise MeshRefused(
            f"is stored with meshopt compression ({min(names)}), which is not supported: export it without"
        )


def _damaged(index: Any, what: str) -> MeshRefused:
    return MeshRefused(f"not readable as glTF: accessor {str(index)[:20]} has {what}")
