"""Pictures of parts, kits and assemblies: the preview of one kit, and the tiles of contact sheets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from kit1000.dataset.png_files import QUICK_COMPRESSION, png_bytes
from kit1000.kits.seating import HOVER
from kit1000.pictures.shading import KIT, PART, ColouredBody, contact_sheet, framing_camera, part_colour, shaded_picture
from kit1000.pose import Pose
from kit1000.values import Assembly, Kit, Part

if TYPE_CHECKING:
    from PIL import Image

TILE_SIZE = (420, 340)  # [px] of a tile of a contact sheet
PREVIEW_SIZE = (1024, 512)  # [px]
LIFT_SHARE = 0.45  # of HOVER: height of a part above its cavity
PAIR_SPACING = 1.15  # between the two kits of a preview, in plate widths


def kit_preview(part: Part, kit: Kit) -> bytes:
    """A PNG of the part above its cavity, and beside it of the seated part."""
    spacing = np.array([kit.extent[0] * PAIR_SPACING, 0, 0])
    lifted = Pose.from_translation(np.array([0, 0, LIFT_SHARE * HOVER])) @ kit.slot.kit_from_part
    seated = Pose.from_translation(spacing) @ kit.slot.kit_from_part
    return _png(
        _picture(
            [
                ColouredBody(kit.mesh, Pose.identity(), KIT),
                ColouredBody(part.mesh, lifted, PART),
                ColouredBody(kit.mesh, Pose.from_translation(spacing), KIT),
                ColouredBody(part.mesh, seated, PART),
            ],
            PREVIEW_SIZE,
        )
    )


def part_tile(part: Part) -> np.ndarray:
    """A picture of one part in its own frame, on its lowest point. (H, W, 3) uint8 sRGB, like all tiles."""
    return _picture([ColouredBody(part.mesh, Pose.identity(), PART)], TILE_SIZE)


def kit_tile(part: Part, kit: Kit) -> np.ndarray:
    """A picture of one kit with its part above the cavity."""
    lifted = Pose.from_translation(np.array([0, 0, LIFT_SHARE * HOVER])) @ kit.slot.kit_from_part
    return _picture([ColouredBody(kit.mesh, Pose.identity(), KIT), ColouredBody(part.mesh, lifted, PART)], TILE_SIZE)


def assembly_tile(assembly: Assembly, parts: Mapping[str, Part], size: tuple[int, int] = TILE_SIZE) -> np.ndarray:
    """A picture of one assembly with its parts, every other one above its cavity."""
    bodies = [ColouredBody(assembly.mesh, Pose.identity(), KIT)]
    for i, mount in enumerate(assembly.mounts):
        out = Pose.from_translation(np.array([0, 0, (0.0, 0.3)[i % 2] * HOVER]))
        pose = mount.assembly_from_kit @ out @ mount.kit.slot.kit_from_part
        bodies.append(ColouredBody(parts[mount.kit.slot.part_id].mesh, pose, part_colour(i)))
    return _picture(bodies, size)


def contact_sheet_png(tiles: Sequence[np.ndarray | Image.Image], labels: Sequence[str], columns: int = 6) -> bytes:
    """A PNG of tiles with their captions."""
    return _png(contact_sheet(tiles, labels, columns))


def _picture(bodies: list[ColouredBody], size: tuple[int, int]) -> np.ndarray:
    camera, world_from_camera = framing_camera(bodies, size=size)
    return shaded_picture(bodies, camera, world_from_camera)


def _png(image: np.ndarray | Image.Image) -> bytes:
    return png_bytes(np.asarray(image), QUICK_COMPRESSION, software="kit1000")
