"""Labels of a scene while a person corrects them: move a body, let it fit again, take back, confirm, save.

The world of this module is in true lengths: the table at z = 0, the camera where it is once depths are divided by their
scale. A page only has to show it and to call these operations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kit1000.known_shapes.disparity import DisparityImage
from kit1000.known_shapes.fit import COARSE, FINE, fit
from kit1000.known_shapes.known_kits import KnownKits, read_known_kits
from kit1000.known_shapes.registration import agreement
from kit1000.known_shapes.scene_search import GAP
from kit1000.known_shapes.shapes import StandingShape, neighbours
from kit1000.known_shapes.support import seen_support
from kit1000.labelling.label_records import LabelledBody, LabelRecord, confirmed
from kit1000.labelling.labelling_session import OwnScenes, store
from kit1000.labelling.residual_pictures import residual_colours
from kit1000.labelling.scene_truth import true_camera
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.sim.render import render

POINT_STEP = 2  # [px] between shown points


class Correction:
    """The labels of one scene, with what was done to them."""

    def __init__(self, scenes: OwnScenes, record: LabelRecord, kits: KnownKits | None = None) -> None:
        """Begin with a record of a scene. kits: its shapes, read again when None."""
        self.scenes, self.record = scenes, record
        self.kits = kits or read_known_kits(record.source)
        _, self.image, sensor = scenes.image(record.scene_id, record.view)
        self.disparities = DisparityImage.of(self.image, sensor, seen_support(self.image))
        self._before: list[LabelRecord] = []

    @property
    def world_from_camera(self) -> Pose:
        """The pose of the camera in true lengths."""
        return true_camera(self.image.view, self.record.scale)

    @property
    def names(self) -> list[str]:
        """Names of the bodies, the kits first."""
        return [body.name for body in self.record.bodies]

    def body(self, name: str) -> LabelledBody:
        """A body by its name."""
        return self.record.bodies[self.names.index(name)]

    def mesh(self, name: str) -> Mesh:
        """The mesh of a body, in its own frame."""
        return self.kits.shape(name).mesh

    def world_from_body(self, name: str) -> Pose:
        """Where a body is."""
        return self.world_from_camera @ self.body(name).camera_from_body

    def move(self, name: str, world_from_body: Pose) -> None:
        """Put a body to a pose by hand."""
        self._put(name, self.world_from_camera.inverse() @ world_from_body)

    def fit(self, name: str) -> None:
        """Let a body that stands on the table fit to the image from where it is; the others and the scale stay."""
        body, scale = self._standing(self.body(name)), self.record.scale
        self._put(
            name, fit(self.disparities, body, self._beside(body), scale, (*COARSE, *FINE)).shape.camera_from_body(scale)
        )

    def take_back(self) -> bool:
        """Take back the last move or fit; False if nothing is left."""
        if not self._before:
            return False
        self.record = self._before.pop()
        return True

    def confirm(self, names: Sequence[str], person: str) -> None:
        """Confirm bodies in the name of a person."""
        self.record = confirmed(self.record, names, person)

    def save(self) -> None:
        """Write the record and its picture."""
        store(self.scenes, self.record, self.kits, self.image)

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Measured points (n, 3) [m] world of bodies and shapes, with colours (n, 3) uint8 by their residual."""
        bodies = [(self.mesh(body.name), body.camera_from_body) for body in self.record.bodies]
        view = self.image.view
        shown = render(view.camera, Pose.identity(), bodies, threads=1).depth.astype(float)
        colours = residual_colours(self.image, shown, self.record.scale)
        kept = ((self.image.labels > 0) | (shown > 0)) & (view.depth > 0)
        kept[1::POINT_STEP], kept[:, 1::POINT_STEP] = False, False
        v, u = np.nonzero(kept)
        depth = view.depth[v, u].astype(float) / self.record.scale
        seen = view.camera.unproject_pixels(np.stack([u, v], axis=-1).astype(float), depth)
        return self.world_from_camera.apply(seen), colours[v, u]

    def _standing(self, body: LabelledBody) -> StandingShape:
        shape, support = self.kits.shape(body.name), self.disparities.support
        return StandingShape.by_pose(shape, support, body.camera_from_body, self.record.scale)

    def _beside(self, standing: StandingShape) -> list[StandingShape]:
        others = (self._standing(body) for body in self.record.bodies if body.name != standing.shape.name)
        return neighbours(standing, list(others), GAP)

    def _put(self, name: str, camera_from_body: Pose) -> None:
        """Give a body a pose that a person chose: its old confirmation no longer holds."""
        moved = replace(self.body(name), camera_from_body=camera_from_body, moved=True, confirmed_by=None)
        standing = self._standing(moved)
        found = agreement(self.disparities, standing, self._beside(standing), self.record.scale)
        moved = replace(moved, agreement=found, doubts=found.faults)
        bodies = tuple(moved if body.name == name else body for body in self.record.bodies)
        self._before.append(self.record)
        self.record = replace(self.record, bodies=bodies)
