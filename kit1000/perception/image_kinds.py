"""The kinds of depth image: what perception, registration and the robot must know about the errors of an image.

No method asks for the name of a sensor: it reads the attributes of `SensorFacts.kind`. A new kind of image is a new
value here; docs/reference/sensors.md describes the sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np


class Noise(NamedTuple):
    """Tolerances that the noise of an image asks for."""

    distance: float
    """[m] largest distance of a plane's points from the plane."""
    angle: float
    """[rad] largest angle between the facets of one face."""
    window: int
    """[px] side of the square over which normals are averaged."""
    square: float = 0.0
    """[rad] faces of a part that are upright or level within this angle are taken to be exactly so."""
    wavy_rims: bool = False
    """Whether rims of cavities may be farther off than `distance`."""


class Segmentation(NamedTuple):
    """Settings of the segmentation into parts by rules."""

    least_height: float
    """[m] lower surfaces belong to the table."""
    step: float
    """[m] least step in depth between neighbouring pixels, beyond what their slopes explain."""
    lever: int
    """[px] distance from a crease at which both sides are read."""
    valley: float
    """[m] least depth of a crease below the mean of both sides."""
    foot: float
    """[m] a piece that ends lower than this beside the table stands on it."""
    least_pixels: int
    """[px] smaller masks are noise, or a corner of a hidden part."""
    weights: tuple[float, ...]
    """Weight of each of `merging.FEATURES` of a pair of pieces, fitted to the split train."""
    network: bool = False
    """Whether a network may separate the parts instead."""


@dataclass(frozen=True)
class Refinement:
    """Settings of the refinement of candidates."""

    passes: tuple[Sequence[float], Sequence[float]]
    """[m] scales of the robust weights in both passes; the second pass sweeps the part in the refined rotation."""
    prior: float
    """Weight of the filled part beside the bounds of the part."""
    completed_prior: float
    """The same weight if a network completed the part."""
    noise_px: float = 0.0
    """[px] scale of the disparity residuals at which the best fits are refined in the image; 0: they are not."""
    doubtful: float = 2.0
    """Score of the best fit, up to which more candidates are refined: log odds that it is right."""
    raise_goal: float = 0.0
    """[m] the goal is raised out of the cavity by this per metre of the part's half width: a part that is tilted by
    an error touches the cavity's floor early."""


@dataclass(frozen=True)
class ImageKind:
    """Depth images with errors of one kind."""

    name: str
    """Simulated sensor whose tracks hold such images; of denoised images: restored."""
    ranking: str
    """Name of the weights that rank the fits, see `registration.rank.weights_of`. Scanners share those of ideal depth:
    their own, fitted to 70 queries, trusted wrong fits."""
    noise: Noise
    flatness: float
    """[m] deviation from a plane at which the robot's suction cup still seals, as the image shows the surface."""
    segmentation: Segmentation
    refinement: Refinement
    exact: bool = False
    """Whether there is nothing to calibrate."""
    restores: bool = False
    """Whether edges and planes are bent as by stereo cameras: rules or a network restore such an image."""
    fills_holes: bool = False
    """Whether pixels beside jumps have no return, as in the images of scanners: a network may fill holes in kits, and
    holes in parts are closed in two ways."""
    denoised: ImageKind | None = None
    """Kind of such an image after a network restored it; None: no network restores it."""

    @property
    def best(self) -> ImageKind:
        """Kind of such an image after all networks that may restore it."""
        return self.denoised or self


_SPLIT_WEIGHTS = (8.33, -0.12, -0.17, -0.07, -0.81, -4.10, -2.31, -1.16, 6.01, 5.46, 1.96, -0.57, 6.68)
_EXACT_REFINEMENT = Refinement(
    passes=((4e-3, 2e-3, 1e-3), (1e-3, 0.5e-3)),
    prior=0.1,
    completed_prior=0.1,
    doubtful=3.0,
)
_STEREO_REFINEMENT = Refinement(
    # Edges are off by 1.4 mm at random: a narrow scale would follow single walls.
    passes=((4e-3, 2e-3), (2e-3, 1.5e-3)),
    # The bounds of the part are hardly more certain than what a network fills.
    prior=0.3,
    completed_prior=1.0,
    noise_px=1.0,
)

IDEAL = ImageKind(
    name="ideal",
    ranking="ideal",
    noise=Noise(0.5e-3, float(np.radians(4)), 3),
    flatness=0.5e-3,
    segmentation=Segmentation(3e-4, 1.5e-3, 2, 0.35e-3, 2e-3, 60, _SPLIT_WEIGHTS),
    refinement=_EXACT_REFINEMENT,
    exact=True,
)
PHOTONEO = ImageKind(
    name="photoneo",
    ranking="ideal",
    noise=Noise(1e-3, float(np.radians(6)), 5, float(np.radians(6))),
    flatness=1e-3,
    segmentation=Segmentation(1e-3, 2e-3, 3, 1e-3, 2.5e-3, 60, _SPLIT_WEIGHTS),
    refinement=replace(_EXACT_REFINEMENT, noise_px=1.2, raise_goal=0.006),
    fills_holes=True,
)
RESTORED = ImageKind(
    name="restored",
    ranking="restored",
    noise=Noise(1.2e-3, float(np.radians(6)), 5, float(np.radians(6)), wavy_rims=True),
    flatness=2.5e-3,
    segmentation=Segmentation(1e-3, 2e-3, 3, 1e-3, 3e-3, 150, _SPLIT_WEIGHTS, network=True),
    refinement=replace(_STEREO_REFINEMENT, noise_px=0.6, raise_goal=0.014),
)
D415 = ImageKind(
    name="d415",
    ranking="d415",
    noise=Noise(2e-3, float(np.radians(8)), 7, float(np.radians(6))),
    flatness=2.5e-3,
    segmentation=Segmentation(
        *(2e-3, 4e-3, 5, 2.5e-3, 6e-3, 60),
        (2.73, -0.09, 0.03, -0.22, 0.08, 0.55, 0.32, -2.09, 6.02, 3.73, 0.45, -0.34, -5.13),
    ),
    refinement=_STEREO_REFINEMENT,
    restores=True,
    denoised=RESTORED,
)
