"""Mesh files: GLB (metres, y up, as in glTF) and STL (millimetres, z up, as in slicers).

Vertices are multiples of float32 steps, so a mesh read back equals the one written to the bit.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np
import trimesh
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

from kit1000.errors import InputError
from kit1000.mesh import Mesh, y_up, z_up


def glb_bytes(bodies: Mapping[str, Mesh], colours: Mapping[str, tuple[int, int, int]] | None = None) -> bytes:
    """Named bodies as one GLB. `colours`: sRGB 0..255 by name; bodies without one get no material."""
    scene = trimesh.Scene()
    for name, mesh in bodies.items():
        body = trimesh.Trimesh(y_up(mesh.vertices), mesh.faces, process=False)
        if colours and name in colours:
            linear = [(c / 255) ** 2.2 for c in colours[name]]
            material = PBRMaterial(
                baseColorFactor=[*linear, 1.0], metallicFactor=0.0, roughnessFactor=0.6, doubleSided=False
            )
            body.visual = TextureVisuals(material=material)
        scene.add_geometry(body, node_name=name, geom_name=name)
    return cast(bytes, scene.export(file_type="glb"))


def read_glb(path: Path) -> dict[str, Mesh]:
    """The bodies of a GLB written by `glb_bytes`, by name. Raises InputError for anything else."""
    try:
        scene = trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type="glb", process=False)
        return {
            str(name): Mesh(z_up(np.asarray(body.vertices, dtype=np.float64)), body.faces)  # type: ignore[union-attr]
            for name, body in scene.geometry.items()
        }
    except FileNotFoundError:
        raise InputError(f"no file {path}") from None
    except Exception as error:  # the reader of trimesh may raise anything on damaged bytes
        raise InputError(f"cannot read {path}: damaged or no GLB ({type(error).__name__}: {error})") from error


def stl_bytes(mesh: Mesh) -> bytes:
    """A mesh as a binary STL in millimetres, z up, ready for a slicer."""
    body = trimesh.Trimesh(mesh.vertices * 1e3, mesh.faces, process=False)
    return cast(bytes, body.export(file_type="stl"))
