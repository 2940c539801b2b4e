"""From the confirmed labels of a scene to its ground truth, as generated scenes have it.

The world of an own scene is defined by its table, as the image measured it. Truth is in true lengths: the camera is put
where it is once depths are divided by their scale, so that the table stays at z = 0. Methods see the image as it is;
what the scale shifts is an error of the camera, and of theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from kit1000.dataset.json_rows import Row
from kit1000.dataset.scene_data import Observation, SceneTruth
from kit1000.dataset.scene_queries import PartInScene, asked_query, eligible
from kit1000.dataset.scene_records import part_truth_row, scene_models, segmentation
from kit1000.errors import InputError
from kit1000.known_shapes.known_kits import KITS, KnownKits
from kit1000.labelling.label_records import LabelRecord
from kit1000.pictures.scene_preview import scene_picture, with_previews
from kit1000.pose import Pose
from kit1000.queries.pivots import part_pivots
from kit1000.queries.tracks import TRACKS, query_id
from kit1000.rng import stream
from kit1000.sim.footprints import footprint, footprint_distance
from kit1000.sim.layout import MIN_GAP, TUMBLED, UPRIGHT, table
from kit1000.sim.render import RenderedImage, render
from kit1000.sim.visibility import part_visibility, slot_visibility, view_redraw_reason
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, Mount, Part, View

UPRIGHT_ANGLE = np.radians(10)  # from the insertion face down, up to which a part lies on it
SEED = 0  # of all draws: equal labels give equal queries


@dataclass(frozen=True, eq=False)
class _Placed:
    """A part with its slot in the world."""

    part: Part
    mount: Mount
    number: int
    """Index of the mount in the assembly."""
    label: int
    """Its value in the masks before they are made dense."""
    world_from_part: Pose
    world_from_kit: Pose

    @property
    def rest_mode(self) -> str:
        out = self.mount.kit.slot.kit_from_part.inverse().rotate((0.0, 0.0, 1.0))
        tilt = float(np.arccos(np.clip(self.world_from_part.rotate(out)[2], -1, 1)))
        return UPRIGHT if tilt < UPRIGHT_ANGLE else TUMBLED


def true_camera(view: View, scale: float) -> Pose:
    """world_from_camera in true lengths, where measured depths are `scale` times the true ones."""
    return Pose(view.world_from_camera.wxyz, view.world_from_camera.xyz / scale)


def labelled_scene(
    observation: Observation, record: LabelRecord, kits: KnownKits, tracks: Sequence[str]
) -> tuple[Observation, SceneTruth]:
    """The observation with the masks and queries of its labelled parts alone, and its ground truth.

    Raises InputError if a body is not confirmed, or belongs to another image.
    """
    waiting = [body.name for body in record.bodies if not body.confirmed_by]
    if waiting:
        raise InputError(f"{record.scene_id}: {', '.join(waiting)} not confirmed: look at the picture, then --confirm")
    if observation.labels is None or record.view not in observation.views:
        raise InputError(f"{record.scene_id}: its recording has no view {record.view!r} with masks: label it again")
    view = observation.views[record.view]
    camera_pose = true_camera(view, record.scale)
    poses = {body.name: camera_pose @ body.camera_from_body for body in record.bodies}
    world_from_assembly = poses.pop(KITS)
    placed = [_placed(kits, record, name, pose, world_from_assembly) for name, pose in poses.items()]
    placed.sort(key=lambda each: each.label)
    labels = _dense(observation.labels, [each.label for each in placed])
    bodies = [(table(), Pose.identity()), (kits.assembly.mesh, world_from_assembly)]
    bodies += [(each.part.mesh, each.world_from_part) for each in placed]
    frame = render(view.camera, camera_pose, bodies, threads=1)
    for i in range(len(placed)):  # a part that no mask shows has the pixels that its shape shows
        if not (labels == FIRST_PART_LABEL + i).any():
            labels = np.where(frame.body_ids == 3 + i, np.uint8(FIRST_PART_LABEL + i), labels)
    rows, asked = _part_rows(placed, frame, view, camera_pose, labels)
    queries, truths = real_queries(record.scene_id, tracks, record.view, view, labels, asked)
    target = next((each for each in placed if each.part.id == kits.assembly.id), None)
    truth = SceneTruth(
        scene_id=record.scene_id,
        assembly_id=kits.assembly.id,
        world_from_assembly=world_from_assembly,
        parts=tuple(rows),
        queries=truths,
        seg=_segmentation(frame, view, camera_pose, placed),
        models=scene_models(kits.assembly, [each.part for each in placed]),
        goals=None if target is None else target.world_from_kit @ target.mount.kit.slot.goals,
        crowded=_crowded(placed),
    )
    seen = replace(observation, labels=labels, queries=tuple(queries), preview=None)
    if target is None:
        return replace(seen, preview=scene_picture(seen)), truth
    return with_previews(seen, truth, target.part.mesh)


def _placed(kits: KnownKits, record: LabelRecord, name: str, pose: Pose, world_from_assembly: Pose) -> _Placed:
    number = next(i for i, mount in enumerate(kits.assembly.mounts) if mount.kit.slot.part_id == kits.part(name).id)
    mount = kits.assembly.mounts[number]
    label = next(body.label for body in record.bodies if body.name == name)
    return _Placed(kits.part(name), mount, number, label, pose, world_from_assembly @ mount.assembly_from_kit)


def _dense(labels: np.ndarray, kept: Sequence[int]) -> np.ndarray:
    """(H, W) uint8 masks in which the kept parts are p0, p1, ... and bodies without a shape are background."""
    lookup = np.zeros(256, np.uint8)
    lookup[ASSEMBLY_LABEL] = ASSEMBLY_LABEL
    lookup[list(kept)] = FIRST_PART_LABEL + np.arange(len(kept))
    return lookup[labels]


def _part_rows(
    placed: Sequence[_Placed], frame: RenderedImage, view: View, camera_pose: Pose, labels: np.ndarray
) -> tuple[list[Row], list[PartInScene]]:
    """The rows of the truth, and what queries need; as `kit1000.generation.scenes` writes them."""
    rows, asked, pivots = [], [], part_pivots(view, labels)
    for i, each in enumerate(placed):
        shown = part_visibility(frame, 2 + i, view.camera, camera_pose, each.part.mesh, each.world_from_part)
        slot = slot_visibility(frame.depth, view.camera, camera_pose, each.mount.kit, each.world_from_kit)
        unseen = view_redraw_reason(shown, slot) or (None if i in pivots else "no depth on the part")
        poses = (each.rest_mode, each.world_from_part, each.world_from_kit)
        rows.append(part_truth_row(each.part, each.number, *poses, shown, slot, unseen))
        asked.append(PartInScene(i, *poses, each.mount.kit.slot, unseen))
    return rows, asked


def _segmentation(frame: RenderedImage, view: View, camera_pose: Pose, placed: Sequence[_Placed]) -> np.ndarray:
    """(H, W) uint16, labels as in `SceneTruth.seg`."""
    kits, poses = [each.mount.kit for each in placed], [each.world_from_kit for each in placed]
    return segmentation(frame, view.camera, camera_pose, poses, kits, [each.number for each in placed])


def _crowded(placed: Sequence[_Placed]) -> bool:
    outlines = [footprint(each.part.mesh, each.world_from_part) for each in placed]
    return any(footprint_distance(a, b) < MIN_GAP for a, b in combinations(outlines, 2))


def real_queries(
    scene_id: str, tracks: Sequence[str], sensor: str, view: View, labels: np.ndarray, parts: Sequence[PartInScene]
) -> tuple[list[Row], dict[str, Row]]:
    """The query rows of a scene and, by query id, their truth; both as in `kit1000.dataset.scene_data`.

    Args:
        scene_id: such as test-s0007.
        tracks: the tracks of the folder.
        sensor: key of the view.
        view: the depth image.
        labels: (H, W) uint8 masks, see `kit1000.values.LabelledDepth`.
        parts: those of the scene, in their order.
    """
    pivots = part_pivots(view, labels)
    visible = [part for part in parts if part.invisibility is None and part.index in pivots]
    rows: list[Row] = []
    truths: dict[str, Row] = {}
    for name in tracks:
        asked = [part for part in visible if eligible(TRACKS[name], part)]
        drawn = int(stream(SEED, "labelled", scene_id, name, "drawn").integers(len(asked))) if asked else None
        for number, part in enumerate(asked):
            identity, rng = query_id(scene_id, part.index, name), stream(SEED, "labelled", scene_id, part.index, name)
            query = asked_query(identity, TRACKS[name], sensor, part, pivots[part.index], rng)
            rows.append(query.row(number == drawn))
            truths[identity] = query.truth
    return rows, truths
