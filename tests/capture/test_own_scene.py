"""A scene from depth images of a bench: sizes as by a ruler, the world, and what an image cannot give; its table."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kit1000.camera import look_at
from kit1000.capture import mask_networks
from kit1000.capture.depth_frames import DepthFrame
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.mask_networks import Found
from kit1000.capture.options import ImportOptions
from kit1000.capture.own_scene import OwnScene, own_scene
from kit1000.capture.pinhole_images import PinholeImage, pinhole_image
from kit1000.capture.scene_report import check_size, report
from kit1000.capture.table_search import Table, find_table
from kit1000.errors import InputError
from kit1000.metrics import mean_iou
from kit1000.pose import Pose
from kit1000.sim.sensors import SENSORS, sense
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, View
from tests.samples.own_images import CAMERA, EYE, KIT, PARTS, exact_depth, millimetres, noisy_depth

KNOWN = Intrinsics(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, device="Intel RealSense D435i")
BODIES = (KIT, *PARTS)
TOUCHING = (KIT, ((0.05, 0.03, 0.03), (-0.05, -0.06)), ((0.02, 0.05, 0.015), (-0.015, -0.085)))


def wanted(**values: Any) -> ImportOptions:
    """What the user says, without files."""
    return ImportOptions(sources=(), out=Path("out"), **values)


BY_DEPTH = wanted()


def scene_of(
    depth: np.ndarray, options: ImportOptions = BY_DEPTH, known: Intrinsics = KNOWN, pose: Path | None = None
) -> OwnScene:
    return own_scene([DepthFrame(depth, "depth.png")], known, options, pose)


def shown(scene: OwnScene) -> int:
    """The number of parts of which the masks show pixels."""
    return len(np.unique(scene.image.labels[scene.image.labels >= FIRST_PART_LABEL]))


@pytest.fixture(scope="module")
def scene() -> OwnScene:
    return scene_of(millimetres(noisy_depth(exact_depth(), 0.05)))


@pytest.mark.parametrize("eye", [EYE, look_at((0.15, -0.3, 0.75), (0.0, 0.02, 0.0))])
def test_from_anywhere_bodies_have_the_sizes_of_a_ruler(eye: Pose) -> None:
    scene = scene_of(millimetres(noisy_depth(exact_depth(eye=eye), 0.05)))
    for body, ((x, y, z), _) in zip(scene.bodies, BODIES, strict=True):
        assert body.sides == pytest.approx(sorted((x, y)), abs=5e-3)
        assert body.height == pytest.approx(z, abs=2e-3)


def test_the_world_has_kits_and_parts_in_two_halves_and_the_table_at_zero(scene: OwnScene) -> None:
    view, labels = scene.image.view, scene.image.labels
    v, u = np.indices(labels.shape)
    points = view.world_from_camera.apply(view.camera.unproject_pixels(np.stack([u, v], -1), view.depth))
    assert abs(np.median(points[scene.table.mask, 2])) < 0.3e-3
    assert (points[labels == ASSEMBLY_LABEL, 1] > 0).all()
    for part in range(len(PARTS)):
        assert (points[labels == FIRST_PART_LABEL + part, 1] < 0).all()
    assert scene.world.gap is not None
    assert scene.world.gap > 0.05


def test_facts_come_from_the_name_of_the_camera(scene: OwnScene) -> None:
    assert scene.facts.baseline == 0.05
    assert scene.facts.unit == 1e-3
    assert scene.facts.stream == "aligned"
    assert not scene.facts.simulated_table
    assert 0.02 < scene.facts.noise_px < 0.15


@pytest.mark.parametrize("device", ["Photoneo PhoXi 3D Scanner M", "phoxi", "Zivid 2, structured light"])
def test_a_scanner_is_known_by_its_name(device: str) -> None:
    found = scene_of(noisy_depth(exact_depth(), 0.05), wanted(device=device))
    assert found.facts.scanner
    assert found.facts.baseline == SENSORS["photoneo"].baseline
    assert (found.facts.fattening_px, found.facts.stream) == (0.0, "raw")
    assert any("structured-light" in line for line in report(found, None))


def test_touching_parts_of_a_scanner_become_two() -> None:
    depth = noisy_depth(exact_depth(TOUCHING), 0.01)
    assert len(scene_of(depth, wanted(device="PhoXi")).parts) == 1
    found = scene_of(depth, wanted(device="PhoXi", networks=True))
    assert sorted(round(1e3 * part.height) for part in found.parts) == [15, 30]
    assert shown(found) == 2


def test_a_piece_of_the_kit_that_shadows_cut_off_is_no_part() -> None:
    depth = noisy_depth(exact_depth(TOUCHING), 0.01).copy()
    (_, _, z), (x, y) = KIT
    u, v = np.rint(CAMERA.project(EYE.inverse().apply((x, y, z)))).astype(int)
    piece = depth[v - 14 : v + 14, u - 14 : u + 14].copy()
    depth[v - 18 : v + 18, u - 18 : u + 18] = 0
    depth[v - 14 : v + 14, u - 14 : u + 14] = piece
    assert len(scene_of(depth, wanted(device="PhoXi")).parts) == 2
    found = scene_of(depth, wanted(device="PhoXi", networks=True))
    assert sorted(round(1e3 * part.height) for part in found.parts) == [15, 30]
    assert found.image.labels[v, u] == ASSEMBLY_LABEL


def test_a_small_part_behind_the_kit_stays_one_and_hides_no_others() -> None:
    behind = ((0.03, 0.02, 0.02), (KIT[1][0], KIT[1][1] + KIT[0][1] / 2 + 0.05))
    depth = noisy_depth(exact_depth((*TOUCHING, behind)), 0.01)
    assert len(scene_of(depth, wanted(device="PhoXi", networks=True)).parts) == len(TOUCHING)


def test_a_speck_beside_the_kit_is_no_piece_of_it() -> None:
    speck = ((0.004, 0.004, 0.02), (0.1, 0.08))
    found = scene_of(noisy_depth(exact_depth((KIT, *PARTS, speck)), 0.01), wanted(device="PhoXi", networks=True))
    u, v = np.rint(CAMERA.project(EYE.inverse().apply((*speck[1], 0.01)))).astype(int)
    assert found.image.view.depth[v, u] < exact_depth()[v, u] - 5e-3
    assert found.image.labels[v, u] == 0


def test_a_low_part_on_a_rippled_table_counts_where_the_networks_see_it() -> None:
    low = ((0.045, 0.035, 0.0095), (-0.06, -0.16))
    depth = noisy_depth(exact_depth((KIT, *PARTS, low)), 0.2)
    assert len(scene_of(depth).parts) == len(PARTS)
    found = scene_of(depth, wanted(networks=True))
    assert len(found.parts) == shown(found) == len(PARTS) + 1
    alone = noisy_depth(exact_depth((KIT, low)), 0.2)
    assert len(scene_of(alone, wanted(networks=True)).parts) == 1
    empty = noisy_depth(exact_depth((KIT, *PARTS)), 0.2)
    assert len(scene_of(empty, wanted(networks=True)).parts) == len(PARTS)


def test_what_networks_see_on_the_bare_table_is_no_part(monkeypatch: pytest.MonkeyPatch) -> None:
    low, bare = ((0.04, 0.03, 0.003), (-0.06, -0.16)), (0.08, -0.16)
    depth, instances = noisy_depth(exact_depth((KIT, *PARTS, low)), 0.1), np.zeros((480, 640), int)
    for number, place in enumerate((low[1], bare), start=1):
        u, v = np.rint(CAMERA.project(EYE.inverse().apply((*place, 0.0)))).astype(int)
        instances[v - 12 : v + 12, u - 15 : u + 15] = number
    seen = Found(np.zeros(instances.shape, bool), instances, np.full(instances.shape, 9.0))
    monkeypatch.setattr(mask_networks, "_found", lambda view, facts: seen)
    found = scene_of(depth, wanted(networks=True))
    assert len(found.parts) == len(PARTS) + 1
    assert (found.image.labels[instances == 1] >= FIRST_PART_LABEL).all()
    assert not found.image.labels[instances == 2].any()


def test_the_outlines_of_networks_are_nearer_the_true_ones() -> None:
    true = (exact_depth() < exact_depth(()) - 1e-4).astype(np.uint8)
    depth = sense("d415", View(CAMERA, EYE, exact_depth()), np.random.default_rng(3)).depth
    by_height, by_networks = (
        mean_iou((scene_of(depth, wanted(networks=with_them)).image.labels > 0).astype(np.uint8), true)
        for with_them in (False, True)
    )
    assert by_networks > by_height + 0.02


def test_a_part_that_a_gap_without_returns_cuts_is_one() -> None:
    depth = noisy_depth(exact_depth(), 0.01).copy()
    u = round(float(CAMERA.project(EYE.inverse().apply((*PARTS[0][1], PARTS[0][0][2])))[0]))
    depth[250:, u - 2 : u + 2] = 0
    assert len(scene_of(depth, wanted(device="PhoXi")).parts) == len(PARTS) + 1
    found = scene_of(depth, wanted(device="PhoXi", networks=True))
    assert len(found.parts) == shown(found) == len(PARTS)
    assert max(part.sides[1] for part in found.parts) == pytest.approx(0.05, abs=5e-3)


def test_masks_cover_the_bodies(scene: OwnScene) -> None:
    for number, (sides, at) in enumerate(BODIES):
        u, v = np.rint(CAMERA.project(EYE.inverse().apply((*at, sides[2])))).astype(int)
        expected = ASSEMBLY_LABEL if number == 0 else FIRST_PART_LABEL + number - 1
        assert scene.image.labels[v, u] == expected
    assert 0.02 < (scene.image.labels > 0).mean() < 0.2


@pytest.mark.parametrize("unit", [1e-4, 2.5e-4])
def test_another_unit_changes_nothing(scene: OwnScene, unit: float) -> None:
    steps = np.rint(noisy_depth(exact_depth(), 0.05) / unit).astype(np.uint16)
    other = scene_of(steps, wanted(depth_scale=unit))
    assert other.table.distance == pytest.approx(scene.table.distance, abs=0.2e-3)
    assert len(other.parts) == len(scene.parts)
    assert (other.image.labels == scene.image.labels).mean() > 0.998


def test_the_kit_is_the_body_that_is_named() -> None:
    depth = millimetres(exact_depth())
    chosen = scene_of(depth, wanted(kit=2))
    assert chosen.kit.sides == pytest.approx((0.03, 0.05), abs=5e-3)
    with pytest.raises(InputError, match=r"--kit 9: .* 3 bodies; expected 1 to 3"):
        scene_of(depth, wanted(kit=9))


def test_the_kit_is_the_body_of_its_size() -> None:
    """Even if another one is larger."""
    depth = millimetres(exact_depth())
    largest, other, *_ = scene_of(depth).bodies
    size = (other.sides[1] * 1.05, other.sides[0] * 0.97, other.height * 1.1)
    chosen = scene_of(depth, wanted(kit_size=size)).bodies
    assert (chosen[0].area, chosen[1].area) == (other.area, largest.area)
    assert scene_of(depth, wanted(kit_size=size, kit=3)).kit.area < other.area  # a number that is given counts


def test_an_empty_table_is_no_scene() -> None:
    with pytest.raises(InputError, match="nothing higher than"):
        scene_of(millimetres(noisy_depth(exact_depth(()), 0.05)))


def pose_file(folder: Path, pose: Pose, matrix: bool = False) -> Path:
    value = pose.matrix().tolist() if matrix else {"wxyz": pose.wxyz.tolist(), "xyz": pose.xyz.tolist()}
    (folder / "pose.json").write_text(json.dumps(value), encoding="utf-8")
    return folder / "pose.json"


@pytest.mark.parametrize("matrix", [False, True])
def test_a_given_pose_keeps_the_frame_of_the_user(tmp_path: Path, matrix: bool) -> None:
    off = Pose.from_rotvec((0.01, 0.0, 0.0), (0.0, 0.0, 4e-3))
    found = scene_of(millimetres(exact_depth()), pose=pose_file(tmp_path, off @ EYE, matrix))
    np.testing.assert_allclose(found.world.world_from_camera.xyz, EYE.xyz, atol=8e-3)
    assert found.world.world_from_camera.xyz[2] == pytest.approx(EYE.xyz[2], abs=0.5e-3)
    assert found.facts.height_ratio == pytest.approx(EYE.xyz[2] / (off @ EYE).xyz[2], abs=1e-3)
    assert any("corrected" in line for line in report(found, None))


FAR = {
    "elsewhere": (Pose.from_translation((0, 0, 0.752)), "at z = 752 mm"),
    "upside down": (Pose.from_rotvec((np.pi, 0, 0)), "tilted by 180"),
}


@pytest.mark.parametrize("name", FAR)
def test_a_pose_that_contradicts_the_image_is_refused(tmp_path: Path, name: str) -> None:
    off, fact = FAR[name]
    with pytest.raises(InputError, match=fact):
        scene_of(millimetres(exact_depth()), pose=pose_file(tmp_path, off @ EYE))


METRES = noisy_depth(exact_depth(), 0.05)
TENTHS = np.rint(METRES * 0.4 / 1e-4).astype(np.uint16)  # a scene of 0.4 times the size, in units of 0.1 mm
UNNAMED = Intrinsics(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)


def test_a_known_device_brings_its_unit(scene: OwnScene) -> None:
    found = scene_of(TENTHS, wanted(device="D405"))
    assert found.facts.unit == 1e-4
    assert found.table.distance == pytest.approx(0.4 * scene.table.distance, rel=0.01)


WRONG_UNITS: dict[str, tuple[np.ndarray, str]] = {
    "stated": (np.rint(METRES / 1e-4).astype(np.uint16), "--depth-scale 0.0001"),
    "assumed": (TENTHS, "give --depth-scale 0.001 if that is so, or --depth-scale 0.0001"),
}


@pytest.mark.parametrize("name", WRONG_UNITS)
def test_a_wrong_unit_is_refused_with_one_that_fits(name: str) -> None:
    values, fact = WRONG_UNITS[name]
    with pytest.raises(InputError, match=fact):
        scene_of(values, known=UNNAMED)


def test_lengths_of_rays_are_no_depths() -> None:
    v, u = np.indices(METRES.shape)
    lengths = np.sqrt(((u - CAMERA.cx) / CAMERA.fx) ** 2 + ((v - CAMERA.cy) / CAMERA.fy) ** 2 + 1)
    with pytest.raises(InputError, match="lengths of rays"):
        scene_of(millimetres(METRES * lengths))


def test_wrong_intrinsics_show_in_the_sizes_and_fail_the_check(scene: OwnScene) -> None:
    assert "check" in check_size([scene], (0.04, 0.12, 0.1))
    wrong = Intrinsics(0.53 * CAMERA.fx, 0.53 * CAMERA.fy, CAMERA.cx, CAMERA.cy)
    other = scene_of(millimetres(exact_depth()), known=wrong)
    assert other.kit.sides[1] / scene.kit.sides[1] == pytest.approx(1 / 0.53, rel=0.2)
    with pytest.raises(InputError, match=r"--check 40 x 120 x 100: no body.*intrinsics"):
        check_size([other], (0.04, 0.12, 0.1))


def test_the_report_names_sizes_and_what_makes_fits_unsure(scene: OwnScene) -> None:
    lines = list(report(scene, None))
    assert lines[0].startswith("depth.png: table ")
    assert "--intrinsics" in lines[1]
    assert lines[2].endswith("kit")
    assert lines[3].endswith("part 0, 1 on the page")
    for line, (sides, at) in zip(lines[2:], BODIES, strict=False):
        seen = CAMERA.project(EYE.inverse().apply((*at, sides[2] / 2)))
        told = re.search(r"at (\d+), (\d+) px", line)
        assert told is not None
        assert np.abs(np.array(told.groups(), float) - seen).max() < 12
    assert any("--clearance-mm" in line for line in lines)
    assert not any("--clearance-mm" in line for line in report(scene, 2.5e-3))


def image_of(depth: np.ndarray) -> PinholeImage:
    return pinhole_image(depth, UNNAMED, "depth.png")


def errors(table: Table, height: float, up: np.ndarray) -> tuple[float, float]:
    """[m] and degrees."""
    angle = np.degrees(np.arccos(np.clip(table.up @ up, -1, 1)))
    return abs(table.distance - height), float(angle)


@pytest.mark.parametrize("noise_px", [0.0, 0.05, 0.2])
def test_the_table_is_found_under_noise(noise_px: float) -> None:
    table = find_table(image_of(noisy_depth(exact_depth(), noise_px)), "x")
    distance, angle = errors(table, float(EYE.xyz[2]), EYE.inverse().rotate((0.0, 0.0, 1.0)))
    assert distance < 0.3e-3 + 2e-3 * noise_px
    assert angle < 0.02 + 0.3 * noise_px
    assert 0.4 < table.share < 1
    assert abs(table.ripple - noise_px * 0.85**2 / (CAMERA.fx * 0.055)) < 0.5e-3 + 0.3e-2 * noise_px


def test_a_face_of_a_body_is_not_the_table() -> None:
    large = ((0.25, 0.2, 0.09), (0.0, 0.02))
    table = find_table(image_of(noisy_depth(exact_depth((large,)), 0.05)), "x")
    assert errors(table, float(EYE.xyz[2]), EYE.inverse().rotate((0.0, 0.0, 1.0)))[0] < 1e-3


def test_a_wall_is_no_table() -> None:
    level = look_at((0.0, -0.5, 0.02), (0.0, 0.0, 0.0))  # the table is seen at 2 degrees
    with pytest.raises(InputError, match="table in view"):
        find_table(image_of(exact_depth((), level)), "x")
