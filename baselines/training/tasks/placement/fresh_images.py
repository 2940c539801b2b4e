"""Images of recorded scenes measured anew: from another distance, as the mean of more frames, with other noise."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kit1000.camera import look_at
from kit1000.dataset.reader import RecordedScene
from kit1000.pose import Pose
from kit1000.queries.pivots import part_pivots
from kit1000.sim.cameras import CAMERA, in_view
from kit1000.sim.render import render
from kit1000.sim.sensors import sense
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, Query, Truth, View

LEAST_PIXELS = 200  # of a part in an image that is rendered again
NEARER_SHARE = 0.5  # of the images are rendered again
DISTANCES = (0.42, 0.85)  # [m] from which; the cameras of datasets stand at 0.55 to 0.92
FRAMES = (1, 1, 1, 3, 10, 30)  # of which an image is the mean, each in an equal share
SENSOR = "d415"


class Asked(NamedTuple):
    """A query about an image."""

    query: Query
    world_from_camera: Pose
    """Where the camera truly stood."""


def recorded_query(query: Query, scene: RecordedScene) -> Asked:
    """The query about the image that its scene has."""
    return Asked(query, scene.labelled_depth("ideal").view.world_from_camera)


def measured_query(query: Query, scene: RecordedScene, truth: Truth, rng: np.random.Generator) -> Asked:
    """The query about a drawn image of its scene."""
    frames, nearer = FRAMES[int(rng.integers(len(FRAMES)))], rng.random() < NEARER_SHARE
    distance = rng.uniform(*DISTANCES)
    image = rendered_from(scene, query, truth, distance) if nearer else None
    ideal = image or scene.labelled_depth("ideal")
    measured = LabelledDepth(sense(SENSOR, ideal.view, rng, frames), ideal.labels)
    return Asked(asked_again(query, measured, SENSOR), ideal.view.world_from_camera)


def rendered_from(scene: RecordedScene, query: Query, truth: Truth, distance: float) -> LabelledDepth | None:
    """The ideal image of a scene from a distance [m]; None where the query's part or goal is out of view.

    The camera keeps its direction and looks at the middle between the part and its goal.
    """
    recorded = scene.labelled_depth("ideal").view.world_from_camera
    middle = (truth.anchor + truth.goal_drawn.apply(truth.anchor)) / 2
    backward = recorded.rotate((0.0, 0.0, -1.0))
    pose = look_at(middle + distance * backward, middle)
    bodies = scene.bodies()
    mesh, world_from_part = bodies[FIRST_PART_LABEL + query.part]
    points = world_from_part.apply(mesh.vertices)
    if not in_view(CAMERA, pose, np.concatenate([points, truth.goal_drawn.apply(points)])):
        return None
    image = render(CAMERA, pose, bodies, threads=1)
    labels = np.maximum(image.body_ids - 1, 0).astype(np.uint8)  # nothing and table both become 0
    if np.count_nonzero(labels == FIRST_PART_LABEL + query.part) < LEAST_PIXELS:
        return None
    return LabelledDepth(View(CAMERA, pose, image.depth), labels)


def asked_again(query: Query, image: LabelledDepth, sensor: str) -> Query:
    """The query about another image of its scene."""
    pivot = part_pivots(image.view, image.labels).get(query.part, query.pivot)
    return replace(query, sensor=sensor, pivot=pivot, read_image=lambda: image)
