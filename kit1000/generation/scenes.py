"""Generation of one scene: layout of the bodies, camera view, depth images of all sensors, queries and ground truth.

A layout or a view that is rejected is redrawn from the next attempt of its random stream, and the reason is counted.
Nothing here reads or writes a file, so any scene can be made again by itself.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.dataset.json_rows import Row
from kit1000.dataset.scene_data import Observation, SceneTruth
from kit1000.dataset.scene_queries import PartInScene, asking_tracks, scene_queries
from kit1000.dataset.scene_records import part_truth_row, scene_models, segmentation
from kit1000.errors import Redraw
from kit1000.generation.plan import is_crowded, rest_modes, scene_id_of
from kit1000.generation.presets import Preset
from kit1000.mesh import Mesh
from kit1000.pictures.scene_preview import with_previews
from kit1000.pose import Pose
from kit1000.queries.tracks import CURVES, has_curves
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA, camera_set, draw_primary_pose, in_view
from kit1000.sim.layout import PART_UNSTABLE, UPRIGHT, Layout, draw_layout, simulate_layout, table
from kit1000.sim.render import RenderedImage, render
from kit1000.sim.sensors import SENSORS, conditions_of, measured_view
from kit1000.sim.visibility import (
    PartVisibility,
    SlotVisibility,
    part_visibility,
    slot_angle,
    slot_visibility,
    view_redraw_reason,
)
from kit1000.values import Assembly, Mount, Part, Slot, View

MAX_LAYOUTS = 60  # layouts of one scene before it is refused
MAX_VIEWS = 12  # views of one layout before the layout is redrawn
NOISE_DECIMALS = 4  # of the noise [px] that the truth states


@dataclass(frozen=True, eq=False)
class GeneratedScene:
    """Everything that is recorded of a scene."""

    observation: Observation
    truth: SceneTruth
    extra_views: Observation | None  # views of the camera set `three`; None if the split does not store them
    redraws: tuple[str, ...]  # reasons of the rejected layouts and views


@dataclass(frozen=True, eq=False)
class _SceneParts:
    """The assembly and the parts of a scene, in the order p0, p1, ..., each with its mount."""

    scene_id: str
    split: str
    seed: int
    preset: Preset
    crowded: bool
    assembly: Assembly
    parts: tuple[Part, ...]
    mounts: tuple[int, ...]

    def mount(self, i: int) -> Mount:
        return self.assembly.mounts[self.mounts[i]]

    def slot(self, i: int) -> Slot:
        return self.mount(i).kit.slot

    @property
    def target(self) -> int:
        """Index of the scene's target: the part whose id the assembly has."""
        return next(i for i, part in enumerate(self.parts) if part.id == self.assembly.id)


@dataclass(frozen=True, eq=False)
class _LayoutView:
    """A layout rendered from the primary camera, with the visibility of its parts and slots."""

    scene: _SceneParts
    modes: tuple[str, ...]
    layout: Layout
    world_from_kits: tuple[Pose, ...]  # pose of the kit of each part
    world_from_camera: Pose
    frame: RenderedImage
    parts: tuple[PartVisibility, ...]
    slots: tuple[SlotVisibility, ...]

    def invisibility(self, i: int) -> str | None:
        """Why part i or its slot is not visible enough for a query; None if both are."""
        return view_redraw_reason(self.parts[i], self.slots[i])

    def part(self, i: int) -> PartInScene:
        """Part i as a candidate for queries."""
        poses = self.layout.world_from_parts[i], self.world_from_kits[i]
        return PartInScene(i, self.modes[i], *poses, self.scene.slot(i), self.invisibility(i))

    def row(self, i: int) -> Row:
        """The row of part i in the truth."""
        poses = self.layout.world_from_parts[i], self.world_from_kits[i]
        seen = self.parts[i], self.slots[i], self.invisibility(i)
        return part_truth_row(self.scene.parts[i], self.scene.mounts[i], self.modes[i], *poses, *seen)

    def segmentation(self) -> np.ndarray:
        """(H, W) uint16, as in `SceneTruth.seg`."""
        by_mount = np.argsort(self.scene.mounts).tolist()  # index of the part of each mount
        kits = [self.scene.mount(i).kit for i in by_mount]
        world_from_kits = [self.world_from_kits[i] for i in by_mount]
        return segmentation(self.frame, CAMERA, self.world_from_camera, world_from_kits, kits, range(len(kits)))


def make_scene(
    preset: Preset, seed: int, split: str, assembly: Assembly, parts: Mapping[str, Part], extra_views: bool
) -> GeneratedScene:
    """The scene of an assembly and its parts; `extra_views` adds the camera set `three`.

    Raises Redraw if none of MAX_LAYOUTS layouts passes.
    """
    scene = _scene_parts(preset, seed, split, assembly, parts)
    shown, redraws = _draw_layout_and_view(scene)
    scene_id, target, n = scene.scene_id, scene.target, range(len(scene.parts))
    views, noise_px = _sensor_views(scene, preset.sensors_of(split), "", shown.world_from_camera, shown.frame)
    labels = np.maximum(shown.frame.body_ids - 1, 0).astype(np.uint8)  # nothing and table both become 0
    labels.setflags(write=False)
    in_scene = [shown.part(i) for i in n]
    alone = preset.one_track and split == "test"
    tracks = asking_tracks(scene_id, seed, preset.tracks_of(split), in_scene, crowded=scene.crowded, alone=alone)
    curves = (CURVES,) if has_curves(scene_id, preset.curve_scenes) else ()
    rows, truths = scene_queries(scene_id, seed, (*tracks, *curves), views, labels, in_scene, target)
    truth = SceneTruth(
        scene_id,
        assembly.id,
        shown.layout.world_from_assembly,
        tuple(shown.row(i) for i in n),
        truths,
        shown.segmentation(),
        scene_models(assembly, scene.parts),
        shown.world_from_kits[target] @ scene.slot(target).goals,
        scene.crowded,
        noise_px={sensor: noise for sensor, noise in noise_px.items() if noise > 0},
    )
    observation = Observation(scene_id, views, labels, tuple(rows))
    observation, truth = with_previews(observation, truth, scene.parts[target].mesh)
    extra = _extra_views(scene, shown.layout) if extra_views else None
    return GeneratedScene(observation, truth, extra, tuple(redraws))


def bodies(assembly: Assembly, parts: tuple[Part, ...], layout: Layout) -> list[tuple[Mesh, Pose]]:
    """Meshes with their `world_from_body`, for `render`: the table, the assembly, the parts in their order."""
    scene_parts = zip((part.mesh for part in parts), layout.world_from_parts, strict=True)
    return [(table(), Pose.identity()), (assembly.mesh, layout.world_from_assembly), *scene_parts]


def _scene_parts(preset: Preset, seed: int, split: str, assembly: Assembly, parts: Mapping[str, Part]) -> _SceneParts:
    scene_id = scene_id_of(assembly.id)
    mounts = mount_order(seed, scene_id, len(assembly.mounts))
    order = tuple(parts[assembly.mounts[k].kit.slot.part_id] for k in mounts)
    crowded = is_crowded(preset, seed, scene_id, len(order))
    return _SceneParts(scene_id, split, seed, preset, crowded, assembly, order, mounts)


def mount_order(seed: int, scene_id: str, count: int) -> tuple[int, ...]:
    """The mount of each part of a scene: an index says nothing about the place in the assembly."""
    return tuple(stream(seed, "order", scene_id).permutation(count).tolist())


def _draw_layout_and_view(scene_parts: _SceneParts) -> tuple[_LayoutView, list[str]]:
    """The first layout and view that pass, and the reasons of the rejected ones."""
    redraws: list[str] = []
    slots = [scene_parts.slot(i) for i in range(len(scene_parts.parts))]
    for attempt in range(MAX_LAYOUTS):
        # A part that topples from its insertion face does so at every yaw, so the rest modes are redrawn too.
        n, topplings = len(scene_parts.parts), redraws.count(PART_UNSTABLE)
        modes = rest_modes(scene_parts.preset, scene_parts.seed, scene_parts.scene_id, n, topplings)
        rng = stream(scene_parts.seed, "layout", scene_parts.scene_id, attempt)
        draw = draw_layout(rng, modes, scene_parts.crowded, scene_parts.preset.scale)
        try:
            layout = simulate_layout(scene_parts.assembly, list(zip(scene_parts.parts, slots, strict=True)), draw)
        except Redraw as refusal:
            redraws.append(refusal.reason)
            continue
        for k in range(MAX_VIEWS):
            rng = stream(scene_parts.seed, "view", scene_parts.scene_id, attempt, k)
            view = draw_primary_pose(rng, scene_parts.crowded, scene_parts.preset.scale)
            try:
                return _view_layout(scene_parts, modes, layout, view), redraws
            except Redraw as refusal:
                redraws.append(refusal.reason)
    (commonest, _), *_ = Counter(redraws).most_common(1)
    raise Redraw(f"none of {MAX_LAYOUTS} layouts passes, mostly: {commonest}")


def _view_layout(scene_parts: _SceneParts, modes: tuple[str, ...], layout: Layout, view: Pose) -> _LayoutView:
    """The layout seen from a camera pose.

    Raises Redraw unless all bodies are in view, the target and its slot are visible enough, and so is an upright part
    with its slot if there is an upright part.
    """
    target, n = scene_parts.target, range(len(scene_parts.parts))
    world_from_kits = tuple(layout.world_from_assembly @ scene_parts.mount(i).assembly_from_kit for i in n)
    first = SlotVisibility(slot_angle(view, world_from_kits[target]), 1.0)  # the cheapest test, before rendering
    redraw_for(view_redraw_reason(PartVisibility(CAMERA.width * CAMERA.height, 1.0), first))
    scene = bodies(scene_parts.assembly, scene_parts.parts, layout)
    if not all(in_view(CAMERA, view, pose.apply(mesh.vertices)) for mesh, pose in scene[1:]):
        raise Redraw("out of view")
    frame = render(CAMERA, view, scene, threads=1)
    parts = tuple(part_visibility(frame, 2 + i, CAMERA, view, *scene[2 + i]) for i in n)
    slots = tuple(slot_visibility(frame.depth, CAMERA, view, scene_parts.mount(i).kit, world_from_kits[i]) for i in n)
    shown = _LayoutView(scene_parts, modes, layout, world_from_kits, view, frame, parts, slots)
    redraw_for(shown.invisibility(target))
    upright = [i for i in n if modes[i] == UPRIGHT]
    if upright and all(shown.invisibility(i) for i in upright):
        raise Redraw("no upright part is well seen with its slot")
    return shown


def redraw_for(reason: str | None) -> None:
    """Raise Redraw for a reason; nothing without one."""
    if reason is not None:
        raise Redraw(reason)


def _sensor_views(
    scene_parts: _SceneParts, sensors: Sequence[str], camera_key: str, world_from_camera: Pose, frame: RenderedImage
) -> tuple[dict[str, View], dict[str, float]]:
    """The depth images of some sensors from one camera pose, the noise of each from its own stream; its RMS [px]."""
    view = View(CAMERA, world_from_camera, frame.depth)
    prefix = f"{camera_key}/" if camera_key else ""
    views, noise_px = {}, {}
    for name in sensors:
        rng = stream(scene_parts.seed, "noise", scene_parts.scene_id, camera_key, name)
        conditions = conditions_of(SENSORS[name], rng, scene_parts.preset.frames)
        views[prefix + name] = measured_view(SENSORS[name], view, conditions, rng)
        noise_px[name] = round(conditions.left_px, NOISE_DECIMALS)
    return views, noise_px


def _extra_views(scene_parts: _SceneParts, layout: Layout) -> Observation:
    scene = bodies(scene_parts.assembly, scene_parts.parts, layout)
    views: dict[str, View] = {}
    sensors = scene_parts.preset.sensors_of(scene_parts.split)
    for key, (camera, pose) in camera_set("three", scale=scene_parts.preset.scale).items():
        views |= _sensor_views(scene_parts, sensors, key, pose, render(camera, pose, scene, threads=1))[0]
    return Observation(scene_parts.scene_id, views)
