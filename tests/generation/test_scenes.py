"""Tests of scenes: recordings agree with an independent computation from the truth, and redraws are counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.json_rows import Row, pose_of
from kit1000.dataset.mcap_io import ObservationFile, TruthFile
from kit1000.dataset.scene_records import FIRST_CAVITY_LABEL
from kit1000.errors import Redraw
from kit1000.generation import scenes
from kit1000.generation.plan import draw_assembly_of
from kit1000.generation.scenes import MAX_LAYOUTS, MAX_VIEWS, GeneratedScene, make_scene
from kit1000.kits.assembly import build_assembly, check_assembly
from kit1000.kits.goals import nearest_about_axis
from kit1000.kits.kit import make_kit
from kit1000.kits.seating import InsertedPart, contact_offset, seating_result
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.pose import Pose, quaternion_angle
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA, in_view
from kit1000.sim.render import render
from kit1000.sim.visibility import MAX_SLOT_ANGLE, MIN_CAVITY_SHARE, MIN_PART_PIXELS, MIN_PART_SHARE, slot_visibility
from kit1000.testing import surface_distances
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, Assembly, Part, View
from tests.samples.mini import MINI

SEED, TARGET = 3, "test-0002"
FAMILY_NAMES = ("bracket", "tee", "channel", "foot")
NEAR = 0.2e-3  # [m] of a surface: a recorded depth is up to 0.06 mm off
SAMPLED_PIXELS = 200  # pixels of each body


@dataclass(frozen=True)
class SceneSample:
    """A scene with its assembly and parts."""

    assembly: Assembly
    parts: dict[str, Part]
    scene: GeneratedScene

    def again(self, **changes: Any) -> GeneratedScene:
        return make_scene(replace(MINI, **changes), SEED, "test", self.assembly, self.parts, True)

    @property
    def ideal(self) -> View:
        return self.scene.observation.views["ideal"]

    @property
    def labels(self) -> np.ndarray:
        assert self.scene.observation.labels is not None
        return self.scene.observation.labels

    def part(self, i: int) -> Part:
        return self.parts[self.scene.truth.parts[i]["part_id"]]

    def points(self, chosen: np.ndarray, most: int = SAMPLED_PIXELS) -> np.ndarray:
        """Points (n, 3) [m] in the world, of some pixels of a mask (H, W)."""
        v, u = np.nonzero(chosen)
        pick = np.linspace(0, len(v) - 1, min(most, len(v))).astype(int)
        v, u = v[pick], u[pick]
        rays = np.stack([(u - 639.5) / 925, (v - 359.5) / 925, np.ones(len(u))], axis=-1)
        return self.ideal.world_from_camera.apply(rays * self.ideal.depth[v, u, None])


@pytest.fixture(scope="module")
def sample() -> SceneSample:
    """Four kits with their parts."""
    drawn = {f"test-{k:04d}": FAMILIES[family].draw(np.random.default_rng(0)) for k, family in enumerate(FAMILY_NAMES)}
    parts = {i: make_part(i, family, drawn[i], 0.045) for i, family in zip(drawn, FAMILY_NAMES, strict=True)}
    kits = [make_kit(part) for part in parts.values()]
    for attempt in range(60):
        order, plan = draw_assembly_of(MINI, SEED, TARGET, len(kits), attempt)
        try:
            assembly = build_assembly(TARGET, [kits[i] for i in order], plan)
            check_assembly(assembly, parts)
        except Redraw:
            continue
        return SceneSample(assembly, parts, make_scene(MINI, SEED, "test", assembly, parts, True))
    raise AssertionError


def parts_of(made: GeneratedScene) -> list[Row]:
    return list(made.truth.parts)


def equal(one: GeneratedScene, other: GeneratedScene, sensors: tuple[str, ...] = ("ideal", "d415")) -> bool:
    """Whether two scenes are equal to the bit in the images of some sensors, parts and segmentation."""
    images = all(
        getattr(one, kind).views[key].depth.tobytes() == getattr(other, kind).views[key].depth.tobytes()
        for kind in ("observation", "extra_views")
        for key in getattr(one, kind).views
        if key.rpartition("/")[2] in sensors
    )
    return images and parts_of(one) == parts_of(other) and np.array_equal(one.truth.seg, other.truth.seg)


def test_a_scene_made_alone_is_the_one_in_the_shard(mini: Path) -> None:
    geometry = Geometry(mini)
    parts = {i: geometry.part(i) for i in geometry.parts}
    made = make_scene(MINI, MINI.seed, "train", geometry.assembly("train-0001"), parts, False)
    stored = ObservationFile(mini / "train/0000.mcap").observation("train-s0001")
    truth = TruthFile(mini / "train/0000.truth.mcap").truth("train-s0001")
    for key, view in stored.views.items():
        assert view.depth.tobytes() == made.observation.views[key].depth.tobytes()
    assert list(stored.queries) == list(made.observation.queries)
    assert (list(truth.parts), truth.queries, truth.models) == (parts_of(made), made.truth.queries, made.truth.models)
    assert np.array_equal(cast(np.ndarray, stored.labels), cast(np.ndarray, made.observation.labels))
    assert np.array_equal(truth.seg, made.truth.seg)


def test_the_tracks_change_neither_the_scene_nor_the_images(sample: SceneSample) -> None:
    fewer = sample.again(tracks=("snap",), curve_scenes=0)
    assert equal(fewer, sample.scene, ("ideal",))
    assert list(fewer.observation.views) == ["ideal"]
    wanted = [row for row in sample.scene.observation.queries if row["track"] == "snap"]
    assert list(fewer.observation.queries) == wanted != []
    assert fewer.truth.queries == {row["id"]: sample.scene.truth.queries[row["id"]] for row in wanted}


def test_noise_is_independent_for_each_sensor_and_camera(sample: SceneSample) -> None:
    assert sample.scene.extra_views is not None
    views = {**sample.scene.observation.views, **sample.scene.extra_views.views}
    errors = {}
    for key in ("", "three/0/", "three/1/", "three/2/"):
        ideal, measured = views[f"{key}ideal"].depth, views[f"{key}d415"].depth
        both = (ideal > 0) & (measured > 0)
        errors[key] = np.where(both, measured - ideal, 0)
        assert both.mean() > 0.5
        assert np.median(np.abs(errors[key][both])) < 10e-3
        assert errors[key][both].std() > 1e-4
    for one in errors:
        for other in errors:
            kept = (errors[one] != 0) & (errors[other] != 0)
            # a scale error is shared by no two pictures, so what is common must not be their noise
            assert one == other or abs(np.corrcoef(errors[one][kept], errors[other][kept])[0, 1]) < 0.5


def test_every_pixel_of_a_part_lies_on_it(sample: SceneSample) -> None:
    for i, row in enumerate(sample.scene.truth.parts):
        seen = sample.points(sample.labels == FIRST_PART_LABEL + i)
        assert len(seen) > 0
        assert (
            surface_distances(pose_of(row["world_from_part"]).inverse().apply(seen), sample.part(i).mesh).max() < NEAR
        )


def test_every_pixel_of_the_kits_lies_on_the_assembly(sample: SceneSample) -> None:
    seen = sample.points(sample.labels == ASSEMBLY_LABEL)
    assembly_from_world = sample.scene.truth.world_from_assembly.inverse()
    assert surface_distances(assembly_from_world.apply(seen), sample.assembly.mesh).max() < NEAR


def test_all_other_pixels_are_table_or_background(sample: SceneSample) -> None:
    seg = sample.scene.truth.seg
    assert np.abs(sample.points(seg == 1, 10_000)[:, 2]).max() < NEAR
    assert np.array_equal(seg == 0, sample.ideal.depth == 0)
    assert ((sample.labels == 0) == (seg <= 1)).all()


def test_masks_and_segmentation_agree(sample: SceneSample) -> None:
    seg, n = sample.scene.truth.seg, len(sample.parts)
    assert ((sample.labels == ASSEMBLY_LABEL) == ((seg == 2) | (seg >= FIRST_CAVITY_LABEL))).all()
    for i in range(n):
        assert ((sample.labels == FIRST_PART_LABEL + i) == (seg == 3 + i)).all()
        assert np.count_nonzero(seg == 3 + i) == sample.scene.truth.parts[i]["pixels"]
    assert set(np.unique(seg)) <= {0, 1, 2, *range(3, 3 + n), *range(FIRST_CAVITY_LABEL, FIRST_CAVITY_LABEL + n)}


def test_pixels_of_a_cavity_lie_inside_it_and_on_its_kit(sample: SceneSample) -> None:
    seg, world = sample.scene.truth.seg, sample.scene.truth.world_from_assembly
    for k, mount in enumerate(sample.assembly.mounts):
        chosen = seg == FIRST_CAVITY_LABEL + k
        if not chosen.any():
            continue
        points = (world @ mount.assembly_from_kit).inverse().apply(sample.points(chosen))
        assert (np.abs(points[:, :2]) < mount.kit.extent[:2] / 2).all()
        assert (points[:, 2] < 0).all()
        assert (points[:, 2] > -mount.kit.slot.depth - NEAR).all()
        assert surface_distances(points, mount.kit.mesh).max() < NEAR
    assert (seg >= FIRST_CAVITY_LABEL).any()


def test_the_index_of_a_part_does_not_depend_on_its_mount() -> None:
    counts = Counter(scenes.mount_order(1, f"test-s{k:04d}", 3) for k in range(1200))
    assert len(counts) == 6
    assert all(abs(count - 200) < 5 * np.sqrt(200) for count in counts.values())


def is_goal_of(slot: Any, world_from_kit: Pose, world_from_part: Pose) -> bool:
    """Whether a pose is one of the slot's goals, up to a rotation about the free axis."""
    found = world_from_kit.inverse() @ world_from_part
    goals = slot.goals if slot.free_axis is None else [nearest_about_axis(found, g, slot.free_axis) for g in slot.goals]
    return any(
        np.linalg.norm(found.xyz - goal.xyz) < 1e-9 and quaternion_angle(found.wxyz, goal.wxyz) < 1e-7 for goal in goals
    )


def test_every_drawn_goal_is_a_goal_of_the_slot_and_seats(sample: SceneSample) -> None:
    assert sample.scene.truth.queries
    standing = sample.assembly.mesh
    for truth in sample.scene.truth.queries.values():
        row = sample.scene.truth.parts[truth["part"]]
        mount, part = sample.assembly.mounts[row["mount"]], sample.part(truth["part"])
        world_from_goal = pose_of(truth["goal_drawn"]) @ pose_of(row["world_from_part"])
        assert is_goal_of(mount.kit.slot, pose_of(row["world_from_kit"]), world_from_goal)
        plug = InsertedPart.of(part.mesh, mount.kit.slot.kit_from_part)
        rise = contact_offset(plug, standing, sample.scene.truth.world_from_assembly.inverse() @ world_from_goal)
        at_goal = pose_of(row["world_from_kit"]).inverse() @ world_from_goal
        found = seating_result(rise, plug, at_goal, at_goal, mount.kit.slot.depth)
        assert found.seated
        assert found.strict


def test_goals_for_viewers_are_those_of_the_target(sample: SceneSample) -> None:
    (row,) = (row for row in sample.scene.truth.parts if row["part_id"] == TARGET)
    slot, goals = sample.assembly.mounts[row["mount"]].kit.slot, sample.scene.truth.goals
    assert goals is not None
    assert len(goals) == len(slot.goals)
    assert all(is_goal_of(slot, pose_of(row["world_from_kit"]), goal) for goal in goals)


def test_exactly_the_visible_parts_have_queries(sample: SceneSample, mini: Path) -> None:
    for scene in (sample, replace(sample, scene=sample.again(crowded=1.0)), *stored_plays(mini)):
        rows = scene.scene.truth.parts
        asked = {row["part"] for row in scene.scene.observation.queries}
        assert asked == {i for i, row in enumerate(rows) if row["unseen"] is None}
        for i, row in enumerate(rows):
            measured = seen_again(scene, i)
            assert measured["pixels"] == row["pixels"]
            assert measured["slot_visible"] == pytest.approx(row["slot_visible"], abs=2e-2)
            assert measured["visible"] == pytest.approx(row["visible"], abs=2e-3)
            assert measured["slot_angle"] == pytest.approx(row["slot_angle"], abs=1e-9)
            good = row["pixels"] >= MIN_PART_PIXELS and row["visible"] >= MIN_PART_SHARE
            assert (good and row["slot_angle"] <= MAX_SLOT_ANGLE and row["slot_visible"] >= MIN_CAVITY_SHARE) == (
                i in asked
            )


def stored_plays(root: Path) -> list[SceneSample]:
    geometry, plays = Geometry(root), []
    for shard, held in geometry.summary["shards"].items():
        for scene_id in held:
            truth = TruthFile(root / shard.replace(".mcap", ".truth.mcap")).truth(scene_id)
            parts = {row["part_id"]: geometry.part(row["part_id"]) for row in truth.parts}
            made = GeneratedScene(ObservationFile(root / shard).observation(scene_id), truth, None, ())
            plays.append(SceneSample(geometry.assembly(truth.assembly_id), parts, made))
    return plays


def seen_again(sample: SceneSample, i: int) -> dict[str, Any]:
    """The visibility of a part and its slot, computed from the masks, a rendering of the part alone, and vectors."""
    row, camera = sample.scene.truth.parts[i], sample.ideal.world_from_camera
    alone = render(CAMERA, camera, [(sample.part(i).mesh, pose_of(row["world_from_part"]))], threads=1).body_ids
    pixels = np.count_nonzero(sample.labels == FIRST_PART_LABEL + i)
    kit = pose_of(row["world_from_kit"])
    sight = (camera.xyz - kit.xyz) / np.linalg.norm(camera.xyz - kit.xyz)
    angle = np.arccos(np.clip(kit.rotation_matrix()[:, 2] @ sight, -1, 1))
    share = slot_visibility(sample.ideal.depth, CAMERA, camera, sample.assembly.mounts[row["mount"]].kit, kit).share
    return {"pixels": pixels, "visible": pixels / np.count_nonzero(alone), "slot_angle": angle, "slot_visible": share}


def test_the_target_is_drawn_once_in_every_track(sample: SceneSample) -> None:
    rows = sample.scene.observation.queries
    (target,) = (i for i, row in enumerate(sample.scene.truth.parts) if row["part_id"] == TARGET)
    for track in {row["track"] for row in rows} - {"curves"}:
        drawn = [row["part"] for row in rows if row["track"] == track and row["drawn"]]
        assert len(drawn) == 1
        assert drawn == [target] or target not in {row["part"] for row in rows if row["track"] == track}
    assert {row["part"] for row in rows if row["track"] == "curves"} == {target}


def test_the_tracks_of_the_paper_ask_only_where_parts_are_apart(sample: SceneSample) -> None:
    apart, crowded = sample.again(crowded=0.0), sample.again(crowded=1.0)
    asked = [{row["track"] for row in made.observation.queries} for made in (apart, crowded)]
    assert (apart.truth.crowded, crowded.truth.crowded) == (False, True)
    assert {"snap-tilt"} <= asked[0] - asked[1] <= {"snap-tilt", "place-paper"}
    assert "curves" in asked[1]


def test_all_bodies_are_in_view(sample: SceneSample) -> None:
    truth = sample.scene.truth
    bodies = [(sample.assembly.mesh, truth.world_from_assembly)]
    bodies += [(sample.part(i).mesh, pose_of(row["world_from_part"])) for i, row in enumerate(truth.parts)]
    assert all(in_view(CAMERA, sample.ideal.world_from_camera, pose.apply(mesh.vertices)) for mesh, pose in bodies)


def first(times: int, value: Any, real: Callable[..., Any]) -> Callable[..., Any]:
    """A function that returns or raises `value` a number of times, and then calls the original."""
    left = [times]

    def answer(*arguments: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            return real(*arguments)
        if isinstance(value, Exception):
            raise value
        return value

    return answer


def test_rejected_views_are_redrawn_and_counted(sample: SceneSample, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "view_redraw_reason", first(2, "slot turned away", scenes.view_redraw_reason))
    again = sample.again(tracks=("snap",))
    assert again.redraws[:2] == ("slot turned away", "slot turned away")
    assert again.observation.views["ideal"].world_from_camera.xyz != pytest.approx(sample.ideal.world_from_camera.xyz)
    assert again.truth.world_from_assembly.xyz == pytest.approx(sample.scene.truth.world_from_assembly.xyz)


def test_a_layout_without_a_valid_view_is_redrawn(sample: SceneSample, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "redraw_for", first(MAX_VIEWS, Redraw("part mostly hidden"), scenes.redraw_for))
    again = sample.again(tracks=("snap",))
    assert again.redraws[:MAX_VIEWS] == ("part mostly hidden",) * MAX_VIEWS
    assert again.truth.world_from_assembly.xyz != pytest.approx(sample.scene.truth.world_from_assembly.xyz)


def test_a_scene_without_a_valid_layout_is_refused_with_the_reason(
    sample: SceneSample, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenes, "simulate_layout", first(MAX_LAYOUTS, Redraw("parts touch"), scenes.simulate_layout))
    with pytest.raises(Redraw) as caught:
        sample.again()
    assert caught.value.reason == f"none of {MAX_LAYOUTS} layouts passes, mostly: parts touch"


def test_a_view_has_its_own_random_stream(sample: SceneSample, monkeypatch: pytest.MonkeyPatch) -> None:
    original = scenes.draw_primary_pose
    poses = []
    monkeypatch.setattr(scenes, "draw_primary_pose", lambda rng, *_: poses.append(original(rng)) or poses[-1])
    made = sample.again(tracks=("snap",), crowded=0.0)
    k = len(poses) - 1
    assert k < MAX_VIEWS
    alone = original(stream(SEED, "view", made.observation.scene_id, 0, k))
    assert alone.xyz == pytest.approx(made.observation.views["ideal"].world_from_camera.xyz, abs=0)
