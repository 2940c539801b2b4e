"""What is under the cursor: seen surfaces and the table rendered once from the browser's camera, then looked up.

A lookup is one pixel of that image. The image is kept while the camera stands still.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from kit1000.camera import Camera
from kit1000.editor.seen_plates import TABLE, Plate, plate_at
from kit1000.editor.session import same_motion
from kit1000.mesh import Mesh
from kit1000.numerics.trigonometry import tangent
from kit1000.pose import Pose
from kit1000.sim.layout import table
from kit1000.sim.render import RenderedImage, render

HEIGHT = 360  # [px] of the rendered image: a pixel is about 2 mm of the scene
REACH = 30e-3  # [m] below a plate, where a part in its cavity still counts as over it


class Eye(NamedTuple):
    """The browser's camera."""

    world_from_camera: Pose
    fov: float  # [rad] from the top of the picture to its bottom
    aspect: float  # width over height

    def same_as(self, other: Eye) -> bool:
        """Whether both see the same picture, bit for bit."""
        return same_motion(self.world_from_camera, other.world_from_camera) and self[1:] == other[1:]

    def camera(self) -> Camera:
        """The camera of the rendered image."""
        width = max(1, round(HEIGHT * self.aspect))
        focal = HEIGHT / 2 / float(tangent(self.fov / 2))
        return Camera(width, HEIGHT, focal, focal, (width - 1) / 2, (HEIGHT - 1) / 2)

    def screen(self, point: np.ndarray) -> tuple[float, float]:
        """Where a point (3,) [m] world is on the screen: 0 to 1 from the left, and from the top."""
        camera = self.camera()
        u, v = camera.project(self.world_from_camera.inverse().apply(point)).tolist()
        return (u + 0.5) / camera.width, (v + 0.5) / camera.height

    def ray(self, screen: tuple[float, float]) -> np.ndarray:
        """(3,) the direction, in the world, to a place on the screen (0 to 1 from the left, and from the top)."""
        camera = self.camera()
        uv = np.array([screen[0] * camera.width - 0.5, screen[1] * camera.height - 0.5])
        return self.world_from_camera.rotate(camera.unproject_pixels(uv, np.array(1.0)))


class Support(NamedTuple):
    """A place where a part may stand."""

    point: np.ndarray  # (3,) [m] world, on the plate's plane
    plate: Plate  # A plate of the kits, or the table


class Surface(Protocol):
    """On which a body is put down."""

    def support(self, eye: Eye, screen: tuple[float, float]) -> Support | None:
        """Where a body under the cursor would stand; None if it cannot stand there.

        screen: 0 to 1 from the left, and from the top.
        """
        ...

    def below(self, point: np.ndarray) -> Plate:
        """The plane that a body at a point (3,) [m] stands on or over."""
        ...


class SurfaceImage:
    """Meshes and the table as an eye sees them."""

    def __init__(self, bodies: Sequence[tuple[Mesh, Pose]]) -> None:
        """bodies: meshes [m], each with its pose in the world."""
        self._bodies = [*bodies, (table(), Pose.identity())]
        self._eye: Eye | None = None
        self._image: RenderedImage | None = None

    def body(self, eye: Eye, screen: tuple[float, float]) -> int | None:
        """Index of the body at a place on the screen, that of the table the last; None if there is none."""
        pixel = self._pixel(eye, screen)
        found = 0 if pixel is None else int(self._rendered(eye).body_ids[pixel])
        return found - 1 if found else None

    def seen(self, eye: Eye, screen: tuple[float, float]) -> np.ndarray | None:
        """(3,) [m] the point of the surface at a place on the screen; None if there is none."""
        pixel = self._pixel(eye, screen)
        if pixel is None or self.body(eye, screen) is None:
            return None
        return eye.world_from_camera.xyz + eye.ray(screen) * float(self._rendered(eye).depth[pixel])

    def _pixel(self, eye: Eye, screen: tuple[float, float]) -> tuple[int, int] | None:
        camera = eye.camera()
        u, v = round(screen[0] * camera.width - 0.5), round(screen[1] * camera.height - 0.5)
        return (v, u) if 0 <= u < camera.width and 0 <= v < camera.height else None

    def _rendered(self, eye: Eye) -> RenderedImage:
        if self._image is None or self._eye is None or not eye.same_as(self._eye):
            self._eye = eye
            self._image = render(eye.camera(), eye.world_from_camera, self._bodies, threads=1)
        return self._image


class Pointing:
    """The plates of the kits and the table, on which parts are put."""

    def __init__(self, kits: Mesh, plates: list[Plate]) -> None:
        """kits: [m] world, as seen; holes in them are covered by the lids of the plates."""
        self.plates = plates
        self._image = SurfaceImage([(mesh, Pose.identity()) for mesh in (kits, *(plate.lid() for plate in plates))])

    def support(self, eye: Eye, screen: tuple[float, float]) -> Support | None:
        """Where a part under the cursor would stand; None off the table, or on a part of the kits that is no plate.

        screen: 0 to 1 from the left, and from the top.
        """
        plate = self._plate(eye, screen)
        crossing = None if plate is None else plate.crossing(eye.world_from_camera.xyz, eye.ray(screen))
        return None if plate is None or crossing is None else Support(crossing, plate)

    def below(self, point: np.ndarray) -> Plate:
        """The plate that a part at a point (3,) [m] stands on or over; the table if there is none."""
        over = [plate for plate in self.plates if float(plate.height(point)) > -REACH and _is_over(plate, point)]
        return max(over, key=lambda plate: float(plate.point[2]), default=TABLE)

    def _plate(self, eye: Eye, screen: tuple[float, float]) -> Plate | None:
        """The plate or the table at a place on the screen."""
        body, seen = self._image.body(eye, screen), self._image.seen(eye, screen)
        if body is None or seen is None:
            return None
        return plate_at(self.plates, seen) if body == 0 else (*self.plates, TABLE)[body - 1]


def _is_over(plate: Plate, point: np.ndarray) -> bool:
    """Whether a point (3,) [m] is on a plate, or above it by less than 0.2 m."""
    height = float(plate.height(point))
    across = point - plate.point - height * plate.normal
    return height < 0.2 and float(np.square(across).sum()) < plate.radius**2
