"""Pictures of parts, kits and assemblies as PNG bytes: a preview of one kit, contact sheets of a dataset."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image

from kit1000.kits.seating import HOVER
from kit1000.pictures.shading import KIT, PART, SECONDARY, Painted, contact_sheet, framing, shaded
from kit1000.pose import Pose
from kit1000.values import Assembly, Kit, Part

TILE = (420, 340)  # [px] one picture of a contact sheet
WIDE = (1280, 640)  # [px] a preview
LIFTED = 0.45  # of HOVER: the part above its cavity in a preview
SIDE = 1.15  # plates between the two halves of a preview, in plate widths


def kit_picture(part: Part, kit: Kit) -> bytes:
    """The part above its cavity, and beside it the part seated."""
    apart = np.array([kit.extent[0] * SIDE, 0, 0])
    lifted = Pose.from_translation(np.array([0, 0, LIFTED * HOVER])) @ kit.slot.kit_from_part
    seated = Pose.from_translation(apart) @ kit.slot.kit_from_part
    return _png(
        _drawn(
            [
                Painted(kit.mesh, Pose.identity(), KIT),
                Painted(part.mesh, lifted, PART),
                Painted(kit.mesh, Pose.from_translation(apart), KIT),
                Painted(part.mesh, seated, PART),
            ],
            WIDE,
        )
    )


def part_tile(part: Part) -> np.ndarray:
    """One part as it was drawn, standing on its lowest point."""
    return _drawn([Painted(part.mesh, Pose.identity(), PART)], TILE)


def kit_tile(part: Part, kit: Kit) -> np.ndarray:
    """One kit, its part hovering above."""
    lifted = Pose.from_translation(np.array([0, 0, LIFTED * HOVER])) @ kit.slot.kit_from_part
    return _drawn([Painted(kit.mesh, Pose.identity(), KIT), Painted(part.mesh, lifted, PART)], TILE)


def assembly_tile(assembly: Assembly, parts: Mapping[str, Part], size: tuple[int, int] = TILE) -> np.ndarray:
    """One assembly with its parts, every other one hovering above its cavity."""
    bodies = [Painted(assembly.mesh, Pose.identity(), KIT)]
    for i, mount in enumerate(assembly.mounts):
        out = Pose.from_translation(np.array([0, 0, (0.0, 0.3)[i % 2] * HOVER]))
        pose = mount.assembly_from_kit @ out @ mount.kit.slot.kit_from_part
        bodies.append(Painted(parts[mount.kit.slot.part_id].mesh, pose, (PART, *SECONDARY)[i % 7]))
    return _drawn(bodies, size)


def sheet(tiles: Sequence[np.ndarray | Image.Image], labels: Sequence[str], columns: int = 6) -> bytes:
    """Tiles with their captions as one PNG."""
    return _png(contact_sheet(tiles, labels, columns))


def _drawn(bodies: list[Painted], size: tuple[int, int]) -> np.ndarray:
    camera, eye = framing(bodies, size=size)
    return shaded(bodies, camera, eye)


def _png(image: np.ndarray | Image.Image) -> bytes:
    buffer = io.BytesIO()
    picture = image if isinstance(image, Image.Image) else Image.fromarray(image)
    picture.save(buffer, "PNG", optimize=False)
    return buffer.getvalue()
