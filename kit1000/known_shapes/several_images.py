"""A part of known shape in images from several places: the one pose that explains most of all images together.

A single image confuses faces and parts that look alike from its side. So each pose that one image proposes is refined
in all of them, and the sum of the pixels that it explains decides. Motions by what is left are averaged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from kit1000.known_shapes.fit import FINE, fit
from kit1000.known_shapes.registration import (
    CONFIDENCE_DECIMALS,
    SAME_POSE,
    RegisteredBody,
    RegisteredScene,
    agreement,
)
from kit1000.known_shapes.scene_search import GAP
from kit1000.known_shapes.shapes import ShapeDistance, StandingShape, neighbours
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.registration.rank import difference, mean_motion

NEAR = 8e-3  # [m] largest difference between motions of the same pose
LEAST_WEIGHT = 0.01  # of a motion in a mean
ROTATED = 0.2  # [rad] between two poses of a symmetric shape, at least


@dataclass(frozen=True, eq=False)
class PlacedScene:
    """The scene of an image, in the world of its camera."""

    scene: RegisteredScene
    world_from_camera: Pose

    def world_from(self, body: RegisteredBody) -> Pose:
        """The pose of a body in the world."""
        return self.world_from_camera @ self.scene.camera_from_body(body)

    @property
    def parts(self) -> tuple[RegisteredBody, ...]:
        """All bodies but the kits."""
        return self.scene.bodies[1:]

    def nearest(self, pivot: np.ndarray) -> tuple[RegisteredBody, float] | None:
        """The part whose middle is nearest to a point (3,) [m], and its distance [m]; None without parts."""
        middles = {body: self.world_from(body).apply(body.standing.shape.mesh.bounds.mean(0)) for body in self.parts}
        distances = {body: float(np.linalg.norm(middle - pivot)) for body, middle in middles.items()}
        return min(distances.items(), key=lambda entry: entry[1], default=None)

    def seen(self, pivot: np.ndarray) -> SeenPart | None:
        """The part nearest to a point (3,) [m]; None without parts."""
        found = self.nearest(pivot)
        return None if found is None else SeenPart(self, found[0], self.world_from(found[0]), found[1])


class SeenPart(NamedTuple):
    """A part in an image."""

    placed: PlacedScene
    body: RegisteredBody
    world_from_part: Pose
    """Its pose; of a symmetric shape perhaps another one than that of the body, with the same surface."""

    distance: float
    """[m] of its middle from the point where it was looked for."""
    instead_of: RegisteredBody | None = None
    """The body of the scene that it replaces, if another image proposed its pose."""

    @property
    def own(self) -> RegisteredBody:
        """The body of the scene in its place."""
        return self.instead_of or self.body

    @property
    def there(self) -> bool:
        """Whether it may be the part that was looked for."""
        return self.distance < self.body.standing.radius

    def rotated_like(self, other: SeenPart) -> SeenPart:
        """The part with the rotation in which another image sees it, if the shape is symmetric."""
        mesh = self.body.standing.shape.mesh
        return self._replace(world_from_part=rotated_like(self.world_from_part, other.world_from_part, mesh))


def one_part(seen: Sequence[SeenPart]) -> list[SeenPart]:
    """A part in several images, in all of them the same shape at the pose that they explain best together."""
    seen = [part for part in seen if part.there] or seen  # others are neighbours of a part that was not found
    poses: list[SeenPart] = []
    for part in seen:
        if not any(_alike(part, other) for other in poses):
            poses.append(part)
    if len(poses) > 1:
        found = [[_as_in(part, pose) for part in seen] for pose in poses]
        gains = [sum(_gain(part) for part in each) for each in found]
        best = int(np.argmax(gains))
        lead = gains[best] - max(gains[:best] + gains[best + 1 :])
        seen = [_with_lead(part, lead) for part in found[best]]
    return [part.rotated_like(seen[0]) for part in seen]


def _alike(one: SeenPart, other: SeenPart) -> bool:
    """Whether two images show a part as the same shape at the same pose, but for its place."""
    if one.body.name != other.body.name:
        return False
    shape = one.body.standing.shape
    alike = _rotated(one.world_from_part, other.world_from_part, shape.mesh)
    return shape.distance.between(one.world_from_part, alike) < SAME_POSE


def _as_in(part: SeenPart, other: SeenPart) -> SeenPart:
    """A part at the pose that another image shows, refined in its own; the part itself if the pose is its own."""
    if _alike(part, other):
        return part
    placed, scale = part.placed, part.placed.scene.scale
    pose = placed.world_from_camera.inverse() @ other.world_from_part
    image, shape = placed.scene.image, other.body.standing.shape
    standing = StandingShape.by_pose(shape, image.support, pose, scale)
    standing = fit(image, standing, _beside(part, standing), scale, FINE).shape
    body = RegisteredBody(standing, part.body.label, agreement(image, standing, _beside(part, standing), scale))
    return part._replace(body=body, world_from_part=placed.world_from(body), instead_of=part.body)


def _beside(part: SeenPart, standing: StandingShape) -> list[StandingShape]:
    """The bodies of an image beside a shape that takes the place of a part there."""
    bodies, name = part.placed.scene.bodies, standing.shape.name
    others = (body for body in bodies if body is not part.own and body.name != name)
    return neighbours(standing, [body.standing for body in others], GAP)


def _gain(part: SeenPart) -> float:
    """The pixels of its image that a part explains, less those that its shape explains where the image has it."""
    scene, standing = part.placed.scene, part.body.standing
    elsewhere = [body for body in scene.bodies if body.name == part.body.name and body is not part.own]
    gains = [
        scene.image.window(each, _beside(part, each), scene.scale).explained(each).gain
        for each in (standing, *(body.standing for body in elsewhere))
    ]
    return gains[0] - sum(gains[1:])


def _with_lead(part: SeenPart, lead: float) -> SeenPart:
    """A part with the lead of its pose [px] over those that other images propose."""
    return part._replace(body=replace(part.body, agreement=replace(part.body.agreement, lead=lead)))


def rotated_like(pose: Pose, other: Pose, mesh: Mesh) -> Pose:
    """A pose of a shape, rotated as another one if its surface stays: images see a symmetric shape at any of its poses.

    The middle of the shape stays. Poses that differ by less than ROTATED are two measurements of one.
    """
    alike = _rotated(pose, other, mesh)
    if (pose.inverse() @ alike).angle() < ROTATED or ShapeDistance(mesh).between(pose, alike) > SAME_POSE:
        return pose
    return alike


def _rotated(pose: Pose, other: Pose, mesh: Mesh) -> Pose:
    """A pose with the rotation of another one, about the middle of a shape."""
    middle = mesh.centroid
    return Pose(other.wxyz, pose.apply(middle) - other.rotate(middle))


def agreed_motions(images: Sequence[Sequence[PredictedMotion]], middle: np.ndarray) -> list[PredictedMotion]:
    """The motions by several images of a part whose middle is at (3,) [m]; the best are near one of every image.

    Each is the mean of the motions that images have near it, and fails if all of these do. An image without motions, in
    which the part fits no cavity, says nothing.
    """
    images = [image for image in images if image]
    if len(images) < 2:
        return [motion for image in images for motion in image]
    found: list[PredictedMotion] = []
    for motion in (motion for image in images for motion in image):

        def apart(other: PredictedMotion, motion: PredictedMotion = motion) -> float:
            return difference(motion.goal_from_now, other.goal_from_now, middle)

        near = [each for each in (min(image, key=apart) for image in images) if apart(each) < NEAR]
        weights = [max(each.confidence, LEAST_WEIGHT) for each in near]
        mean = mean_motion([each.goal_from_now for each in near], weights, middle)
        fails = math.prod(1 - each.confidence for each in near)
        found.append(PredictedMotion(mean, round(1 - fails, CONFIDENCE_DECIMALS)))
    return sorted(found, key=lambda motion: -motion.confidence)
