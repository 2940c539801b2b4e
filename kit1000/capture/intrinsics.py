"""The intrinsics of a depth image as users have them: perhaps without size, perhaps with distortion and a unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.camera import Camera
from kit1000.errors import InputError
from kit1000.sim.sensors import Stream

SHORTEST_FOCAL, LONGEST_FOCAL = 0.2, 20.0  # [widths of the image]: it sees 136 to 3 degrees
MOST_RATIO = 1.5  # of focal lengths
MOST_OFF_CENTRE = 0.35  # of the image's sides, from its middle to the principal point
NO_DISTORTION = 1e-9  # largest coefficient that is none
FORWARD_MODELS = {"plumb_bob": 5, "rational_polynomial": 8}
"""Models of OpenCV that map where a point is to where it is seen, and their largest number of coefficients."""
ALIASES = {"brown_conrady": "plumb_bob", "opencv": "plumb_bob", "plumb bob": "plumb_bob", "": "plumb_bob"}


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics with what their file says beside them."""

    fx: float
    """[px], as the next three."""
    fy: float
    cx: float
    """From the centre of the first pixel."""
    cy: float
    size: tuple[int, int] | None = None
    """Width and height of the image that they belong to [px]; None if they are not stated."""
    unit: float | None = None
    """[m] that 1 in the image stands for; None if it is not stated."""
    model: str = "plumb_bob"
    """Name of the distortion model."""
    coefficients: tuple[float, ...] = ()
    """Coefficients of the distortion; empty or 0: there is none."""
    device: str = ""
    """Name of the camera, if it is stated."""
    baseline: float | None = None
    """[m] between its imagers, if it is stated."""
    stream: Stream | None = None
    """raw: the depth camera's own stream; aligned: resampled to another camera; None if it is not stated."""
    source: str = "--intrinsics"
    """The file, for messages."""

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.coefficients)
        if not np.isfinite(numbers).all() or self.fx <= 0 or self.fy <= 0:
            text = " ".join(f"{value:g}" for value in numbers[:4])
            raise InputError(f"{self.source}: fx fy cx cy {text}: expected finite numbers, focal lengths above 0 px")

    @property
    def distorted(self) -> bool:
        """Whether the image has distortion."""
        return any(abs(value) > NO_DISTORTION for value in self.coefficients)

    @property
    def forward_model(self) -> str:
        """The model of FORWARD_MODELS by which distortion can be undone; raises InputError for another one."""
        model = ALIASES.get(self.model.lower(), self.model.lower())
        if model not in FORWARD_MODELS or len(self.coefficients) > FORWARD_MODELS[model]:
            known = ", ".join(FORWARD_MODELS)
            count = f" of {len(self.coefficients)} coefficients" if model in FORWARD_MODELS else ""
            raise InputError(
                f"{self.source}: distortion by {self.model}{count}, expected none or {known}: rectify the images first"
            )
        return model

    def camera(self, shape: tuple[int, ...], image: str) -> Camera:
        """The pinhole camera of an image of a shape (H, W), its name for the message.

        Raises InputError if the intrinsics are of another size, their principal point is far from the middle, or their
        focal lengths are those of no depth camera.
        """
        height, width = shape
        if self.size is not None and self.size != (width, height):
            stated = f"{self.size[0]} x {self.size[1]} px"
            raise InputError(
                f"{self.source}: is of {stated}, {image} has {width} x {height}: give the intrinsics of the stream "
                "that was saved"
            )
        longest, shortest = LONGEST_FOCAL * width, SHORTEST_FOCAL * width
        if not (shortest <= self.fx <= longest and 1 / MOST_RATIO <= self.fx / self.fy <= MOST_RATIO):
            raise InputError(
                f"{self.source}: focal lengths {self.fx:g}, {self.fy:g} px, {image} is {width} px wide: expected two "
                f"alike, {shortest:.0f} to {longest:.0f} px: are they in mm, or in another order than fx fy cx cy?"
            )
        across, down = self.cx / width - 0.5, self.cy / height - 0.5
        if max(abs(across), abs(down)) > MOST_OFF_CENTRE:
            raise InputError(
                f"{self.source}: principal point {self.cx:g}, {self.cy:g} of {image}, {width} x {height} px, is "
                f"{100 * across:.0f} % of its width and {100 * down:.0f} % of its height off the middle, expected "
                f"up to {100 * MOST_OFF_CENTRE:.0f}: are they of another stream, or is the image cropped?"
            )
        return Camera(width, height, self.fx, self.fy, self.cx, self.cy)


def distorted(x: np.ndarray, y: np.ndarray, coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Where points at x, y (of depth 1, without distortion) are seen, by OpenCV's k1 k2 p1 p2 k3 k4 k5 k6."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *(0.0,) * (8 - len(coefficients)))
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    across = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    down = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return across, down
