"""Laws of scenes: what is recorded agrees with what is so, worked out another way, and every redraw is counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from mini import MINI

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.mcap_io import ObservationFile, TruthFile
from kit1000.dataset.tables import Row, pose_of
from kit1000.errors import Redraw
from kit1000.generation import scenes
from kit1000.generation.plan import draw_assembly_of
from kit1000.generation.scenes import FIRST_CAVITY_LABEL, MAX_LAYOUTS, MAX_VIEWS, GeneratedScene, make_scene
from kit1000.kits.assembly import build_assembly, check_assembly
from kit1000.kits.contact import convex_edges
from kit1000.kits.goals import nearest_about_axis
from kit1000.kits.kit import make_kit
from kit1000.kits.seating import InsertedPart, contact_offset, seating_result
from kit1000.parts.catalog import FAMILIES
from kit1000.parts.family import make_part
from kit1000.pose import Pose, quaternion_angle
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA, in_view
from kit1000.sim.layout import UPRIGHT
from kit1000.sim.render import render
from kit1000.sim.visibility import MAX_SLOT_ANGLE, MIN_CAVITY_SHARE, MIN_PART_PIXELS, MIN_PART_SHARE, slot_visibility
from kit1000.testing import surface_distances
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, Assembly, Part, View

SEED, TARGET = 3, "test-0002"
CAST = ("bracket", "tee", "channel", "foot")
NEAR = 0.2e-3  # [m] of a surface: a recorded depth is up to 0.06 mm off
LOOKED_AT = 200  # pixels of each body


@dataclass(frozen=True)
class Play:
    """A scene with all that it was made of."""

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

    def points(self, chosen: np.ndarray, most: int = LOOKED_AT) -> np.ndarray:
        """(n, 3) [m] world: what some of the pixels in a mask (H, W) see."""
        v, u = np.nonzero(chosen)
        pick = np.linspace(0, len(v) - 1, min(most, len(v))).astype(int)
        v, u = v[pick], u[pick]
        rays = np.stack([(u - 639.5) / 925, (v - 359.5) / 925, np.ones(len(u))], axis=-1)
        return self.ideal.world_from_camera.apply(rays * self.ideal.depth[v, u, None])


@pytest.fixture(scope="module")
def play() -> Play:
    """Four kits with their parts."""
    drawn = {f"test-{k:04d}": FAMILIES[family].draw(np.random.default_rng(0)) for k, family in enumerate(CAST)}
    parts = {i: make_part(i, family, drawn[i], 0.045) for i, family in zip(drawn, CAST, strict=True)}
    kits = [make_kit(part) for part in parts.values()]
    for attempt in range(60):
        draw = draw_assembly_of(MINI, SEED, TARGET, len(kits), attempt)
        try:
            assembly = build_assembly(TARGET, [kits[i] for i in draw.order], draw.placement)
            check_assembly(assembly, parts)
        except Redraw:
            continue
        return Play(assembly, parts, make_scene(MINI, SEED, "test", assembly, parts, True))
    raise AssertionError


def cast_of(made: GeneratedScene) -> list[Row]:
    return list(made.truth.parts)


def alike(one: GeneratedScene, other: GeneratedScene, sensors: tuple[str, ...] = ("ideal", "d415")) -> bool:
    """To the bit, as far as some sensors go."""
    images = all(
        getattr(one, kind).views[key].depth.tobytes() == getattr(other, kind).views[key].depth.tobytes()
        for kind in ("observation", "extra_views")
        for key in getattr(one, kind).views
        if key.rpartition("/")[2] in sensors
    )
    return images and cast_of(one) == cast_of(other) and np.array_equal(one.truth.seg, other.truth.seg)


def test_a_scene_made_alone_is_the_one_in_the_shard(mini: Path) -> None:
    geometry = Geometry(mini)
    parts = {i: geometry.part(i) for i in geometry.parts}
    made = make_scene(MINI, MINI.seed, "train", geometry.assembly("train-0001"), parts, False)
    stored = ObservationFile(mini / "train/0000.mcap").observation("train-s0001")
    truth = TruthFile(mini / "train/0000.truth.mcap").truth("train-s0001")
    for key, view in stored.views.items():
        assert view.depth.tobytes() == made.observation.views[key].depth.tobytes()
    assert list(stored.queries) == list(made.observation.queries)
    assert (list(truth.parts), truth.queries, truth.models) == (cast_of(made), made.truth.queries, made.truth.models)
    assert np.array_equal(cast(np.ndarray, stored.labels), cast(np.ndarray, made.observation.labels))
    assert np.array_equal(truth.seg, made.truth.seg)


def test_the_same_draws_give_the_same_scene(play: Play) -> None:
    again = play.again()
    assert alike(play.scene, again)
    assert again.observation.queries == play.scene.observation.queries


def test_another_seed_is_another_scene(play: Play) -> None:
    other = make_scene(MINI, SEED + 1, "test", play.assembly, play.parts, False)
    assert not np.allclose(other.truth.world_from_assembly.xyz, play.scene.truth.world_from_assembly.xyz)
    assert other.extra_views is None


def test_what_is_asked_changes_neither_the_scene_nor_what_is_seen(play: Play) -> None:
    fewer = play.again(tracks=("snap",), curve_scenes=0)
    assert alike(fewer, play.scene, ("ideal",))
    assert list(fewer.observation.views) == ["ideal"]
    wanted = [row for row in play.scene.observation.queries if row["track"] == "snap"]
    assert list(fewer.observation.queries) == wanted != []
    assert fewer.truth.queries == {row["id"]: play.scene.truth.queries[row["id"]] for row in wanted}


def test_noise_is_drawn_for_each_sensor_and_camera_and_moves_nothing(play: Play) -> None:
    assert play.scene.extra_views is not None
    views = {**play.scene.observation.views, **play.scene.extra_views.views}
    errors = {}
    for key in ("", "three/0/", "three/1/", "three/2/"):
        ideal, measured = views[f"{key}ideal"].depth, views[f"{key}d415"].depth
        both = (ideal > 0) & (measured > 0)
        errors[key] = np.where(both, measured - ideal, 0)
        assert both.mean() > 0.5
        assert np.median(np.abs(errors[key][both])) < 5e-3
        assert errors[key][both].std() > 1e-4
    for one in errors:
        for other in errors:
            kept = (errors[one] != 0) & (errors[other] != 0)
            # a scale error is shared by no two pictures, so what is common must not be their noise
            assert one == other or abs(np.corrcoef(errors[one][kept], errors[other][kept])[0, 1]) < 0.5


def test_every_pixel_of_a_part_lies_on_it(play: Play) -> None:
    for i, row in enumerate(play.scene.truth.parts):
        seen = play.points(play.labels == FIRST_PART_LABEL + i)
        assert len(seen) > 0
        assert surface_distances(pose_of(row["world_from_part"]).inverse().apply(seen), play.part(i).mesh).max() < NEAR


def test_every_pixel_of_the_kits_lies_on_the_assembly(play: Play) -> None:
    seen = play.points(play.labels == ASSEMBLY_LABEL)
    home = play.scene.truth.world_from_assembly.inverse()
    assert surface_distances(home.apply(seen), play.assembly.mesh).max() < NEAR


def test_all_else_is_the_top_of_the_table_or_nothing(play: Play) -> None:
    seg = play.scene.truth.seg
    assert np.abs(play.points(seg == 1, 10_000)[:, 2]).max() < NEAR
    assert np.array_equal(seg == 0, play.ideal.depth == 0)
    assert ((play.labels == 0) == (seg <= 1)).all()


def test_masks_and_segmentation_speak_of_the_same_bodies(play: Play) -> None:
    seg, n = play.scene.truth.seg, len(play.parts)
    assert ((play.labels == ASSEMBLY_LABEL) == ((seg == 2) | (seg >= FIRST_CAVITY_LABEL))).all()
    for i in range(n):
        assert ((play.labels == FIRST_PART_LABEL + i) == (seg == 3 + i)).all()
        assert np.count_nonzero(seg == 3 + i) == play.scene.truth.parts[i]["pixels"]
    assert set(np.unique(seg)) <= {0, 1, 2, *range(3, 3 + n), *range(FIRST_CAVITY_LABEL, FIRST_CAVITY_LABEL + n)}


def test_pixels_of_a_cavity_lie_inside_it_and_on_its_kit(play: Play) -> None:
    seg, world = play.scene.truth.seg, play.scene.truth.world_from_assembly
    for k, mount in enumerate(play.assembly.mounts):
        chosen = seg == FIRST_CAVITY_LABEL + k
        if not chosen.any():
            continue
        points = (world @ mount.assembly_from_kit).inverse().apply(play.points(chosen))
        assert (np.abs(points[:, :2]) < mount.kit.extent[:2] / 2).all()
        assert (points[:, 2] < 0).all()
        assert (points[:, 2] > -mount.kit.slot.depth - NEAR).all()
        assert surface_distances(points, mount.kit.mesh).max() < NEAR
    assert (seg >= FIRST_CAVITY_LABEL).any()


def test_a_pixel_deep_in_a_plate_s_block_is_of_its_cavity(play: Play) -> None:
    points, seg = play.points(play.labels == ASSEMBLY_LABEL, 10**9), play.scene.truth.seg[play.labels == ASSEMBLY_LABEL]
    for k, mount in enumerate(play.assembly.mounts):
        inside = (play.scene.truth.world_from_assembly @ mount.assembly_from_kit).inverse().apply(points)
        low, high = mount.kit.extent * (-0.5, -0.5, -1) + 1e-3, mount.kit.extent * (0.5, 0.5, 0) - 1e-3
        assert (seg[((inside > low) & (inside < high)).all(1)] == FIRST_CAVITY_LABEL + k).all()


def test_a_part_stands_in_the_order_that_the_truth_gives(play: Play) -> None:
    rows = play.scene.truth.parts
    assert sorted(row["mount"] for row in rows) == list(range(len(play.parts)))
    for row in rows:
        mount = play.assembly.mounts[row["mount"]]
        assert mount.kit.slot.part_id == row["part_id"]
        home = play.scene.truth.world_from_assembly @ mount.assembly_from_kit
        np.testing.assert_allclose(pose_of(row["world_from_kit"]).matrix(), home.matrix(), atol=1e-12)


def test_the_place_in_the_order_tells_nothing_of_the_mount() -> None:
    mounts = [SimpleNamespace(kit=SimpleNamespace(slot=SimpleNamespace(part_id=str(k)))) for k in range(3)]
    parts = {str(k): cast(Part, SimpleNamespace(id=str(k))) for k in range(3)}

    def order(k: int) -> tuple[int, ...]:
        assembly = cast(Assembly, SimpleNamespace(id=f"test-{k:04d}", mounts=mounts))
        return scenes._scene_parts(MINI, 1, "test", assembly, parts).mounts

    counts = Counter(map(order, range(1200)))
    assert len(counts) == 6
    assert all(abs(count - 200) < 5 * np.sqrt(200) for count in counts.values())


def is_goal_of(slot: Any, world_from_kit: Pose, world_from_part: Pose) -> bool:
    """Whether a pose is one of the slot's goals, turned about the free axis at most."""
    found = world_from_kit.inverse() @ world_from_part
    goals = slot.goals if slot.free_axis is None else [nearest_about_axis(found, g, slot.free_axis) for g in slot.goals]
    return any(
        np.linalg.norm(found.xyz - goal.xyz) < 1e-9 and quaternion_angle(found.wxyz, goal.wxyz) < 1e-7 for goal in goals
    )


def test_every_goal_that_was_drawn_is_one_of_the_slot_and_seats(play: Play) -> None:
    assert play.scene.truth.queries
    standing = convex_edges(play.assembly.mesh)
    for truth in play.scene.truth.queries.values():
        row = play.scene.truth.parts[truth["part"]]
        mount, part = play.assembly.mounts[row["mount"]], play.part(truth["part"])
        world_from_goal = pose_of(truth["goal_drawn"]) @ pose_of(row["world_from_part"])
        assert is_goal_of(mount.kit.slot, pose_of(row["world_from_kit"]), world_from_goal)
        plug = InsertedPart.of(part.mesh, mount.kit.slot.kit_from_part)
        rise = contact_offset(plug, standing, play.scene.truth.world_from_assembly.inverse() @ world_from_goal)
        at_goal = pose_of(row["world_from_kit"]).inverse() @ world_from_goal
        found = seating_result(rise, plug, at_goal, at_goal, mount.kit.slot.depth)
        assert found.seated
        assert found.strict


def test_goals_for_viewers_are_those_of_the_target(play: Play) -> None:
    (row,) = (row for row in play.scene.truth.parts if row["part_id"] == TARGET)
    slot, goals = play.assembly.mounts[row["mount"]].kit.slot, play.scene.truth.goals
    assert goals is not None
    assert len(goals) == len(slot.goals)
    assert all(is_goal_of(slot, pose_of(row["world_from_kit"]), goal) for goal in goals)


def test_who_is_asked_about_is_seen_well_and_who_is_not_is_not_asked_about(play: Play, mini: Path) -> None:
    for scene in (play, *stored_plays(mini)):
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


def stored_plays(root: Path) -> list[Play]:
    geometry, plays = Geometry(root), []
    for shard, held in geometry.summary["shards"].items():
        for scene_id in held:
            truth = TruthFile(root / shard.replace(".mcap", ".truth.mcap")).truth(scene_id)
            parts = {row["part_id"]: geometry.part(row["part_id"]) for row in truth.parts}
            made = GeneratedScene(ObservationFile(root / shard).observation(scene_id), truth, None, ())
            plays.append(Play(geometry.assembly(truth.assembly_id), parts, made))
    return plays


def seen_again(play: Play, i: int) -> dict[str, Any]:
    """How a part and its slot are seen, worked out from the masks, a picture of the part alone, and vectors."""
    row, camera = play.scene.truth.parts[i], play.ideal.world_from_camera
    alone = render(CAMERA, camera, [(play.part(i).mesh, pose_of(row["world_from_part"]))], threads=1).body_ids
    pixels = np.count_nonzero(play.labels == FIRST_PART_LABEL + i)
    kit = pose_of(row["world_from_kit"])
    sight = (camera.xyz - kit.xyz) / np.linalg.norm(camera.xyz - kit.xyz)
    angle = np.arccos(np.clip(kit.rotation_matrix()[:, 2] @ sight, -1, 1))
    share = slot_visibility(play.ideal.depth, CAMERA, camera, play.assembly.mounts[row["mount"]].kit, kit).share
    return {"pixels": pixels, "visible": pixels / np.count_nonzero(alone), "slot_angle": angle, "slot_visible": share}


def test_the_target_is_drawn_once_in_every_track(play: Play) -> None:
    rows = play.scene.observation.queries
    (target,) = (i for i, row in enumerate(play.scene.truth.parts) if row["part_id"] == TARGET)
    for track in {row["track"] for row in rows} - {"curves"}:
        drawn = [row["part"] for row in rows if row["track"] == track and row["drawn"]]
        assert len(drawn) == 1
        assert drawn == [target] or target not in {row["part"] for row in rows if row["track"] == track}
    assert {row["part"] for row in rows if row["track"] == "curves"} == {target}


def test_a_part_for_the_tracks_without_a_guess_lies_upright(play: Play) -> None:
    places = {row["part"] for row in play.scene.observation.queries if row["track"] == "place"}
    assert places
    assert {play.scene.truth.parts[i]["rest_mode"] for i in places} == {UPRIGHT}


def test_everything_is_in_view(play: Play) -> None:
    truth = play.scene.truth
    bodies = [(play.assembly.mesh, truth.world_from_assembly)]
    bodies += [(play.part(i).mesh, pose_of(row["world_from_part"])) for i, row in enumerate(truth.parts)]
    assert all(in_view(CAMERA, play.ideal.world_from_camera, pose.apply(mesh.vertices)) for mesh, pose in bodies)


def first(times: int, blind: Any, real: Callable[..., Any]) -> Callable[..., Any]:
    """A function that answers `blind` (or raises it) a number of times, and then as the real one."""
    left = [times]

    def answer(*arguments: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            return real(*arguments)
        if isinstance(blind, Exception):
            raise blind
        return blind

    return answer


def test_views_that_fail_are_drawn_again_and_counted(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "view_redraw_reason", first(2, "slot turned away", scenes.view_redraw_reason))
    again = play.again(tracks=("snap",))
    assert again.redraws[:2] == ("slot turned away", "slot turned away")
    assert again.observation.views["ideal"].world_from_camera.xyz != pytest.approx(play.ideal.world_from_camera.xyz)
    assert again.truth.world_from_assembly.xyz == pytest.approx(play.scene.truth.world_from_assembly.xyz)


def test_a_layout_without_a_good_view_is_drawn_again(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "redraw_for", first(MAX_VIEWS, Redraw("part mostly hidden"), scenes.redraw_for))
    again = play.again(tracks=("snap",))
    assert again.redraws[:MAX_VIEWS] == ("part mostly hidden",) * MAX_VIEWS
    assert again.truth.world_from_assembly.xyz != pytest.approx(play.scene.truth.world_from_assembly.xyz)


def test_a_layout_that_does_not_rest_is_drawn_again(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "simulate_layout", first(2, Redraw("parts touch"), scenes.simulate_layout))
    assert play.again(tracks=("snap",)).redraws[:2] == ("parts touch", "parts touch")


def test_a_scene_that_no_layout_shows_says_why(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "simulate_layout", first(MAX_LAYOUTS, Redraw("parts touch"), scenes.simulate_layout))
    with pytest.raises(Redraw) as caught:
        play.again()
    assert caught.value.reason == f"none of {MAX_LAYOUTS} layouts passes, mostly: parts touch"


def test_a_view_is_drawn_from_a_stream_of_its_own(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    known = scenes.draw_primary_pose
    poses = []
    monkeypatch.setattr(scenes, "draw_primary_pose", lambda rng: poses.append(known(rng)) or poses[-1])
    made = play.again(tracks=("snap",))
    k = len(poses) - 1
    assert k < MAX_VIEWS
    alone = known(stream(SEED, "view", made.observation.scene_id, 0, k))
    assert alone.xyz == pytest.approx(made.observation.views["ideal"].world_from_camera.xyz, abs=0)
