"""A physics world of rigid bodies under gravity, by pybullet.

A body is a convex hull, which on a plane has the contacts of the solid, or a compound of several hulls. Units are SI;
quaternions are wxyz, and pybullet's (x, y, z, w) occurs in this file only. The same calls in the same order give the
same bytes, on any x86-64 processor.
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
from kit1000.numerics.linear_algebra import matmul
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.pose import Pose

PHYSICS_MISSING = (
    "physics: pybullet is missing or does not load: pip install 'kit1000[sim]'; it has wheels for Python 3.10 and "
    "3.11, on other versions it is compiled, which needs a C++ compiler and the headers of Python"
)
GRAVITY = 9.81  # [m/s^2] along -z
STEP_RATE = 240  # [1/s]
MARGIN = 1e-4  # [m] collision margin; with pybullet's default, 1 mm, a part of a few centimetres rests visibly above
FRICTION = 0.5
MAX_HULL_VERTICES = 1000  # a rounder hull is simplified, by some 0.2 % of its radius
# Decimals of the state of a moving body after each step: [m], quaternion components, [m/s] and [rad/s]. pybullet calls
# libm, whose last bits depend on the processor, and contacts amplify them until a part rests on another face. Rounded
# after every step they do not add up. The grid is a thousandth of MARGIN, and of the speeds of a part at rest.
STATE_DECIMALS = 7
# All listed, so that other defaults in another version of pybullet change nothing, and set in one call: a later call
# with only some of them makes contacts jitter. At pybullet's default residual (1e-7) and contactERP (0.2, the fraction
# of an overlap that a step resolves) one part in thirty jitters for ever.
SOLVER = {
    "fixedTimeStep": 1 / STEP_RATE,
    "numSubSteps": 0,
    "numSolverIterations": 50,
    "solverResidualThreshold": 0.0,
    "contactERP": 0.05,
    "deterministicOverlappingPairs": 1,
    "enableConeFriction": 1,
}

# pybullet (3.2.7) never frees the rows of the point lists it is given, so all calls share these rows.
_point_rows: list[list[float]] = []
_point_rows_lock = threading.Lock()


class PhysicsMissing(InputError):
    """The physics engine is not installed, or does not load."""


def check_physics() -> None:
    """Raise PhysicsMissing if no world can be made."""
    _pybullet()


class World:
    """A physics world that exists during a `with` block, empty at its start."""

    def __init__(self) -> None:
        self._bullet: Any = None
        self.client: int | None = None
        """pybullet's client id during the block, for callers who need more of pybullet."""
        self._moving: list[int] = []

    def __enter__(self) -> World:
        self._bullet = _pybullet()
        client = self._bullet.connect(self._bullet.DIRECT)
        if client < 0:
            raise InputError("physics: pybullet opens no further world; a thousand are open already")
        self.client = client
        self._moving = []
        self._call("setGravity", 0.0, 0.0, -GRAVITY)
        self._call("setPhysicsEngineParameter", **SOLVER)
        return self

    def __exit__(self, *_: object) -> None:
        self._call("disconnect")
        self.client = None

    @property
    def engine(self) -> Any:
        """The module pybullet, for callers who need more of it with `client`."""
        return self._bullet

    def add_ground(self, friction: float = FRICTION) -> int:
        """Add the plane z = 0, solid below. Returns the body id."""
        shape = self._call("createCollisionShape", self._bullet.GEOM_PLANE, planeNormal=[0.0, 0.0, 1.0])
        body = self._call("createMultiBody", 0.0, shape)
        self.change(body, lateralFriction=friction)
        return body

    def add_hull(
        self, points: np.ndarray, mass: float, inertia: np.ndarray, world_from_body: Pose, **dynamics: float
    ) -> int:
        """Add the convex hull of points as a body, at rest, with its centre of mass at its origin.

        Args:
            points: (n, 3) [m] in the frame of the body.
            mass: [kg]; 0 for a fixed body.
            inertia: (3,) [kg m^2] about the axes of the frame, which must be the principal axes.
            world_from_body: initial pose.
            dynamics: further settings, named as in pybullet's changeDynamics.

        Returns:
            The body id.
        """
        return self._body(self._hull_shape(hull_vertices(points)), mass, inertia, world_from_body, dynamics)

    def add_pieces(
        self, pieces: Sequence[np.ndarray], mass: float, inertia: np.ndarray, world_from_body: Pose, **dynamics: float
    ) -> int:
        """Add a compound of several convex hulls as one body; all else is as for `add_hull`.

        pieces: each (n, 3) [m] in the frame of the body. They may overlap.
        """
        with tempfile.TemporaryDirectory() as folder:  # pybullet reads a compound of point sets only from a file
            path = Path(folder, "pieces.obj")
            path.write_text(_obj_text([hull_vertices(piece) for piece in pieces]), encoding="ascii")
            shape = self._call("createCollisionShape", self._bullet.GEOM_MESH, fileName=str(path))
            return self._body(shape, mass, inertia, world_from_body, dynamics)

    def change(self, body: int, **dynamics: float) -> None:
        """Change settings of a body, named as in pybullet's changeDynamics."""
        self._call("changeDynamics", body, -1, **dynamics)

    def push(self, body: int, force: np.ndarray, torque: np.ndarray) -> None:
        """Apply a force (3,) [N] at the centre of mass and a torque (3,) [N m] in the next step, along world axes."""
        at = self._call("getBasePositionAndOrientation", body)[0]
        world = self._bullet.WORLD_FRAME
        self._call("applyExternalForce", body, -1, np.asarray(force).tolist(), at, world)
        self._call("applyExternalTorque", body, -1, np.asarray(torque).tolist(), world)

    def step(self, steps: int = 1) -> None:
        """Advance the simulation by steps of 1/STEP_RATE s, each rounded to STATE_DECIMALS."""
        for _ in range(steps):
            self._call("stepSimulation")
            for body in self._moving:
                self._round_state(body)

    def pose(self, body: int) -> Pose:
        """world_from_body"""
        xyz, xyzw = self._call("getBasePositionAndOrientation", body)
        return Pose(np.roll(xyzw, 1), np.array(xyz))

    def speeds(self, body: int) -> tuple[float, float]:
        """Speed of the centre of mass [m/s] and angular speed [rad/s]."""
        (vx, vy, vz), (wx, wy, wz) = self._call("getBaseVelocity", body)
        return (vx * vx + vy * vy + vz * vz) ** 0.5, (wx * wx + wy * wy + wz * wz) ** 0.5

    def velocity(self, body: int) -> tuple[np.ndarray, np.ndarray]:
        """Velocity of the centre of mass (3,) [m/s] and angular velocity (3,) [rad/s], along world axes."""
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
        if mass > 0:
            self._moving.append(body)
        return body

    def _round_state(self, body: int) -> None:
        xyz, xyzw = self._call("getBasePositionAndOrientation", body)
        linear, angular = self._call("getBaseVelocity", body)
        # in this order: setting a pose stops the body
        self._call("resetBasePositionAndOrientation", body, _rounded(xyz), _rounded(xyzw))
        self._call("resetBaseVelocity", body, _rounded(linear), _rounded(angular))

    def _hull_shape(self, corners: np.ndarray) -> int:
        with _point_rows_lock:
            _point_rows.extend([0.0, 0.0, 0.0] for _ in range(len(corners) - len(_point_rows)))
            rows = _point_rows[: len(corners)]
            for row, corner in zip(rows, corners.tolist(), strict=True):
                row[:] = corner
            return self._call("createCollisionShape", self._bullet.GEOM_MESH, vertices=rows)

    def _call(self, name: str, *args: Any, **settings: Any) -> Any:
        if self.client is None:
            raise InputError("physics: a World can only be used inside its `with` block")
        return getattr(self._bullet, name)(*args, **settings, physicsClientId=self.client)


def hull_vertices(points: np.ndarray) -> np.ndarray:
    """(k, 3) vertices of the convex hull of points (n, 3), in their order; at most MAX_HULL_VERTICES.

    Of more vertices, only those that are the extreme point in one of MAX_HULL_VERTICES even directions are kept.
    """
    cloud = checked("points", points, ("n", 3))
    try:
        vertices = cloud[np.unique(ConvexHull(cloud).simplices)]
    except (QhullError, ValueError):
        raise ShapeError(f"points: expected points that span a solid, got {len(cloud)} that span none") from None
    if len(vertices) <= MAX_HULL_VERTICES:
        return vertices
    return vertices[np.unique((matmul(_even_directions(MAX_HULL_VERTICES), vertices.T)).argmax(1))]


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, STATE_DECIMALS) + 0.0 for value in values]  # never minus zero: its sign is that of a last bit


def _obj_text(pieces: Sequence[np.ndarray]) -> str:
    """Point sets as OBJ text, one object each. pybullet reads only the points that the faces list."""
    lines, first = [], 1
    for number, points in enumerate(pieces):
        lines.append(f"o piece{number}")
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
        indices = [*range(first, first + len(points)), first, first]
        lines += ["f {} {} {}".format(*indices[i : i + 3]) for i in range(0, len(points), 3)]
        first += len(points)
    return "\n".join(lines) + "\n"


def _even_directions(n: int) -> np.ndarray:
    """(n, 3) unit vectors spread evenly: the golden spiral (Gonzalez 2010)."""
    heights = (2 * np.arange(n) + 1) / n - 1
    angles = np.arange(n) * (np.pi * (3 - 5**0.5))
    radii = np.sqrt(1 - heights**2)
    return np.column_stack([radii * cosine(angles), radii * sine(angles), heights])


def _pybullet() -> Any:
    try:
        with _silent_stderr():
            import pybullet
    except Exception:  # ImportError, or what a library built for another system raises
        raise PhysicsMissing(PHYSICS_MISSING) from None
    return pybullet


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Discard the standard error of the process: pybullet prints its build date when imported."""
    stderr, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(null)
