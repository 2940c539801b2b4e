"""One scene from its draws: laid out, seen by a camera that shows what is asked, sensed, and asked about.

A layout or a view that fails is drawn again from the next attempt of its stream; why, is counted. Nothing here
touches a file, so any scene can be made again alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kit1000.dataset.mesh_files import glb_bytes
from kit1000.dataset.schema import Observation, SceneTruth
from kit1000.dataset.tables import Row, pose_row
from kit1000.errors import Redraw
from kit1000.generation.plan import rest_modes, scene_id_of
from kit1000.generation.presets import Preset
from kit1000.generation.queries import Asked, scene_queries
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA, camera_set, draw_primary, in_view
from kit1000.sim.layout import UNSTABLE, UPRIGHT, Layout, draw_layout, lay_out, table
from kit1000.sim.render import Frame, render
from kit1000.sim.sensors import sense
from kit1000.sim.visibility import PartSeen, SlotSeen, cavity_labels, part_seen, slot_angle, slot_seen, why_unseen
from kit1000.tracks import CURVES, has_curves
from kit1000.values import ASSEMBLY_LABEL, Assembly, Mount, Part, Slot, View

LAYOUTS = 60  # layouts of one scene before the draw or the rules must be called broken
VIEWS = 12  # views of one layout before it is drawn again
FIRST_CAVITY = 100  # in the segmentation: 100 + k is the cavity of mount k


@dataclass(frozen=True, eq=False)
class MadeScene:
    """All that is recorded of a scene."""

    observation: Observation
    truth: SceneTruth
    further: Observation | None
    """The camera set `three`, where it is stored."""
    redraws: tuple[str, ...]
    """Why layouts and views were rejected."""


@dataclass(frozen=True, eq=False)
class _Cast:
    """Who takes part in a scene: the parts in the order p0, p1, ..., each with its mount."""

    scene_id: str
    split: str
    seed: int
    sensors: tuple[str, ...]
    assembly: Assembly
    parts: tuple[Part, ...]
    mounts: tuple[int, ...]

    def mount(self, i: int) -> Mount:
        return self.assembly.mounts[self.mounts[i]]

    def slot(self, i: int) -> Slot:
        return self.mount(i).kit.slot

    @property
    def target(self) -> int:
        """The drawn target: the part after which the assembly is named."""
        return next(i for i, part in enumerate(self.parts) if part.id == self.assembly.id)


@dataclass(frozen=True, eq=False)
class _Stage:
    """A layout as the primary camera sees it."""

    modes: tuple[str, ...]
    layout: Layout
    world_from_kits: tuple[Pose, ...]
    """By part: of the kit that it belongs in."""
    world_from_camera: Pose
    frame: Frame
    parts: tuple[PartSeen, ...]
    slots: tuple[SlotSeen, ...]

    def unseen(self, i: int) -> str | None:
        return why_unseen(self.parts[i], self.slots[i])


def make_scene(
    preset: Preset, seed: int, split: str, assembly: Assembly, parts: Mapping[str, Part], further: bool
) -> MadeScene:
    """The scene of an assembly and its parts; `further` adds the camera set `three`. Raises Redraw when none passes."""
    cast = _cast(preset, seed, split, assembly, parts)
    stage, redraws = _staged(cast)
    views = _sensed(cast, "", stage.world_from_camera, stage.frame)
    labels = np.maximum(stage.frame.ids - 1, 0).astype(np.uint8)  # nothing and table both become 0
    labels.setflags(write=False)
    asked = [_asked(cast, stage, i) for i in range(len(cast.parts))]
    curves = has_curves(cast.scene_id, preset.curve_scenes)
    rows, drawn = scene_queries(cast.scene_id, split, seed, views, labels, asked, cast.target, curves)
    rows = [row for row in rows if row["track"] in (*preset.tracks, CURVES)]
    drawn = {row["id"]: drawn[row["id"]] for row in rows}
    truth = SceneTruth(
        cast.scene_id,
        assembly.id,
        stage.layout.world_from_assembly,
        tuple(_part_row(cast, stage, i) for i in range(len(cast.parts))),
        drawn,
        _segmented(cast, stage),
        _models(cast),
        stage.world_from_kits[cast.target] @ cast.slot(cast.target).goals,
    )
    observation = Observation(cast.scene_id, views, labels, tuple(rows))
    return MadeScene(observation, truth, _further(cast, stage.layout) if further else None, tuple(redraws))


def bodies(assembly: Assembly, parts: tuple[Part, ...], layout: Layout) -> list[tuple[Mesh, Pose]]:
    """What stands in a scene, for `render`: the table, the assembly, the parts in their order."""
    placed = zip((part.mesh for part in parts), layout.world_from_parts, strict=True)
    return [(table(), Pose.identity()), (assembly.mesh, layout.world_from_assembly), *placed]


def _cast(preset: Preset, seed: int, split: str, assembly: Assembly, parts: Mapping[str, Part]) -> _Cast:
    scene_id = scene_id_of(assembly.id)
    mounts = tuple(stream(seed, "order", scene_id).permutation(len(assembly.mounts)).tolist())
    order = tuple(parts[assembly.mounts[k].kit.slot.part_id] for k in mounts)
    return _Cast(scene_id, split, seed, preset.sensors, assembly, order, mounts)


def _staged(cast: _Cast) -> tuple[_Stage, list[str]]:
    """The first layout and view that show what must be seen, and why earlier ones did not."""
    redraws: list[str] = []
    slots = [cast.slot(i) for i in range(len(cast.parts))]
    for attempt in range(LAYOUTS):
        # A part that topples from its insertion face does so at every yaw, so how the parts lie is drawn again too.
        modes = rest_modes(cast.seed, cast.scene_id, len(cast.parts), redraws.count(UNSTABLE))
        draw = draw_layout(stream(cast.seed, "layout", cast.scene_id, attempt), modes)
        try:
            layout = lay_out(cast.assembly, list(zip(cast.parts, slots, strict=True)), draw)
        except Redraw as refusal:
            redraws.append(refusal.reason)
            continue
        for k in range(VIEWS):
            view = draw_primary(stream(cast.seed, "view", cast.scene_id, attempt, k))
            try:
                return _seen(cast, modes, layout, view), redraws
            except Redraw as refusal:
                redraws.append(refusal.reason)
    (commonest, _), *_ = Counter(redraws).most_common(1)
    raise Redraw(f"none of {LAYOUTS} layouts passes, mostly: {commonest}")


def _seen(cast: _Cast, modes: tuple[str, ...], layout: Layout, view: Pose) -> _Stage:
    """The stage, or Redraw: all in view, the target well seen, and a part for the tracks without a guess."""
    target, n = cast.target, range(len(cast.parts))
    world_from_kits = tuple(layout.world_from_assembly @ cast.mount(i).assembly_from_kit for i in n)
    first = SlotSeen(slot_angle(view, world_from_kits[target]), 1.0)  # before anything is drawn: the quick answer
    refused(why_unseen(PartSeen(CAMERA.width * CAMERA.height, 1.0), first))
    scene = bodies(cast.assembly, cast.parts, layout)
    if not all(in_view(CAMERA, view, pose.apply(mesh.vertices)) for mesh, pose in scene[1:]):
        raise Redraw("out of view")
    frame = render(CAMERA, view, scene, threads=1)
    parts = tuple(part_seen(frame, 2 + i, CAMERA, view, *scene[2 + i]) for i in n)
    slots = tuple(slot_seen(frame.depth, CAMERA, view, cast.mount(i).kit, world_from_kits[i]) for i in n)
    stage = _Stage(modes, layout, world_from_kits, view, frame, parts, slots)
    refused(stage.unseen(target))
    upright = [i for i in n if modes[i] == UPRIGHT]
    if upright and all(stage.unseen(i) for i in upright):
        raise Redraw("no upright part is well seen with its slot")
    return stage


def refused(reason: str | None) -> None:
    """Raise Redraw for a reason; nothing without one."""
    if reason is not None:
        raise Redraw(reason)


def _sensed(cast: _Cast, camera_key: str, world_from_camera: Pose, frame: Frame) -> dict[str, View]:
    """One view as every sensor records it, the noise of each from its own stream."""
    view = View(CAMERA, world_from_camera, frame.depth)
    prefix = f"{camera_key}/" if camera_key else ""
    return {
        prefix + sensor: sense(sensor, view, stream(cast.seed, "noise", cast.scene_id, camera_key, sensor))
        for sensor in cast.sensors
    }


def _further(cast: _Cast, layout: Layout) -> Observation:
    scene = bodies(cast.assembly, cast.parts, layout)
    views: dict[str, View] = {}
    for key, (camera, pose) in camera_set("three").items():
        views |= _sensed(cast, key, pose, render(camera, pose, scene, threads=1))
    return Observation(cast.scene_id, views)


def _asked(cast: _Cast, stage: _Stage, i: int) -> Asked:
    return Asked(
        i,
        stage.modes[i],
        stage.layout.world_from_parts[i],
        stage.world_from_kits[i],
        cast.slot(i),
        stage.unseen(i),
    )


def _part_row(cast: _Cast, stage: _Stage, i: int) -> Row:
    part, slot = stage.parts[i], stage.slots[i]
    return {
        "part_id": cast.parts[i].id,
        "family": cast.parts[i].family,
        "mount": cast.mounts[i],
        "rest_mode": stage.modes[i],
        "world_from_part": pose_row(stage.layout.world_from_parts[i]),
        "world_from_kit": pose_row(stage.world_from_kits[i]),
        "pixels": int(part.pixels),
        "visible": float(part.share),
        "slot_angle": float(slot.angle),
        "slot_visible": float(slot.share),
        "unseen": stage.unseen(i),
    }


def _segmented(cast: _Cast, stage: _Stage) -> np.ndarray:
    """(H, W) uint16, as `SceneTruth.seg` has it."""
    by_mount = np.argsort(cast.mounts).tolist()  # the part of each
    kits = [cast.mount(i).kit for i in by_mount]
    world_from_kits = [stage.world_from_kits[i] for i in by_mount]
    cavity = cavity_labels(stage.frame.depth, CAMERA, stage.world_from_camera, world_from_kits, kits)
    seg = stage.frame.ids.astype(np.uint16)
    inside = (stage.frame.ids == ASSEMBLY_LABEL + 1) & (cavity >= 0)
    seg[inside] = FIRST_CAVITY + cavity[inside]
    seg.setflags(write=False)
    return seg


def _models(cast: _Cast) -> dict[str, bytes]:
    models = {f"assemblies/{cast.assembly.id}": glb_bytes({cast.assembly.id: cast.assembly.mesh})}
    return models | {f"parts/{part.id}": glb_bytes({part.id: part.mesh}) for part in cast.parts}
