"""Conformance of a depth sensor model, as recordings, readers and methods need it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kit1000.camera import Camera, look_at
from kit1000.pose import Pose
from kit1000.sim.cameras import CAMERA
from kit1000.sim.sensors import DEPTH_GRID
from kit1000.testing.depths import likely_cause
from kit1000.values import View

Sense = Callable[[View, np.random.Generator], View]
"""Returns the measured view of an ideal one; its `world_from_camera` is the calibrated camera pose, with its error."""

SHIFT_TOLERANCE = 0.25
"""[px] Largest offset of an image from the surfaces that it shows."""
LEAST_RETURNS = 0.5
"""Least share of the pixels of a surface that have a depth."""
MIDDLE_DEPTH = 1.0  # [m] of the middle of the bowl
MIDDLE_DIRECTION = (0.12, -0.07)  # where the middle of the bowl lies, x / z and y / z: a mirrored image differs
WORLD_FROM_CAMERA = look_at((0.5, 0.3, 0.7), (0.0, 0.0, 0.0))


def check_sensor(
    sense: Sense,
    name: str = "sensor",
    depth_error: float = 0.01,
    position_error: float = 0.01,
    rotation_error_deg: float = 1.0,
    camera: Camera = CAMERA,
) -> None:
    """Check a depth sensor model on a bowl of four planes with a hole, 0.4 to 1 m away.

    Depths are close to the surfaces and 0 elsewhere, on the grid of recordings. The sensor leaves its input unchanged,
    and only the generator makes a difference: the same draws give the same image, and the number of draws does not
    depend on the image.

    Args:
        sense: the sensor.
        name: begins every message.
        depth_error: [m] allowed median error of a depth.
        position_error: [m] allowed error of the camera position, in each of a few draws.
        rotation_error_deg: [degrees] allowed error of the camera rotation.
        camera: of the test images.
    """
    view = View(camera, WORLD_FROM_CAMERA, np.where(_hole_mask(camera), 0, _bowl_depths(camera)))
    first, measured = (_run(sense, view, seed, name) for seed in (0, 1))
    for image in (first, measured):
        _check_format(image, view, name)
        _check_depths(image, view, depth_error, name)
        _check_pose(image.world_from_camera, view.world_from_camera, position_error, rotation_error_deg, name)
    no_surface = View(camera, WORLD_FROM_CAMERA, np.zeros(view.depth.shape))
    _check_format(_run(sense, no_surface, 0, name), no_surface, name)
    _check_draws(sense, [view, no_surface], name)
    again = _run(sense, view, 1, name)
    same = np.array_equal(measured.depth, again.depth)
    share = np.mean(measured.depth != again.depth)
    assert same, f"{name}: two images from one seed differ in {share:.2%} of their pixels"
    one, other = ((*view.world_from_camera.wxyz, *view.world_from_camera.xyz) for view in (measured, again))
    assert one == other, f"{name}: two camera poses from one seed differ"


def _bowl_depths(camera: Camera) -> np.ndarray:
    """(H, W) [m] depths of four planes, one in each quadrant about the middle, that rise from it towards the camera."""
    return MIDDLE_DEPTH / (1 + np.abs(_offset_from_middle(camera)).sum(axis=-1))


def _offset_from_middle(camera: Camera) -> np.ndarray:
    """(H, W, 2) x / z and y / z of each pixel, from the middle of the bowl."""
    points = camera.unproject(np.ones((camera.height, camera.width)))
    return points[..., :2] - MIDDLE_DIRECTION


def _hole_mask(camera: Camera) -> np.ndarray:
    """(H, W) bool: pixels without a surface, a window and a strip at the border."""
    hole = np.zeros((camera.height, camera.width), bool)
    hole[camera.height // 8 : camera.height // 4, camera.width // 8 : camera.width // 4] = True
    hole[-camera.height // 12 :] = True
    return hole


def _run(sense: Sense, view: View, seed: int, name: str) -> View:
    """The measured view; the sensor must not change its input."""
    before = view.depth.copy()
    try:
        measured = sense(view, np.random.default_rng(seed))
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        raise AssertionError(f"{name}: modifies its input ({error})") from error
    changed = int((view.depth != before).sum())
    assert not changed, f"{name}: modifies its input: {changed} pixels changed"
    return measured


def _check_format(measured: View, view: View, name: str) -> None:
    assert isinstance(measured, View), f"{name}: returns a {type(measured).__name__}, expected a kit1000.values.View"
    assert measured.camera == view.camera, f"{name}: returns an image of {measured.camera}, expected {view.camera}"
    depth = measured.depth
    assert depth.dtype == np.float32, f"{name}: depths are {depth.dtype}, expected float32"
    assert not depth.flags.writeable, f"{name}: depths are not read-only"
    assert np.isfinite(depth).all(), f"{name}: {int((~np.isfinite(depth)).sum())} depths are not finite"
    assert depth.min() >= 0, f"{name}: the smallest depth is {depth.min():.4g} m, expected 0 for no return, else more"
    steps = depth.astype(np.float64) / DEPTH_GRID
    off_grid = int((steps != np.rint(steps)).sum())
    assert not off_grid, f"{name}: {off_grid} depths are not multiples of 2^-13 m, the resolution of recordings"
    invented = int(((depth > 0) & (view.depth == 0)).sum())
    assert not invented, f"{name}: has a depth in {invented} pixels without a surface, expected 0"


def _check_depths(measured: View, view: View, depth_error: float, name: str) -> None:
    returned = measured.depth > 0
    share = returned.sum() / (view.depth > 0).sum()
    reason = f"{share:.0%} of the pixels of a surface at 0.4 to 1 m have a depth, expected {LEAST_RETURNS:.0%}"
    assert share >= LEAST_RETURNS, f"{name}: {reason}"
    error = measured.depth.astype(np.float64) - view.depth
    median = float(np.median(np.abs(error[returned])))
    hint = likely_cause(measured.depth, view.camera, _bowl_depths) if median > depth_error else ""
    assert median <= depth_error, f"{name}: depths have a median error of {median * 1e3:.1f} mm{hint}"
    shifts = _pixel_shifts(view, error, returned & (np.abs(error) <= 4 * median + DEPTH_GRID))
    for side, shift in zip(("right of", "below"), shifts, strict=True):
        assert abs(shift) <= SHIFT_TOLERANCE, f"{name}: pixels show surfaces {shift:+.2f} px {side} them"


def _pixel_shifts(view: View, error: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """(2,) [px] offset of the image, to the right and down, from the surfaces that it shows.

    Opposite planes distinguish an offset from an error of scale: least squares for both, over the pixels `kept`.
    """
    camera, middle = view.camera, _offset_from_middle(view.camera)[kept]
    z = view.depth[kept].astype(np.float64)
    slopes = -np.sign(middle) * (z**2 / MIDDLE_DEPTH)[:, None] / (camera.fx, camera.fy)  # [m/px]
    basis = np.column_stack([z, slopes])
    return np.linalg.lstsq(basis.T @ basis, basis.T @ error[kept], rcond=None)[0][1:]


def _check_pose(measured: Pose, true: Pose, position_error: float, rotation_error_deg: float, name: str) -> None:
    error = true.inverse() @ measured
    shift, angle_deg = float(np.linalg.norm(error.xyz)), float(np.degrees(error.angle()))
    if shift <= position_error and angle_deg <= rotation_error_deg:
        return
    swapped = true @ measured
    inverted = np.linalg.norm(swapped.xyz) <= position_error and np.degrees(swapped.angle()) <= rotation_error_deg
    hint = "; probably camera_from_world in place of world_from_camera" if inverted else ""
    raise AssertionError(
        f"{name}: the camera pose has an error of {shift * 1e3:.1f} mm and {angle_deg:.2f} degrees{hint}"
    )


def _check_draws(sense: Sense, views: list[View], name: str) -> None:
    """The generator is in the same state afterwards, whatever the image."""
    after = []
    for view in views:
        rng = np.random.default_rng(5)
        sense(view, rng)
        after.append(rng.random())
    assert len(set(after)) == 1, f"{name}: the number of random draws depends on the image"
