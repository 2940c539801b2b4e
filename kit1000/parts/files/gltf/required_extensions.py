"""Extensions of glTF: those that are read, those that do not touch the shape, and all others, refused when required."""

from __future__ import annotations

from typing import Any

from kit1000.errors import MeshRefused

DRACO = "KHR_draco_mesh_compression"
MESHOPT = {"EXT_meshopt_compression", "KHR_meshopt_compression"}
INSTANCES = "EXT_mesh_gpu_instancing"
VISIBILITY = "KHR_node_visibility"
QUANTIZATION = "KHR_mesh_quantization"
READ = {INSTANCES, VISIBILITY, QUANTIZATION}
SHAPELESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "EXT_lights_", "KHR_lights_", "KHR_xmp", "MSFT_texture_")
SHAPELESS += ("MSFT_packing_", "KHR_animation_pointer", "ADOBE_materials_", "EXT_materials_", "FB_ngon_encoding")
"""Beginnings of the names of extensions that say nothing about where the surface is."""
WITHOUT = {DRACO: "Draco compression"} | dict.fromkeys(MESHOPT, "meshopt compression")


def check_required(json: dict[str, Any]) -> None:
    """Raise MeshRefused, by name, when a file requires an extension without which it would be read wrong."""
    required = json.get("extensionsRequired", [])
    for name in required if isinstance(required, list) else []:
        name = str(name)
        if name in WITHOUT:
            raise MeshRefused(f"is stored with {WITHOUT[name]} ({name}), which is not supported: export it without")
        if name not in READ and not name.startswith(SHAPELESS):
            raise MeshRefused(f"requires the glTF extension {name[:80]}, which is not supported: export it without")
