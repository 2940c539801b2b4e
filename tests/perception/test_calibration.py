"""Calibration: planted errors of camera and depth are found, what the image does not show stays, bends are removed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from kit1000.camera import look_at
from kit1000.errors import ShapeError
from kit1000.mesh import Mesh
from kit1000.perception.calibration import OUTLINE, CameraEstimate, calibrated, camera_estimate_by, flattened, unbent
from kit1000.perception.calibration.camera_pose import BORDER_REACH, SPREADS, camera_estimate, seen_borders
from kit1000.perception.calibration.depth_scale import DepthScale, stated_scale
from kit1000.perception.calibration.table import BENT, PLANE_REACH, correlated_in, table_plane, table_residuals
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.sim.sensors import sense
from kit1000.values import LabelledDepth, View

CORNER = look_at((0.45, -0.25, 0.55), (-0.2, 0.25, 0.02))  # sees the edges at x = -0.6 m and at y = 0.8 m
MIDDLE = look_at((0.25, 0.03, 0.6), (0.0, 0.03, 0.02))  # sees no edge
OUTSIDE = look_at((0.75, 0.1, 0.35), (0.0, 0.03, 0.02))  # above the floor beside the table: sees the side at x = 0.6 m
FAR_X, FAR_Y = OUTLINE[1], OUTLINE[2]
OWN = replace(simulated_sensor("d415"), simulated_table=False)


def rendered(pose: Pose) -> LabelledDepth:
    """The table with a block on it."""
    block = trimesh.creation.box(extents=(0.2, 0.15, 0.1))
    body = Mesh(np.array(block.vertices), np.array(block.faces, dtype=np.int32))
    image = render(CAMERA, pose, [(table(), Pose.identity()), (body, Pose.from_translation((-0.05, 0.1, 0.05)))])
    return LabelledDepth(View(CAMERA, pose, image.depth), (image.body_ids == 2).astype(np.uint8))


@pytest.fixture(scope="module")
def corner() -> LabelledDepth:
    return rendered(CORNER)


@pytest.fixture(scope="module")
def middle() -> LabelledDepth:
    return rendered(MIDDLE)


def disturbed(view: View, error: Pose, scale: float = 1.0) -> View:
    """The view as a camera records it whose pose, in its own frame, and depth scale are wrong."""
    return View(view.camera, view.world_from_camera @ error, view.depth * np.float32(scale))


def spots(view: View, mask: np.ndarray) -> np.ndarray:
    """(n, 3) [m] world: where a view shows the pixels of a mask."""
    return view.world_from_camera.apply(view.camera.unproject(view.depth)[mask])


def errors(view: View, true: View) -> tuple[np.ndarray, np.ndarray]:
    """The camera's error along world axes: (3,) [mm] and rotation vector (3,) [degrees]."""
    error = true.world_from_camera.inverse() @ view.world_from_camera
    position, rotvec = true.world_from_camera.rotate(np.stack([error.xyz, error.rotvec()]))
    return 1e3 * position, np.degrees(rotvec)


@pytest.mark.parametrize("pose", [CORNER, MIDDLE, OUTSIDE], ids=["corner", "middle", "outside"])
def test_an_ideal_image_stays_as_it_is(pose: Pose) -> None:
    image = rendered(pose)
    seen = image.view.depth > 0
    moved = spots(calibrated(image.view, image.labels), seen) - spots(image.view, seen)
    assert np.linalg.norm(moved, axis=1).max() < 1.5e-4


def test_the_plane_gives_height_roll_and_pitch_and_leaves_the_rest(middle: LabelledDepth) -> None:
    error = Pose.from_rotvec(np.radians((0.1, -0.12, 0.08)), (1e-3, -0.5e-3, 0.8e-3))
    wrong = disturbed(middle.view, error, 1.002)
    right = calibrated(wrong, middle.labels)
    table_pixels = (middle.labels == 0) & (middle.view.depth > 0)
    assert np.abs(spots(wrong, table_pixels)[:, 2]).max() > 1e-3
    assert np.abs(spots(right, table_pixels)[:, 2]).max() < 1e-4
    (_, before), (_, after) = errors(wrong, middle.view), errors(right, middle.view)
    assert np.abs(after[:2]).max() < 5e-3
    assert after[2] == pytest.approx(before[2], abs=5e-3)  # yaw is not seen
    np.testing.assert_allclose(right.world_from_camera.xyz[:2], wrong.world_from_camera.xyz[:2], atol=1e-5)


def test_height_and_scale_share_an_error_by_their_spreads(middle: LabelledDepth) -> None:
    """The plane knows their product alone: the likelier of the two is corrected more."""
    wrong = disturbed(middle.view, Pose.identity(), 1.002)
    right = calibrated(wrong, middle.labels)
    height = middle.view.world_from_camera.xyz[2]
    by_scale, by_height = (height * SPREADS[6]) ** 2, SPREADS[3] ** 2
    seen = middle.view.depth > 0
    scale = float(np.median(right.depth[seen] / middle.view.depth[seen]))
    left = 0.002 * by_height / (by_scale + by_height)
    assert scale - 1 == pytest.approx(left, abs=5e-5)
    assert errors(right, middle.view)[0][2] == pytest.approx(1e3 * height * left, abs=0.05)


def test_a_corner_gives_yaw_and_position(corner: LabelledDepth) -> None:
    wrong = disturbed(corner.view, Pose.from_rotvec(np.radians((0.1, 0.15, -0.1)), (1e-3, -1e-3, 0.5e-3)))
    plane, both = (calibrated(wrong, corner.labels, borders=borders) for borders in ((), OUTLINE))
    (_, tilted), (_, turned), (position, rotation) = (errors(view, corner.view) for view in (wrong, plane, both))
    assert np.abs(tilted).max() > 0.1
    assert np.abs(turned[:2]).max() < 5e-3 < 0.05 < abs(turned[2])
    assert np.abs(rotation).max() < 0.06 < abs(turned[2])
    assert np.linalg.norm(position) < 0.9 * np.linalg.norm(errors(plane, corner.view)[0])


def test_the_noise_of_a_d415_leaves_plane_and_outline(corner: LabelledDepth) -> None:
    """Bent planes and ramps move both by more than their pixels tell; the table ends nearer to where it is."""
    before, after = [], []
    for seed in range(4):
        wrong = sense("d415", corner.view, stream(seed, "noise"))
        seen = (wrong.depth > 0) & (corner.labels == 0)
        for view, found in ((wrong, before), (calibrated(wrong, corner.labels), after)):
            apart = spots(flattened(view, corner.labels), seen) - spots(corner.view, seen)
            found.append(np.mean(apart**2))
    assert np.sqrt(np.mean(after)) < min(0.9 * np.sqrt(np.mean(before)), 3e-3)


def test_the_edges_in_view_are_found_to_a_fraction_of_a_pixel(corner: LabelledDepth, middle: LabelledDepth) -> None:
    edges = seen_borders(corner.view, corner.labels)
    assert [edge.border for edge in edges] == [FAR_X, FAR_Y]
    for edge in edges:
        points = CORNER.inverse().apply(
            [(-0.6, y, 0) for y in np.linspace(-0.5, 0.8, 200)]
            if edge.border == FAR_X
            else [(x, 0.8, 0) for x in np.linspace(-0.6, 0.6, 200)]
        )
        across, along = CAMERA.project(points).T if not edge.columns else CAMERA.project(points).T[::-1]
        order = np.argsort(along)
        off = np.interp(edge.lines, along[order], across[order]) - edge.places
        assert np.abs(off).max() < 0.51
        assert abs(off.mean()) < 0.05
    assert not seen_borders(middle.view, middle.labels)


def test_dropouts_at_an_edge_do_not_move_it(corner: LabelledDepth) -> None:
    depth, rng = corner.view.depth.copy(), np.random.default_rng(0)
    edge = seen_borders(corner.view, corner.labels)[0]
    assert edge.columns
    for first in rng.choice(edge.lines[:-8:8], 40, replace=False):
        place = round(float(edge.places[np.searchsorted(edge.lines, first)]))
        depth[place - BORDER_REACH : place + rng.integers(2, 9), first : first + 8] = 0
    holed = replace(corner.view, depth=depth)
    moved = calibrated(holed, corner.labels).world_from_camera.xyz - CORNER.xyz
    assert np.abs(moved).max() < 3e-4


def test_a_body_in_front_of_an_edge_hides_that_piece(corner: LabelledDepth) -> None:
    labels = corner.labels.copy()
    labels[:, 300:900] = 1
    whole, part = seen_borders(corner.view, corner.labels)[0], seen_borders(corner.view, labels)[0]
    assert whole.border == part.border
    assert set(part.lines) < set(whole.lines)
    assert not {*range(300, 900)} & {*part.lines.tolist()}


def test_the_plane_moves_with_a_level_motion_of_the_world_and_the_outline_does_not(corner: LabelledDepth) -> None:
    """The table stays: a world that is shifted is a camera that is shifted the other way."""
    wrong = disturbed(corner.view, Pose.from_rotvec(np.radians((0.1, 0.1, 0.1)), (1e-3, 0, 0)))
    motion = Pose.from_rotvec((0, 0, np.radians(0.1)), (1e-3, 1e-3, 0))
    moved = replace(wrong, world_from_camera=motion @ wrong.world_from_camera)
    alone = calibrated(wrong, corner.labels, borders=()).world_from_camera
    there = calibrated(moved, corner.labels, borders=()).world_from_camera
    difference = (motion @ alone).inverse() @ there
    assert np.linalg.norm(difference.xyz) < 1e-7
    assert difference.angle() < 1e-7
    here = calibrated(moved, corner.labels).world_from_camera
    assert ((motion @ alone).inverse() @ here).angle() > np.radians(0.03)
    position, rotvec = errors(replace(wrong, world_from_camera=here), corner.view)
    assert abs(rotvec[2]) < 0.05  # of 0.2: the prior holds a part of it
    assert np.linalg.norm(position) < 1  # of 2 mm


def test_flat_puts_the_table_on_its_plane_and_nothing_else(corner: LabelledDepth) -> None:
    measured = sense("d415", corner.view, stream(0, "noise"))
    plain = calibrated(measured, corner.labels)
    flat = flattened(plain, corner.labels)
    table_pixels = (corner.labels == 0) & (flat.depth > 0)
    off = np.abs(spots(flat, table_pixels)[:, 2]) > 1e-6
    assert off.mean() < 1e-3  # of pixels on the edge
    np.testing.assert_array_equal(flat.depth[corner.labels > 0], plain.depth[corner.labels > 0])
    assert table_pixels.sum() > ((corner.labels == 0) & (measured.depth > 0)).sum()
    beyond = np.mean((corner.view.depth == 0) & (flat.depth > 0))
    assert beyond < 1e-3  # nothing stays nothing, but for pixels on the edge


def test_without_a_table_the_view_stays(corner: LabelledDepth) -> None:
    view = corner.view
    assert calibrated(view, np.ones_like(corner.labels)) is view
    empty = replace(view, depth=np.zeros_like(view.depth))
    assert calibrated(empty, corner.labels) is empty
    lifted = replace(view, world_from_camera=Pose.from_translation((0, 0, 0.1)) @ CORNER)
    assert calibrated(lifted, corner.labels) is lifted  # no pixel within reach of z = 0
    below = replace(view, world_from_camera=Pose.from_rotvec((np.pi, 0, 0)) @ CORNER)
    assert calibrated(below, corner.labels) is below


def test_masks_of_another_size_are_refused(corner: LabelledDepth) -> None:
    with pytest.raises(ShapeError, match="labels"):
        calibrated(corner.view, corner.labels[1:])


def motion_over(pose: Pose, rotation: np.ndarray) -> tuple[Pose, np.ndarray]:
    """A motion from the middle of an image to a place beside it, and the point of the table that is moved."""
    ray = pose.rotate((0.05, 0.1, 1.0))
    point = pose.xyz - ray * pose.xyz[2] / ray[2]
    goal = point + np.array((-0.2, 0.15, 0.1))
    turned = Pose.from_rotvec(rotation, (0, 0, 0))
    return Pose.from_rotvec(rotation, goal - turned.apply(point)), point


def motion_error(motion: Pose, point: np.ndarray, measured: View, true: View) -> np.ndarray:
    """(3,) [m] by how much a true motion of a point differs from the one that a wrong view shows between its bodies.

    Bodies are seen where the wrong camera has what the right one sees, at the depths of the wrong scale.
    """
    scale = float(np.median((measured.depth / np.where(true.depth > 0, true.depth, np.inf))[true.depth > 0]))

    def shown(x: np.ndarray) -> np.ndarray:
        return measured.world_from_camera.apply(scale * true.world_from_camera.inverse().apply(x))

    goal = motion.apply(point)
    return shown(goal) - goal - motion.rotate(shown(point) - point)


@pytest.fixture(scope="module", params=[(), OUTLINE], ids=["plane", "outline"])
def cameras(corner: LabelledDepth, request: pytest.FixtureRequest) -> tuple[list[CameraEstimate], bool]:
    """Cameras with errors of their specification, calibrated, and whether by borders of the table too."""
    rng, found = stream(3, "cameras"), []
    for _ in range(30):
        unknowns = rng.normal(size=7) * SPREADS
        wrong = disturbed(corner.view, Pose.from_rotvec(-unknowns[:3], -unknowns[3:6]), float(np.exp(unknowns[6])))
        found.append(camera_estimate(wrong, corner.labels, request.param, PLANE_REACH, BENT))
    return found, bool(request.param)


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (0.0, 0.0, 1.2), (1.0, -0.8, 0.5)])
def test_the_spread_of_a_motion_is_that_of_the_errors_left(
    corner: LabelledDepth, cameras: tuple[list[CameraEstimate], bool], rotation: tuple[float, float, float]
) -> None:
    """Motions of such cameras differ by the spread stated. Edges are exact here, and differ by less than theirs."""
    motion, point = motion_over(CORNER, np.array(rotation))
    estimates, by_borders = cameras
    squared = [np.sum(motion_error(motion, point, each.view, corner.view) ** 2) for each in estimates]
    spreads = np.array([each.spread_of(motion, point) for each in estimates])
    ratio = np.sqrt(np.mean(squared) / np.mean(spreads**2))
    assert (0.5 if by_borders else 0.8) < ratio < 1.2
    assert np.ptp(spreads) < 0.05 * spreads.mean()  # it depends on what is seen, hardly on the error


def test_the_spread_of_a_motion_moves_with_the_world(corner: LabelledDepth) -> None:
    motion, point = motion_over(CORNER, np.array((0.3, 0.2, 1.5)))
    estimate = camera_estimate_by(corner.view, corner.labels, simulated_sensor("d415"))
    world = Pose.from_rotvec((0.4, -0.3, 1.1), (0.5, -2.0, 0.3))
    view = View(estimate.view.camera, world @ estimate.view.world_from_camera, estimate.view.depth)
    moved = CameraEstimate(view, estimate.information).spread_of(world @ motion @ world.inverse(), world.apply(point))
    assert moved == pytest.approx(estimate.spread_of(motion, point), rel=1e-9)


BASELINE = 0.055
GAIN = CAMERA.fx * BASELINE
BODY = np.s_[280:440, 560:720]
LABELS = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
LABELS[BODY] = 1
NOISE = 0.05  # [px]

D415, SCANNER = simulated_sensor("d415"), simulated_sensor("photoneo")


@pytest.fixture(scope="module")
def flat() -> View:
    """The table, and a body whose top is 3 % nearer to the camera than the table behind it."""
    pose = look_at((0.15, 0.0, 0.7), (0.0, 0.0, 0.0))
    nothing = View(CAMERA, pose, np.zeros(LABELS.shape, np.float32))
    table = flattened(nothing, np.zeros_like(LABELS))
    return replace(table, depth=np.where(LABELS == 1, table.depth * np.float32(0.97), table.depth))


def measured(view: View, error: np.ndarray) -> View:
    """The view with an error of its disparities (H, W) [px]."""
    disparity = GAIN / np.where(view.depth > 0, view.depth, np.inf) + error
    depth = np.where(view.depth > 0, GAIN / np.maximum(disparity, 1e-3), 0)
    return replace(view, depth=depth.astype(np.float32))


def noise() -> np.ndarray:
    return NOISE * stream(0, "bending").standard_normal(LABELS.shape)


def waves() -> np.ndarray:
    """(H, W) [px] a field that varies over some hundred pixels; its RMS is 0.15 px."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    return 0.3 * np.sin(u / 110) * np.cos(v / 130)


def error_on(view: View, true: View, label: int) -> np.ndarray:
    """[px] of the disparities of a body, or of the table, at pixels far from edges."""
    inside = np.s_[300:420, 580:700] if label else np.s_[60:220, 200:1000]
    return GAIN / view.depth[inside] - GAIN / true.depth[inside]


def test_bending_is_taken_off_the_body_that_the_table_surrounds(flat: View) -> None:
    bent = measured(flat, waves() + noise())
    straight = unbent(bent, LABELS, BASELINE)
    for label in (0, 1):
        before, after = (error_on(view, flat, label).mean(axis=0) for view in (bent, straight))  # noise averages out
        assert np.sqrt(np.mean(after**2)) < 0.35 * np.sqrt(np.mean(before**2))


def test_what_varies_slowly_is_told_from_noise(flat: View) -> None:
    still, bent = (table_residuals(measured(flat, error), LABELS, GAIN) for error in (noise(), waves() + noise()))
    assert still is not None
    assert bent is not None
    assert still.bending < 0.01 * np.mean(waves() ** 2)
    assert bent.bending == pytest.approx(np.mean(waves() ** 2), rel=0.5)
    assert bent.noise < 0.1 * bent.bending


def test_pixels_without_a_return_stay_without(flat: View) -> None:
    bent = measured(flat, waves())
    bent.depth.setflags(write=True)
    bent.depth[100:120, 300:330] = 0
    assert (unbent(bent, LABELS, BASELINE).depth[100:120, 300:330] == 0).all()


def test_an_image_that_shows_hardly_any_table_stays_as_it_is(flat: View) -> None:
    bent, everywhere = measured(flat, waves()), np.ones_like(LABELS)
    everywhere[:60, :60] = 0
    assert unbent(bent, everywhere, BASELINE) is bent


def test_a_plane_that_a_stereo_camera_bends_is_less_sure_than_a_scanner_s(flat: View) -> None:
    noisy = measured(flat, noise())
    stereo, scanner = (
        table_plane(noisy, LABELS, correlated=correlated_in(simulated_sensor(name))) for name in ("d415", "photoneo")
    )
    assert stereo is not None
    assert scanner is not None
    ratio = np.sqrt(correlated_in(D415) / correlated_in(SCANNER))
    assert stereo.spreads / scanner.spreads == pytest.approx(ratio)
    assert ratio > 10


def test_images_of_stereo_cameras_alone_are_straightened(flat: View) -> None:
    bent = LabelledDepth(measured(flat, waves() + noise()), LABELS)
    stereo, scanner = (
        error_on(calibrated_image(bent, simulated_sensor(name)).view, flat, 1).mean() for name in ("d415", "photoneo")
    )
    assert abs(stereo) < 0.5 * abs(scanner)


@pytest.mark.parametrize("ratio", [0.998, 1.001])
def test_a_stated_height_tells_the_depth_scale(ratio: float) -> None:
    near, far = (stated_scale(replace(OWN, height_ratio=ratio), height) for height in (0.4, 0.8))
    assert abs(near.value - 1) < abs(far.value - 1) < abs(ratio - 1)  # 1 mm is a smaller share of a larger height
    assert far.spread < near.spread < DepthScale().spread
    assert (far.value - 1) * (ratio - 1) > 0


@pytest.mark.parametrize("ratio", [None, 0.98, 1.02])
def test_no_stated_height_or_one_that_cannot_be_right_tells_nothing(ratio: float | None) -> None:
    assert stated_scale(replace(OWN, height_ratio=ratio), 0.6) == DepthScale()


@pytest.mark.parametrize("scale", [0.998, 1.002])
def test_an_own_image_takes_the_scale_that_its_stated_height_tells(middle: LabelledDepth, scale: float) -> None:
    x, y, z = MIDDLE.xyz
    lifted = Pose(MIDDLE.wxyz, np.array([x, y, scale * z]))  # at the measured height over the table
    recorded = View(CAMERA, lifted, middle.view.depth * np.float32(scale))
    found = camera_estimate_by(recorded, middle.labels, replace(OWN, height_ratio=scale)).view
    body = middle.labels > 0
    off, before = (np.abs(spots(view, body) - spots(middle.view, body)).max() for view in (found, recorded))
    assert off < 0.5 * before
    unknown = camera_estimate_by(recorded, middle.labels, OWN).view
    np.testing.assert_allclose(unknown.depth, recorded.depth, rtol=2e-4)
