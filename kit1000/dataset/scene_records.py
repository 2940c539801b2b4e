"""What is recorded about a scene beside images and poses: the row of a part, the segmentation, and the models."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from kit1000.camera import Camera
from kit1000.dataset.json_rows import Row, pose_row
from kit1000.dataset.mesh_files import glb_bytes
from kit1000.pose import Pose
from kit1000.sim.render import RenderedImage
from kit1000.sim.visibility import PartVisibility, SlotVisibility, cavity_labels
from kit1000.values import ASSEMBLY_LABEL, Assembly, Kit, Part

FIRST_CAVITY_LABEL = 100  # in the segmentation: 100 + k is the cavity of mount k


def part_truth_row(
    part: Part,
    mount: int,
    rest_mode: str,
    world_from_part: Pose,
    world_from_kit: Pose,
    shown: PartVisibility,
    slot: SlotVisibility,
    unseen: str | None,
) -> Row:
    """The row of a part in the truth of a scene, see `SceneTruth.parts`.

    Args:
        part: the part.
        mount: index of its mount in the assembly.
        rest_mode: how it lies on the table.
        world_from_part: where it is.
        world_from_kit: where its kit is.
        shown: what the image shows of it.
        slot: what the image shows of its slot.
        unseen: why it or its slot is not visible enough for a query; None when both are.
    """
    return {
        "part_id": part.id,
        "family": part.family,
        "mount": mount,
        "rest_mode": rest_mode,
        "world_from_part": pose_row(world_from_part),
        "world_from_kit": pose_row(world_from_kit),
        "pixels": int(shown.pixels),
        "visible": float(shown.share),
        "slot_angle": float(slot.angle),
        "slot_visible": float(slot.share),
        "unseen": unseen,
    }


def segmentation(
    frame: RenderedImage,
    camera: Camera,
    world_from_camera: Pose,
    world_from_kits: Sequence[Pose],
    kits: Sequence[Kit],
    mounts: Sequence[int],
) -> np.ndarray:
    """(H, W) uint16, labels as in `SceneTruth.seg`.

    Args:
        frame: of the table, the assembly and the parts, in this order.
        camera: of the frame.
        world_from_camera: its pose.
        world_from_kits: poses of the kits whose cavities get labels.
        kits: these kits.
        mounts: their mounts.
    """
    cavity = cavity_labels(frame.depth, camera, world_from_camera, world_from_kits, kits)
    seg = frame.body_ids.astype(np.uint16)
    inside = (frame.body_ids == ASSEMBLY_LABEL + 1) & (cavity >= 0)
    seg[inside] = FIRST_CAVITY_LABEL + np.array(mounts, int)[cavity[inside]]
    seg.setflags(write=False)
    return seg


def scene_models(assembly: Assembly, parts: Iterable[Part]) -> dict[str, bytes]:
    """The GLB files of the bodies of a scene, see `SceneTruth.models`."""
    models = {f"assemblies/{assembly.id}": glb_bytes({assembly.id: assembly.mesh})}
    return models | {f"parts/{part.id}": glb_bytes({part.id: part.mesh}) for part in parts}
