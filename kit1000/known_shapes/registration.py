"""Registration of a scene: poses of kits and parts in a depth image, the depth scale, and how sure each pose is.

The kits are one rigid body that stands as designed; a part may stand on any of its stable faces. Every pose is judged
by what it leaves unexplained of the disparity image, and by its lead over other poses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kit1000.known_shapes.disparity import DisparityImage
from kit1000.known_shapes.fit import FINE, fit, place_covariance
from kit1000.known_shapes.scene_search import GAP, SPOT, Bodies, SceneSearch
from kit1000.known_shapes.shapes import KnownShape, StandingShape, apart, neighbours
from kit1000.known_shapes.support import Support, seen_support
from kit1000.perception.calibration.depth_scale import MOST_SCALE, DepthScale, stated_scale
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth

EDGE_CORRELATION = 25.0  # by which edges that vary slowly make the scale less certain than independent pixels would
SCALE_SPREAD_A_PX = 0.4e-3  # of the scale by one shape, for each pixel by which edges extend: 2.3e-3 for a D415 (val)
LEAST_SCALE_SPREAD = 1e-4
GOOD, CLEAR_LEAD = 0.03, 50.0  # unexplained share and lead of a certain pose: of 100 such poses of val 94 are right
MOST_SPREAD = 1.25e-3  # [m] of a certain pose, by the depth scale
MOST_OPEN = 0.5e-3  # [m] of a certain pose, by what is seen of it
CERTAIN = 0.8  # confidence of a certain motion: of 326 imported ones 43 % are certain, 93 % of these seated
SURFACE_SHARE = 3.0  # by which a part lies off, over the RMS distance of its surface along its normals
# Log odds that a motion is seated: constant, and weights of what part and kits leave unexplained, of the lead that the
# part's pose lacks, as a share, and of the spread of the motion [mm]. Fitted to train and val, on tracks and imported.
ODDS = (5.3, -45.0, -0.9, -1.5)
CONFIDENCE_DECIMALS = 4
SAME_POSE = 3e-3  # [m] by which the surfaces of two poses differ that count as one


@dataclass(frozen=True)
class Agreement:
    """How well a pose explains the image."""

    unexplained: float
    """Share of the pixels in and about the shape."""
    lead: float | None
    """The number of pixels that the best other pose explains less; None without one."""
    depth: float
    """[m] median absolute difference of measured and rendered depth."""
    spread: float = 0.0
    """[m] RMS distance by which its surface may lie off along its normals: larger if much of it is hidden."""

    @property
    def faults(self) -> tuple[str, ...]:
        """Why the pose may be wrong; none if the image alone tells that it is right."""
        found = []
        if self.unexplained > GOOD:
            found.append(f"{self.unexplained:.0%} of what is seen about it is not explained")
        if self.lead is not None and self.lead < CLEAR_LEAD:
            found.append("another pose explains the image nearly as well")
        if self.spread > MOST_OPEN:
            found.append(f"too little of it is seen to place its surface within {MOST_OPEN * 1e3:g} mm")
        return tuple(found)


@dataclass(frozen=True, eq=False)
class RegisteredBody:
    """A shape at its pose."""

    standing: StandingShape
    label: int
    """The mask that shows it; 0 if none does."""
    agreement: Agreement

    @property
    def name(self) -> str:
        """Name of its shape."""
        return self.standing.shape.name


@dataclass(frozen=True, eq=False)
class RegisteredScene:
    """The kits and the parts that were found, in the order in which they were given."""

    bodies: tuple[RegisteredBody, ...]
    image: DisparityImage
    """In which they were found."""
    scale: float
    """Measured over true depth."""
    scale_spread: float
    """Standard deviation of the scale."""

    def camera_from_body(self, body: RegisteredBody) -> Pose:
        """The pose of a body in true lengths."""
        return body.standing.camera_from_body(self.scale)

    def doubts(self, body: RegisteredBody) -> tuple[str, ...]:
        """Why the image alone does not settle the pose of a body; a person confirms it in any case."""
        found = list(body.agreement.faults)
        if body.label == 0:
            found.append("no mask shows it alone")
        if abs(self.scale - 1) > MOST_SCALE:
            found.append(f"the depth scale would be {(self.scale - 1) * 1e2:+.1f} %: wrong shapes, or wrong intrinsics")
        spread = self.left_open(body.standing.camera_from_body())
        if spread > MOST_SPREAD:
            found.append(f"its distance is open: ± {spread * 1e3:.1f} mm along the line of sight")
        return tuple(found)

    def confidence(self, part: RegisteredBody, motion: Pose) -> float:
        """The share of such motions that are seated. motion: goal_from_now in the camera frame, in true lengths."""
        left = part.agreement.unexplained + self.bodies[0].agreement.unexplained
        lead = CLEAR_LEAD if part.agreement.lead is None else part.agreement.lead
        doubt = 1 - min(max(lead, 0.0) / CLEAR_LEAD, 1.0)
        spread = math.hypot(self.left_open(motion), SURFACE_SHARE * part.agreement.spread)
        facts = (1.0, left, doubt, 1e3 * spread)
        odds = sum(weight * value for weight, value in zip(ODDS, facts, strict=True))
        return round(1 / (1 + math.exp(-odds)), CONFIDENCE_DECIMALS)

    def motion_doubts(self, part: RegisteredBody, motion: Pose) -> tuple[str, ...]:
        """Why a motion of a part may not seat it. motion: goal_from_now in the camera frame, in true lengths."""
        share = self.confidence(part, motion)
        if share >= CERTAIN and abs(self.scale - 1) <= MOST_SCALE:
            return ()
        kits = (f"kits: {doubt}" for doubt in self.doubts(self.bodies[0]))
        return (f"{share:.0%} of such motions are seated", *self.doubts(part), *kits)

    def surest_motion(self, part: RegisteredBody, goals: Pose) -> Pose:
        """The motion to one of the goals (k,) kits_from_part, in the camera frame, that the scale leaves least open."""
        motions = self.camera_from_body(self.bodies[0]) @ goals @ self.camera_from_body(part).inverse()
        return min(motions, key=self.left_open)

    def left_open(self, pose: Pose) -> float:
        """[m] standard deviation of a pose or a motion in the camera frame by the depth scale.

        A wrong scale moves all that is seen to or from the camera: a pose by its own translation, a motion by that of
        the motion.
        """
        return self.scale_spread * float(np.linalg.norm(pose.xyz))


def register_scene(
    image: LabelledDepth,
    sensor: SensorFacts,
    kits: KnownShape,
    parts: Sequence[KnownShape],
    scale: DepthScale | None = None,
    support: Support | None = None,
) -> RegisteredScene:
    """Find known shapes in a depth image.

    Args:
        image: the depth image with masks, which may be wrong at their borders.
        sensor: that took it.
        kits: all kits as one shape.
        parts: those of the scene, in any order; fewer than it shows parts is allowed.
        scale: of the depths, before the sizes of the shapes tell it; None: what the sensor and a stated pose tell.
        support: the table; None: the plane that its depths show.

    Raises:
        InputError: the image shows no kits, or too little of the table.
    """
    table = support or seen_support(image)
    search = SceneSearch(DisparityImage.of(image, sensor, table), image.labels)
    return registered_from(search, search.bodies(kits, parts), scale or stated_scale(sensor, -table.offset))


def registered_from(search: SceneSearch, bodies: Bodies, before: DepthScale) -> RegisteredScene:
    """The scene refined from places that are within some millimetres; moves the bodies.

    before: the depth scale without the sizes of the shapes.
    """
    scale, spread = _depth_scale(search.image, bodies, before)
    search.refine(bodies, FINE, scale)
    found = [body for body in bodies if body is not None]
    labels = [ASSEMBLY_LABEL, *(_mask_of(body, search, scale) for body in found[1:])]
    registered = (
        RegisteredBody(body, label if labels.count(label) == 1 else 0, _agreement(body, found, search, scale))
        for body, label in zip(found, labels, strict=True)
    )
    return RegisteredScene(tuple(registered), search.image, scale, spread)


def _depth_scale(image: DisparityImage, bodies: Bodies, before: DepthScale) -> DepthScale:
    """The depth scale by the sizes of all bodies too. before: without them."""
    certainty, total = before.spread**-2, before.spread**-2 * float(np.log(before.value))
    least = max(SCALE_SPREAD_A_PX * image.extension, LEAST_SCALE_SPREAD)
    for body in bodies:
        if body is None:
            continue
        found = fit(image, body, neighbours(body, bodies, GAP), reaches=FINE[1:], free_scale=True)
        own = 1 / (EDGE_CORRELATION * found.covariance[3, 3] + least**2)
        certainty, total = certainty + own, total + own * found.log_scale
    return DepthScale(float(np.exp(total / certainty)), float(certainty**-0.5))


def _agreement(body: StandingShape, bodies: Sequence[StandingShape], search: SceneSearch, scale: float) -> Agreement:
    """The agreement of a body, with its lead over rivals at its spot."""
    distance, pose = body.shape.distance, body.camera_from_body()
    near = (other for other in search.rivals[body.shape.name] if apart(body, other) < SPOT)
    others = [each for each in near if distance.between(pose, each.camera_from_body()) > SAME_POSE]
    rest = [each for each in bodies if each is not body]
    gains = [search.window(each, rest).explained(each).gain for each in (body, *others)]
    lead = gains[0] - max(gains[1:]) if others else None
    return replace(agreement(search.image, body, neighbours(body, rest, GAP), scale), lead=lead)


def _mask_of(body: StandingShape, search: SceneSearch, scale: float) -> int:
    """The mask of a part with most of the body's pixels; 0 if there is none."""
    window = search.image.window(body, scale=scale)
    labels = search.labels[window.box.window][window.exact(body)[1]]
    counts = np.bincount(labels[labels >= FIRST_PART_LABEL], minlength=1)
    return int(counts.argmax()) if counts.any() else 0


def agreement(
    image: DisparityImage, body: StandingShape, beside: Sequence[StandingShape], scale: float = 1.0
) -> Agreement:
    """How well a shape at its place explains an image, with the shapes beside it."""
    window = image.window(body, beside, scale)
    exact, inside = window.exact(body)
    both = inside & (window.measured > 0)
    off = np.abs(image.gain / window.measured[both] - image.gain / exact[both]) if both.any() else np.array([np.inf])
    spread = body.surface_spread(place_covariance(window, body))
    return Agreement(window.explained(body).misfit, None, float(np.median(off)), spread)
