"""Conformance of a renderer with `kit1000.sim.render.render`: closed forms, and laws of any image."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence

import numpy as np
from manifold3d import Manifold

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pose import Pose
from kit1000.sim.render import RenderedImage
from kit1000.testing.depths import likely_cause, plane_depths, rays

Bodies = Sequence[tuple[Mesh, Pose]]
Render = Callable[[Camera, Pose, Bodies], RenderedImage]
"""Renders bodies, each a mesh and its `world_from_body`, for a camera at `world_from_camera`."""

DEPTH_TOLERANCE = 1e-5
"""Largest relative error of a depth."""
EDGE_TOLERANCE = 0.02
"""[px] A pixel nearer to an edge than this may show either side."""
CAMERA = Camera(width=160, height=120, fx=140.0, fy=150.0, cx=75.3, cy=62.4)
WORLD_FROM_CAMERA = look_at((0.4, -0.7, 0.6), (0.1, 0.0, 0.1))
IDENTITY = Pose.identity()


def check_renderer(render: Render, name: str = "renderer") -> None:
    """Check a renderer on a plane, a ball, edges between pixels, and bodies that occlude or intersect each other.

    Depth is along the optical axis, and 0 where nothing is visible; ids and faces identify the visible surface. Both
    sides of a face are visible. Faces behind the camera are not, and faces that cross its plane are clipped. Of
    coincident surfaces the first body is visible. Images are read-only and identical in every run, for any number of
    `threads` where the renderer has that parameter.
    """
    _check_empty_view(render, name)
    _check_plane(render, name)
    _check_pixel_centres(render, name)
    _check_ball(render, name)
    _check_occlusion(render, name)
    _check_clipping(render, name)
    _check_intersecting_bodies(render, name)


def _rectangle(corners: Sequence[Sequence[float]], flipped: bool = False) -> Mesh:
    """A flat rectangle of two faces."""
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(np.array(corners, float), faces[:, ::-1] if flipped else faces)


def _square(half: float, flipped: bool = False) -> Mesh:
    """A square in the plane z = 0."""
    return _rectangle([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)], flipped)


def _check_format(frame: RenderedImage, camera: Camera, name: str) -> None:
    for what, kind in (("depth", np.float32), ("body_ids", np.int16), ("face_ids", np.int32)):
        image = getattr(frame, what)
        size = (camera.height, camera.width)
        assert image.shape == size, f"{name}: {what} has shape {image.shape}, expected {size}"
        assert image.dtype == kind, f"{name}: {what} is {image.dtype}, expected {np.dtype(kind)}"
        assert not image.flags.writeable, f"{name}: {what} is not read-only"
    nothing = frame.body_ids == 0
    assert np.isfinite(frame.depth).all(), f"{name}: {int((~np.isfinite(frame.depth)).sum())} depths are not finite"
    full = float(np.abs(frame.depth[nothing]).max(initial=0))
    assert full == 0, f"{name}: depth is {full:.4g} m where no body is visible, expected 0"
    assert (frame.depth[~nothing] > 0).all(), f"{name}: depth is 0 or less where a body is visible"
    assert (frame.face_ids[nothing] == -1).all(), f"{name}: face_ids is not -1 where no body is visible"


def _check_empty_view(render: Render, name: str) -> None:
    behind = [(_square(9.0), Pose.from_translation((0, 0, -1)))]
    for bodies, case in (([], "without bodies"), (behind, "of a body behind the camera")):
        frame = render(CAMERA, IDENTITY, bodies)
        _check_format(frame, CAMERA, name)
        count = int((frame.body_ids > 0).sum())
        assert not count, f"{name}: {count} pixels {case} show a body"


def _check_plane(render: Render, name: str) -> None:
    tilt = Pose.from_rotvec((0.3, -0.2, 0.1), (0.03, -0.05, 0.8))
    normal = tilt.rotate(np.array([0.0, 0.0, 1.0]))
    formula = plane_depths(normal, float(normal @ tilt.xyz))
    expected = formula(CAMERA)
    for flipped in (False, True):
        frame = render(CAMERA, WORLD_FROM_CAMERA, [(_square(0.9, flipped), WORLD_FROM_CAMERA @ tilt)])
        _check_format(frame, CAMERA, name)
        side = "the back" if flipped else "the front"
        assert frame.body_ids.all(), f"{name}: {side} of a plane that fills the image is missing in some pixels"
        off = float(np.abs(frame.depth / expected - 1).max())
        hint = likely_cause(frame.depth, CAMERA, formula) if off > DEPTH_TOLERANCE else ""
        assert off <= DEPTH_TOLERANCE, f"{name}: depths of a tilted plane have errors of up to {off:.2%}{hint}"


def _check_pixel_centres(render: Render, name: str) -> None:
    """A rectangle over columns 9.6 .. 25.4 and rows 5.3 .. 20.6 is visible in the pixels whose centres are inside."""
    camera = Camera(width=32, height=24, fx=16.0, fy=16.0, cx=10.0, cy=5.0)
    left, right, top, bottom = ((edge - c) / 16 for edge, c in ((9.6, 10), (25.4, 10), (5.3, 5), (20.6, 5)))
    rectangle = _rectangle([(left, top, 1), (right, top, 1), (right, bottom, 1), (left, bottom, 1)])
    rows, columns = np.nonzero(render(camera, IDENTITY, [(rectangle, IDENTITY)]).body_ids)
    found = (columns.min(), columns.max(), rows.min(), rows.max()) if len(rows) else ()
    complete = found == (10, 25, 6, 20) and len(rows) == 16 * 15
    actual = "columns {} to {}, rows {} to {}".format(*found) if found else "no pixels"
    expected = "columns 10 to 25, rows 6 to 20: pixel (u, v) has its centre at (u, v), +x right, +y down"
    assert complete, f"{name}: a rectangle is visible in {actual}, expected {expected}"


def _check_ball(render: Render, name: str) -> None:
    radius, middle = 0.2, np.array([0.15, -0.1, 0.9])
    ball = mesh_from_solid(Manifold.sphere(radius, 256))
    frame = render(CAMERA, WORLD_FROM_CAMERA, [(ball, WORLD_FROM_CAMERA @ Pose.from_translation(middle))])
    _check_format(frame, CAMERA, name)
    ray = rays(CAMERA)
    along, square = ray @ middle, (ray**2).sum(-1)
    root = along**2 - square * (middle @ middle - radius**2)
    inside, outside = root > 0.05 * radius**2, root < 0
    expected = (along - np.sqrt(np.where(inside, root, 0))) / square
    missing, outside_count = int((frame.body_ids[inside] != 1).sum()), int((frame.body_ids[outside] != 0).sum())
    assert not missing, f"{name}: {missing} pixels of a ball are missing"
    assert not outside_count, f"{name}: {outside_count} pixels outside the outline of a ball show it"
    off = float(np.abs(frame.depth - expected)[inside].max())
    assert off < 2e-3 * radius, f"{name}: depths of a ball have errors of up to {off * 1e3:.2f} mm"
    within = render(CAMERA, WORLD_FROM_CAMERA, [(ball.scaled(3.0), WORLD_FROM_CAMERA)])
    assert within.body_ids.all(), f"{name}: {int((within.body_ids == 0).sum())} pixels inside a ball show no surface"


def _check_occlusion(render: Render, name: str) -> None:
    near, far = Pose.from_translation((0, 0, 0.8)), Pose.from_translation((0, 0, 1.5))
    small, large = _square(0.1), _square(5.0)
    for bodies, first in (([(large, far), (small, near)], 2), ([(small, near), (large, far)], 1)):
        ids = render(CAMERA, IDENTITY, bodies).body_ids
        visible = ids[62, 75], ids[5, 5]
        assert visible == (first, 3 - first), (
            f"{name}: ids {visible} of a near and a far body, expected {(first, 3 - first)}"
        )
    ids = render(CAMERA, IDENTITY, [(large, far), (large, far), (large, far)]).body_ids
    assert (ids == 1).all(), f"{name}: ids of coincident bodies are {np.unique(ids).tolist()}, expected the first, 1"


def _check_clipping(render: Render, name: str) -> None:
    """A floor below the camera that crosses its plane: the horizon is the row of the principal point."""
    level = look_at((0, 0, 0.3), (1, 0, 0.3))
    frame = render(CAMERA, level, [(_square(2000.0), IDENTITY)])
    _check_format(frame, CAMERA, name)
    below = np.arange(CAMERA.height) - CAMERA.cy
    assert not frame.body_ids[below < 0].any(), f"{name}: a floor is visible above the horizon"
    assert frame.body_ids[below > 1].all(), (
        f"{name}: a floor that crosses the plane of the camera is missing, expected clipped"
    )
    rows = below > 1
    off = np.abs(frame.depth[rows] / (0.3 * CAMERA.fy / below[rows, None]) - 1).max()
    assert off <= 1e-4, f"{name}: depths of a floor below the camera have errors of up to {off:.2%}"


def _check_intersecting_bodies(render: Render, name: str) -> None:
    """A box, a coarse ball and a rod that intersect: face ids, repetition and threads."""
    shapes = (
        Manifold.cube((0.3, 0.2, 0.25), True),
        Manifold.sphere(0.15, 12),
        Manifold.cylinder(0.6, 0.05, 0.08, 9, True),
    )
    rotvecs = ((0.3, 0.2, -0.5), (0.1, 0.7, 0.2), (1.2, -0.4, 0.1))
    positions = ((0.1, 0.0, 0.1), (0.25, 0.05, 0.15), (0.05, -0.1, 0.1))
    meshes = [mesh_from_solid(shape) for shape in shapes]
    bodies = [
        (mesh, Pose.from_rotvec(rotvec, xyz)) for mesh, rotvec, xyz in zip(meshes, rotvecs, positions, strict=True)
    ]
    frame = render(CAMERA, WORLD_FROM_CAMERA, bodies)
    _check_format(frame, CAMERA, name)
    missing = {1, 2, 3} - set(np.unique(frame.body_ids).tolist())
    assert not missing, f"{name}: ids {sorted(missing)} of three visible bodies are missing"
    for i, (mesh, pose) in enumerate(bodies):
        _check_faces(frame, i, (WORLD_FROM_CAMERA.inverse() @ pose).apply(mesh.triangles), name)
    _check_equal(frame, render(CAMERA, WORLD_FROM_CAMERA, bodies), "rendered again", name)
    if "threads" in inspect.signature(render).parameters:
        for threads in (1, 3):
            again = render(CAMERA, WORLD_FROM_CAMERA, bodies, threads=threads)  # pyright: ignore[reportCallIssue]
            _check_equal(frame, again, f"rendered by {threads} threads", name)


def _check_faces(frame: RenderedImage, body: int, triangles: np.ndarray, name: str) -> None:
    """Each pixel of a body is inside the face of its face id, at the depth of that face. triangles: (m, 3, 3) [m]."""
    v, u = np.nonzero(frame.body_ids == body + 1)
    faces = frame.face_ids[v, u]
    outside = int(((faces < 0) | (faces >= len(triangles))).sum())
    assert not outside, f"{name}: {outside} pixels have a face id that body {body} does not have"
    a, b, c = np.moveaxis(triangles[faces], 1, 0)
    ray, normal = rays(CAMERA)[v, u], np.cross(b - a, c - a)
    facing = np.einsum("ni,ni->n", normal, ray)
    steep = np.abs(facing) > 0.02 * np.linalg.norm(normal, axis=1) * np.linalg.norm(ray, axis=1)
    expected = np.einsum("ni,ni->n", normal, a)[steep] / facing[steep]
    off = np.abs(frame.depth[v, u][steep] / expected - 1)
    wrong = int((off > 1e-4).sum())
    assert not wrong, f"{name}: at {wrong} pixels of body {body} the depth differs from the face of their face id"
    corners = [CAMERA.project(corner) for corner in (a, b, c)]
    pixel = np.stack([u, v], axis=1)
    orientation = np.sign(facing)
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        side = end - start
        across, down = (pixel - start).T
        distance = (side[:, 0] * down - side[:, 1] * across) / np.linalg.norm(side, axis=1)  # [px]
        outside = int((orientation * distance < -EDGE_TOLERANCE).sum())
        assert not outside, f"{name}: {outside} pixels of body {body} lie outside the face of their face id"


def _check_equal(frame: RenderedImage, other: RenderedImage, case: str, name: str) -> None:
    for what in ("depth", "body_ids", "face_ids"):
        differ = int((getattr(frame, what) != getattr(other, what)).sum())
        assert not differ, f"{name}: {what} differs in {differ} pixels when {case}"
