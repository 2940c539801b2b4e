"""The JSON of a glTF file and its buffers: in the GLB, in further files beside it, or written into the JSON."""

from __future__ import annotations

import base64
import binascii
import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

from kit1000.errors import MeshRefused
from kit1000.parts.files.foreign_content import BYTE_ORDER_MARK, check_foreign, check_narrow

MAGIC = b"glTF"
CHUNK_JSON, CHUNK_BIN = b"JSON", b"BIN\0"
SCHEME = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]*:")
MAX_BUFFER = 1_500_000_000  # [bytes]


@dataclass(eq=False)
class Document:
    """A parsed glTF file."""

    json: dict[str, Any]
    binary: bytes | None
    """The binary chunk of a GLB."""
    folder: Path
    """Contents of further files."""
    _buffers: dict[int, bytes] = field(default_factory=dict)

    def entries(self, name: str) -> list[Any]:
        """A list at the top of the JSON, such as nodes; empty when absent."""
        found = self.json.get(name, [])
        return found if isinstance(found, list) else []

    def entry(self, name: str, index: Any) -> dict[str, Any]:
        """One entry of such a list. Raises MeshRefused when there is none."""
        entries = self.entries(name)
        if not isinstance(index, int) or not 0 <= index < len(entries) or not isinstance(entries[index], dict):
            raise MeshRefused(f"not readable as glTF: names {name}[{str(index)[:20]}], which does not exist")
        return entries[index]

    def buffer(self, index: int) -> bytes:
        """The bytes of a buffer."""
        if index not in self._buffers:
            entry = self.entry("buffers", index)
            data, length = self._bytes(index, entry.get("uri")), entry.get("byteLength", 0)
            if len(data) < length:
                raise MeshRefused(f"cut short: buffer {index} has {len(data):,} of {length:,} bytes")
            self._buffers[index] = data
        return self._buffers[index]

    def _bytes(self, index: int, address: Any) -> bytes:
        if address is None:
            if index != 0 or self.binary is None:
                raise MeshRefused(f"not readable as glTF: buffer {index} has no data")
            return self.binary
        if not isinstance(address, str):
            raise MeshRefused(f"not readable as glTF: buffer {index} has no address")
        return _of_data(address, index) if address[:5].lower() == "data:" else self._of_file(address)

    def _of_file(self, address: str) -> bytes:
        """The bytes of a further file; its name is percent-encoded, or as it is, or as Windows writes it."""
        if SCHEME.match(address) or address.startswith("//"):
            raise MeshRefused(f"its data lie at {address[:80]}: download that file and name it beside this one")
        plain = unquote(re.split(r"[?#]", address)[0])
        names = dict.fromkeys([unquote(address), address, plain, plain.replace("\\", "/")])
        path = next((path for name in names if "\0" not in name and (path := self.folder / name).is_file()), None)
        if path is None:
            raise MeshRefused(f"its data are in {unquote(address)[:80]}, which is missing: put that file beside it")
        if path.stat().st_size > MAX_BUFFER:
            raise MeshRefused(f"its data in {unquote(address)[:80]} have more than {MAX_BUFFER / 1e9:.1f} GB")
        try:
            data = path.read_bytes()
        except OSError as error:
            raise MeshRefused(
                f"its data in {unquote(address)[:80]} cannot be read: {error.strerror or error}"
            ) from None
        try:
            check_foreign(data)
        except MeshRefused as refused:
            raise MeshRefused(f"its data in {unquote(address)[:80]} are {refused.reason}") from None
        return data


def _of_data(address: str, index: int) -> bytes:
    """The bytes that an address itself contains."""
    kind, _, content = address.partition(",")
    try:
        if not kind.endswith(";base64"):
            return unquote_to_bytes(content)
        text = "".join(unquote(content).split())
        return base64.b64decode(text + "=" * (-len(text) % 4), validate=True)
    except (binascii.Error, ValueError):
        raise MeshRefused(f"not readable as glTF: the base64 of buffer {index} is damaged") from None


def read_document(data: bytes, folder: Path) -> Document:
    """The document of a .glb or .gltf file, which of the two its bytes say."""
    check_foreign(data)
    if data[:4] == MAGIC:
        text, binary = _chunks(data)
    else:
        check_narrow(data)
        text, binary = data.removeprefix(BYTE_ORDER_MARK), None
    try:
        parsed = json.loads(text)
    except (ValueError, RecursionError):
        parsed = None
    if not isinstance(parsed, dict):
        raise MeshRefused("not readable as glTF: its JSON part is damaged")
    asset = parsed.get("asset")
    version = str(asset.get("version", "2.0")) if isinstance(asset, dict) else "2.0"
    if not version.startswith("2."):
        raise MeshRefused(f"glTF of version {version[:20]}, expected 2.0: export it again")
    return Document(parsed, binary, folder)


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON and the binary chunk of a GLB."""
    version, length = (int.from_bytes(data[k : k + 4], "little") for k in (4, 8))
    if version != 2:
        raise MeshRefused(f"GLB of version {version}, expected 2: export it again as glTF 2.0")
    if len(data) < length:
        raise MeshRefused(f"not readable as GLB: cut short, {len(data):,} of {length:,} bytes")
    chunks: dict[bytes, bytes] = {}
    place = 12
    while place + 8 <= length:
        size, kind = int.from_bytes(data[place : place + 4], "little"), data[place + 4 : place + 8]
        if place + 8 + size > len(data):
            raise MeshRefused("not readable as GLB: cut short in a chunk")
        chunks.setdefault(kind, data[place + 8 : place + 8 + size])
        place += 8 + size
    if CHUNK_JSON not in chunks:
        raise MeshRefused("not readable as glTF: its JSON part is damaged")
    return chunks[CHUNK_JSON], chunks.get(CHUNK_BIN)
