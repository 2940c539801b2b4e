"""A world of rigid bodies under gravity: the one owner of a pybullet client.

Bodies are convex hulls, which on a plane touch exactly as the solids do, or several of them in one piece. Everything is
SI; quaternions are wxyz, and pybullet's (x, y, z, w) is met in this file alone. The same calls in the same order give
the same bytes.
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from kit1000.errors import InputError, ShapeError, checked
from kit1000.pose import Pose

GRAVITY = 9.81  # [m/s^2] along -z
STEP_RATE = 240  # [1/s] steps
MARGIN = 1e-4  # [m] bodies keep so far apart; pybullet's own 1 mm lets a part of some centimetres stand on air
FRICTION = 0.5
MAX_HULL_VERTICES = 1000  # of a hull; a rounder one is thinned, by some 0.2 % of its radius
# Written out so that the defaults of another release change nothing, and set in one call: a later call that names only
# some makes contacts rattle. At pybullet's own residual (1e-7) and contactERP (0.2), which is the share of an overlap
# that a step takes back, one part in thirty rattles on the spot for ever.
SOLVER = {
    "fixedTimeStep": 1 / STEP_RATE,
    "numSubSteps": 0,
    "numSolverIterations": 50,
    "solverResidualThreshold": 0.0,
    "contactERP": 0.05,
    "deterministicOverlappingPairs": 1,
    "enableConeFriction": 1,
}

# pybullet (3.2.7) never lets go of the rows of the point lists it is given, so the same rows serve again and again.
_point_rows: list[list[float]] = []
_point_rows_lock = threading.Lock()


class World:
    """A fresh, empty world for the length of a `with` block; nothing of it outlives the block."""

    def __init__(self) -> None:
        self._bullet: Any = None
        self.client: int | None = None
        """pybullet's number of the world while the block lasts, for callers who need more of pybullet."""

    def __enter__(self) -> World:
        self._bullet = _pybullet()
        client = self._bullet.connect(self._bullet.DIRECT)
        if client < 0:
            raise InputError("physics: pybullet opens no further world; a thousand are open already")
        self.client = client
        self._call("setGravity", 0.0, 0.0, -GRAVITY)
        self._call("setPhysicsEngineParameter", **SOLVER)
        return self

    def __exit__(self, *_: object) -> None:
        self._call("disconnect")
        self.client = None

    def add_ground(self, friction: float = FRICTION) -> int:
        """The plane z = 0, solid below. Returns the number of the body."""
        shape = self._call("createCollisionShape", self._bullet.GEOM_PLANE, planeNormal=[0.0, 0.0, 1.0])
        body = self._call("createMultiBody", 0.0, shape)
        self.change(body, lateralFriction=friction)
        return body

    def add_hull(
        self, points: np.ndarray, mass: float, inertia: np.ndarray, world_from_body: Pose, **dynamics: float
    ) -> int:
        """A body in the shape of the convex hull of points, at rest, with its centre of mass at its origin.

        Args:
            points: (n, 3) [m] in the frame of the body.
            mass: [kg]; 0 for a body that never moves.
            inertia: (3,) [kg m^2] about the axes of the frame, which must be the principal ones.
            world_from_body: where it starts.
            dynamics: further settings by the names that pybullet's changeDynamics has for them.

        Returns:
            The number of the body.
        """
        return self._body(self._hull_shape(hull_vertices(points)), mass, inertia, world_from_body, dynamics)

    def add_pieces(
        self, pieces: Sequence[np.ndarray], mass: float, inertia: np.ndarray, world_from_body: Pose, **dynamics: float
    ) -> int:
        """A body in the shape of several convex hulls in one piece; all else is as for `add_hull`.

        pieces: each (n, 3) [m] in the frame of the body. They may overlap.
        """
        with tempfile.TemporaryDirectory() as folder:  # pybullet takes a compound of point sets from a file alone
            path = Path(folder, "pieces.obj")
            path.write_text(_obj_text([hull_vertices(piece) for piece in pieces]), encoding="ascii")
            shape = self._call("createCollisionShape", self._bullet.GEOM_MESH, fileName=str(path))
            return self._body(shape, mass, inertia, world_from_body, dynamics)

    def change(self, body: int, **dynamics: float) -> None:
        """Other settings for a body, by the names that pybullet's changeDynamics has for them."""
        self._call("changeDynamics", body, -1, **dynamics)

    def push(self, body: int, force: np.ndarray, torque: np.ndarray) -> None:
        """Act on a body for the next step: force (3,) [N] at its centre of mass, and torque (3,) [N m], world axes."""
        at = self._call("getBasePositionAndOrientation", body)[0]
        world = self._bullet.WORLD_FRAME
        self._call("applyExternalForce", body, -1, np.asarray(force).tolist(), at, world)
        self._call("applyExternalTorque", body, -1, np.asarray(torque).tolist(), world)

    def step(self, steps: int = 1) -> None:
        """Let time pass: 1/RATE s a step."""
        for _ in range(steps):
            self._call("stepSimulation")

    def pose(self, body: int) -> Pose:
        """world_from_body"""
        xyz, xyzw = self._call("getBasePositionAndOrientation", body)
        return Pose(np.roll(xyzw, 1), np.array(xyz))

    def speeds(self, body: int) -> tuple[float, float]:
        """Of the centre of mass [m/s], and of the rotation [rad/s]."""
        (vx, vy, vz), (wx, wy, wz) = self._call("getBaseVelocity", body)
        return (vx * vx + vy * vy + vz * vz) ** 0.5, (wx * wx + wy * wy + wz * wz) ** 0.5

    def velocity(self, body: int) -> tuple[np.ndarray, np.ndarray]:
        """(3,) [m/s] of the centre of mass, and (3,) [rad/s] of the rotation, world axes."""
        linear, angular = self._call("getBaseVelocity", body)
        return np.array(linear), np.array(angular)

    def _body(
        self, shape: int, mass: float, inertia: np.ndarray, world_from_body: Pose, dynamics: dict[str, float]
    ) -> int:
        moments = checked("inertia", inertia, (3,)).tolist()
        xyzw = np.roll(world_from_body.wxyz, -1).tolist()
        body = self._call("createMultiBody", mass, shape, -1, world_from_body.xyz.tolist(), xyzw)
        self._call("changeDynamics", body, -1, localInertiaDiagonal=moments)
        self.change(body, **{"lateralFriction": FRICTION, "collisionMargin": MARGIN, **dynamics})
        return body

    def _hull_shape(self, corners: np.ndarray) -> int:
        with _point_rows_lock:
            _point_rows.extend([0.0, 0.0, 0.0] for _ in range(len(corners) - len(_point_rows)))
            rows = _point_rows[: len(corners)]
            for row, corner in zip(rows, corners.tolist(), strict=True):
                row[:] = corner
            return self._call("createCollisionShape", self._bullet.GEOM_MESH, vertices=rows)

    def _call(self, name: str, *args: Any, **settings: Any) -> Any:
        if self.client is None:
            raise InputError("physics: a World is used inside its `with` block")
        return getattr(self._bullet, name)(*args, **settings, physicsClientId=self.client)


def hull_vertices(points: np.ndarray) -> np.ndarray:
    """(k, 3) corners of the convex hull of points (n, 3), in their order; thinned when more than MOST_CORNERS.

    Thinned are those that stand out farthest in none of MOST_CORNERS even directions.
    """
    cloud = checked("points", points, ("n", 3))
    try:
        corners = cloud[np.unique(ConvexHull(cloud).simplices)]
    except (QhullError, ValueError):
        raise ShapeError(f"points: expected some that span a solid, got {len(cloud)} that span none") from None
    if len(corners) <= MAX_HULL_VERTICES:
        return corners
    return corners[np.unique((_even_directions(MAX_HULL_VERTICES) @ corners.T).argmax(1))]


def _obj_text(pieces: Sequence[np.ndarray]) -> str:
    """Point sets as OBJ text, an object each. Faces only name the points, which is all that pybullet reads of them."""
    lines, first = [], 1
    for number, points in enumerate(pieces):
        lines.append(f"o piece{number}")
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
        named = [*range(first, first + len(points)), first, first]
        lines += ["f {} {} {}".format(*named[i : i + 3]) for i in range(0, len(points), 3)]
        first += len(points)
    return "\n".join(lines) + "\n"


def _even_directions(n: int) -> np.ndarray:
    """(n, 3) unit vectors spread evenly: the golden spiral (Gonzalez 2010)."""
    heights = (2 * np.arange(n) + 1) / n - 1
    turns = np.arange(n) * (np.pi * (3 - 5**0.5))
    radii = np.sqrt(1 - heights**2)
    return np.column_stack([radii * np.cos(turns), radii * np.sin(turns), heights])


def _pybullet() -> Any:
    try:
        with _silent_stderr():
            import pybullet
    except ImportError:
        raise InputError("physics: needs pybullet: pip install 'kit1000[sim]'") from None
    return pybullet


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """What the process writes to its standard error is dropped: pybullet prints its build date when imported."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
