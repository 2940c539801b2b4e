"""Small mesh files in the dialects of other programs: 3MF of slicers, glTF of exporters, and folders of such files."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
RELATIONSHIPS = (
    '<?xml version="1.0"?><Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="{target}" Id="r0" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
PART = trimesh.creation.box((30, 20, 10))  # the part of most files: 6000 mm3
PART.apply_translation((15, 10, 5))


def helper(at: float = 20, side: float = 8) -> trimesh.Trimesh:
    """A cube that overlaps the part from x = 20 on, or touches it."""
    cube = trimesh.creation.box((side, side, side))
    cube.apply_translation((at + side / 2, 10, 10))
    return cube


def cases() -> Path | None:
    """The folder of failing inputs that KIT1000_CASES names, else shared/cases beside the checkout; None without."""
    beside = Path(__file__).resolve().parents[3] / "shared/cases"
    folder = Path(os.environ.get("KIT1000_CASES") or beside)
    return folder if (folder / "README.md").is_file() else None


def written(path: Path, data: bytes) -> Path:
    """A file with its folders."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def mesh_xml(*meshes: trimesh.Trimesh) -> str:
    """Meshes as one mesh element, their triangles in order."""
    start, vertices, faces = 0, "", ""
    for mesh in meshes:
        vertices += "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in mesh.vertices)
        faces += "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces + start)
        start += len(mesh.vertices)
    return f"<mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh>"


def object_xml(number: int, inside: str, attributes: str = 'type="model"') -> str:
    return f'<object id="{number}" {attributes}>{inside}</object>'


def model_xml(objects: str, *items: str, attributes: str = 'unit="millimeter"') -> str:
    build = "".join(f"<item {item}/>" for item in items)
    return f'<model {attributes} xmlns="{CORE}"><resources>{objects}</resources><build>{build}</build></model>'


def archive(path: Path, model: str, more: Mapping[str, str] | None = None, root: str = "3D/3dmodel.model") -> Path:
    """A 3MF file: its root model under a name, and further parts."""
    with zipfile.ZipFile(path, "w") as file:
        for name, text in {"_rels/.rels": RELATIONSHIPS.format(target=f"/{root}"), root: model, **(more or {})}.items():
            file.writestr(name, text)
    return path


def slic3r_config(*volumes: tuple[int, int, str]) -> dict[str, str]:
    """The configuration of PrusaSlicer: first and last triangle, and type, of each volume of object 1."""
    rows = "".join(
        f'<volume firstid="{first}" lastid="{last}"><metadata type="volume" key="volume_type" value="{kind}"/></volume>'
        for first, last, kind in volumes
    )
    return {"Metadata/Slic3r_PE_model.config": f'<config><object id="1">{rows}</object></config>'}


class Gltf:
    """A glTF file in the making: accessors with their bytes, then a GLB."""

    def __init__(self) -> None:
        self.blob = b""
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}
        self.json |= {"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}

    def view(self, data: bytes, **more: Any) -> int:
        self.blob += b"\0" * (-len(self.blob) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data), **more})
        self.blob += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values: np.ndarray, component: int, **more: Any) -> int:
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.shape[1]]
        entry = {"bufferView": self.view(values.tobytes()), "componentType": component, "type": kind}
        self.json["accessors"].append({**entry, "count": len(values), **more})
        return len(self.json["accessors"]) - 1

    def mesh(self, mesh: trimesh.Trimesh, **more: Any) -> None:
        """The mesh as positions of float32 and indices of uint16, as the first one."""
        position = self.accessor(np.asarray(mesh.vertices, dtype="<f4"), 5126)
        indices = self.accessor(np.asarray(mesh.faces, dtype="<u2").reshape(-1, 1), 5123)
        self.json["meshes"] = [{"primitives": [{"attributes": {"POSITION": position}, "indices": indices, **more}]}]

    def glb(self, path: Path) -> Path:
        self.json.setdefault("buffers", [{"byteLength": len(self.blob)}])
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        binary = self.blob + b"\0" * (-len(self.blob) % 4)
        chunks = len(text).to_bytes(4, "little") + b"JSON" + text
        chunks += len(binary).to_bytes(4, "little") + b"BIN\0" + binary
        path.write_bytes(b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks)
        return path
