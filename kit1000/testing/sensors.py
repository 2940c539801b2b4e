"""Whether a depth sensor keeps the promises that recordings, readers and methods rely on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kit1000.camera import Camera, look_at
from kit1000.pose import Pose
from kit1000.sim.cameras import CAMERA
from kit1000.sim.sensors import DEPTH_GRID
from kit1000.testing.depths import as_if
from kit1000.values import View

Sense = Callable[[View, np.random.Generator], View]
"""Makes of an ideal view what the sensor measures; `world_from_camera` is then the pose that the sensor believes."""

SHIFT = 0.25
"""[px] Most by which an image may lie beside its surfaces."""
RETURNS = 0.5
"""Least share of a surface before the sensor that gives a return."""
MIDDLE = 1.0  # [m] to the middle of the bowl
SIDEWAYS = (0.12, -0.07)  # where the middle of the bowl lies, x / z and y / z: a mirrored image differs
SEEN_FROM = look_at((0.5, 0.3, 0.7), (0.0, 0.0, 0.0))


def check_sensor(
    sense: Sense,
    name: str = "sensor",
    depth_error: float = 0.01,
    position_error: float = 0.01,
    rotation_error_deg: float = 1.0,
) -> None:
    """Check a depth sensor on a bowl of four planes, 0.4 to 1 m away, with a hole in it.

    It measures what is there and where it is; nothing where nothing is; on the grid of depths that recordings store.
    It leaves its input alone, and the generator alone decides: the same draws give the same image, and how many
    numbers are drawn does not depend on what is seen.

    Args:
        sense: the sensor.
        name: opens every message.
        depth_error: [m] allowed median error of a depth.
        position_error: [m] allowed error of the believed position, in each of a few draws.
        rotation_error_deg: [degrees] the same for the believed rotation.
    """
    view = View(CAMERA, SEEN_FROM, np.where(_hole(CAMERA), 0, _bowl(CAMERA)))
    first, seen = (_sensed(sense, view, seed, name) for seed in (0, 1))
    for image in (first, seen):
        _check_form(image, view, name)
        _check_depths(image, view, depth_error, name)
        _check_pose(image.world_from_camera, view.world_from_camera, position_error, rotation_error_deg, name)
    nothing = View(CAMERA, SEEN_FROM, np.zeros(view.depth.shape))
    _check_form(_sensed(sense, nothing, 0, name), nothing, name)
    _check_draws(sense, [view, nothing], name)
    again = _sensed(sense, view, 1, name)
    same = np.array_equal(seen.depth, again.depth)
    assert same, f"{name}: two images from one seed differ in {np.mean(seen.depth != again.depth):.2%} of their pixels"
    one, other = ((*view.world_from_camera.wxyz, *view.world_from_camera.xyz) for view in (seen, again))
    assert one == other, f"{name}: two believed poses from one seed differ"


def _bowl(camera: Camera) -> np.ndarray:
    """(H, W) [m] four planes, one in each quadrant about their middle, from which they rise towards the camera."""
    return MIDDLE / (1 + np.abs(_from_middle(camera)).sum(axis=-1))


def _from_middle(camera: Camera) -> np.ndarray:
    """(H, W, 2) x / z and y / z from the middle of the bowl."""
    points = camera.unproject(np.ones((camera.height, camera.width)))
    return points[..., :2] - SIDEWAYS


def _hole(camera: Camera) -> np.ndarray:
    """(H, W) where nothing is to be seen: a window and a strip at the border."""
    hole = np.zeros((camera.height, camera.width), bool)
    hole[camera.height // 8 : camera.height // 4, camera.width // 8 : camera.width // 4] = True
    hole[-camera.height // 12 :] = True
    return hole


def _sensed(sense: Sense, view: View, seed: int, name: str) -> View:
    """What the sensor makes of a view, which it must leave as it was."""
    kept = view.depth.copy()
    try:
        seen = sense(view, np.random.default_rng(seed))
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        raise AssertionError(f"{name}: writes into the view that it is given ({error})") from error
    changed = int((view.depth != kept).sum())
    assert not changed, f"{name}: writes into the view that it is given: {changed} pixels changed"
    return seen


def _check_form(seen: View, view: View, name: str) -> None:
    assert isinstance(seen, View), f"{name}: gives a {type(seen).__name__}, expected a kit1000.values.View"
    assert seen.camera == view.camera, f"{name}: gives an image of {seen.camera}, expected {view.camera}"
    depth = seen.depth
    assert depth.dtype == np.float32, f"{name}: depths are {depth.dtype}, expected float32"
    assert not depth.flags.writeable, f"{name}: depths can be written to"
    assert np.isfinite(depth).all(), f"{name}: {int((~np.isfinite(depth)).sum())} depths are not finite"
    assert depth.min() >= 0, f"{name}: the smallest depth is {depth.min():.4g} m; 0 says that there is no return"
    steps = depth.astype(np.float64) / DEPTH_GRID
    beside = int((steps != np.rint(steps)).sum())
    assert not beside, f"{name}: {beside} depths lie beside the grid of 2^-13 m on which depths are stored"
    invented = int(((depth > 0) & (view.depth == 0)).sum())
    assert not invented, f"{name}: measures {invented} pixels where nothing is to be seen (holes must stay 0)"


def _check_depths(seen: View, view: View, depth_error: float, name: str) -> None:
    found = seen.depth > 0
    share = found.sum() / (view.depth > 0).sum()
    assert share >= RETURNS, f"{name}: {share:.0%} of a surface at 0.4 to 1 m gives a return, expected {RETURNS:.0%}"
    error = seen.depth.astype(np.float64) - view.depth
    median = float(np.median(np.abs(error[found])))
    hint = as_if(seen.depth, view.camera, _bowl) if median > depth_error else ""
    assert median <= depth_error, f"{name}: depths are off by {median * 1e3:.1f} mm in the median{hint}"
    shifts = _shifts(view, error, found & (np.abs(error) <= 4 * median + DEPTH_GRID))
    for way, shift in zip(("across", "down"), shifts, strict=True):
        assert abs(shift) <= SHIFT, f"{name}: pixels show what lies {shift:+.2f} px {way} of them"


def _shifts(view: View, error: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """How far across and down [px] of each pixel the depth lies that it holds: (2,).

    Opposite planes tell a shift from an error of scale: least squares for both at once, over the kept pixels.
    """
    camera, middle = view.camera, _from_middle(view.camera)[kept]
    z = view.depth[kept].astype(np.float64)
    slopes = -np.sign(middle) * (z**2 / MIDDLE)[:, None] / (camera.fx, camera.fy)  # [m/px]
    basis = np.column_stack([z, slopes])
    return np.linalg.lstsq(basis.T @ basis, basis.T @ error[kept], rcond=None)[0][1:]


def _check_pose(believed: Pose, true: Pose, position_error: float, rotation_error_deg: float, name: str) -> None:
    error = true.inverse() @ believed
    shift, turn = float(np.linalg.norm(error.xyz)), float(np.degrees(error.angle()))
    if shift <= position_error and turn <= rotation_error_deg:
        return
    swapped = true @ believed
    near = np.linalg.norm(swapped.xyz) <= position_error and np.degrees(swapped.angle()) <= rotation_error_deg
    hint = ": it looks like camera_from_world, expected world_from_camera" if near else ""
    raise AssertionError(f"{name}: the believed pose is off by {shift * 1e3:.1f} mm and {turn:.2f} degrees{hint}")


def _check_draws(sense: Sense, views: list[View], name: str) -> None:
    """The generator is left in the same state, whatever is seen."""
    after = []
    for view in views:
        rng = np.random.default_rng(5)
        sense(view, rng)
        after.append(rng.random())
    assert len(set(after)) == 1, f"{name}: how many numbers are drawn depends on what is seen"
