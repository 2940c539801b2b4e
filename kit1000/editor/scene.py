"""The scene that is edited: what may be shown of it, seen or true, and what the hand needs to know about its parts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull

from kit1000.capture.pose_files import stated_pose
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.editor.seen import ColouredPoints, SeenScene, coloured_points, observed, seen_scene
from kit1000.editor.seen_plates import Plate, find_plates, plates_of
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, Query, View

if TYPE_CHECKING:
    from kit1000.known_shapes.predictor import FoundShapes


@dataclass(frozen=True, eq=False)
class EditedScene:
    """A recorded scene, open for editing."""

    dataset: Dataset
    recorded: RecordedScene
    sensor: str
    truth: bool
    """Whether true shapes are shown; without, no file with truth is opened."""
    queries: dict[int, Query]
    """A query without a guess for each part that can be edited, by index."""
    base_from_camera: Pose | None = None
    """The camera in the base of the user's robot, if it is stated."""
    known: FoundShapes | None = None
    """The known shapes where they were found, which are then shown instead of what is seen."""
    drawn: LabelledDepth | None = None
    """The image with masks of the known shapes that no recorded mask shows."""

    @classmethod
    def open(
        cls, dataset: Dataset, scene_id: str, sensor: str, truth: bool, base_from_camera: Pose | None = None
    ) -> EditedScene:
        """A scene of the dataset's own list; raises InputError if there is none, or no part of it can be edited.

        base_from_camera: None for that of dataset.json, if it states one.
        """
        recorded = dataset.recorded_scene(scene_id, truth)
        base = _stated_base(dataset) if base_from_camera is None else base_from_camera
        return cls(dataset, recorded, sensor, truth, editable_queries(recorded, sensor), base)

    @property
    def parts(self) -> tuple[int, ...]:
        """Indices of the parts that can be edited."""
        return tuple(self.meshes)

    @property
    def image(self) -> LabelledDepth:
        """The depth image with its masks."""
        return self.drawn or self.recorded.labelled_depth(self.sensor)

    @property
    def view(self) -> View:
        """The depth image."""
        return self.image.view

    @cached_property
    def meshes(self) -> dict[int, Mesh]:
        """[m] world: the parts at their recorded poses."""
        if not self.truth:
            found = {} if self.known is None else {part: shape.mesh for part, shape in self.known.parts.items()}
            return dict(sorted({**self._seen.parts, **found}.items()))
        _, _, *parts = self.recorded.bodies()
        return {part: _placed(*parts[part]) for part in self.queries}

    @cached_property
    def kits(self) -> Mesh:
        """[m] world."""
        if self.known is not None:
            return self.known.kits.mesh
        return _placed(*self.recorded.bodies()[1]) if self.truth else self._seen.kits

    @cached_property
    def others(self) -> Mesh:
        """[m] world: the parts that cannot be edited, as seen."""
        return self._seen.others

    @cached_property
    def plates(self) -> list[Plate]:
        """As seen, or as the known shape has them, the largest first."""
        if self.truth or self.known is not None:
            return plates_of(self.kits)
        mask = self.image.labels == ASSEMBLY_LABEL
        return find_plates(self.view, mask, simulated_sensor(self.sensor).kind.noise)

    @cached_property
    def clouds(self) -> dict[int, np.ndarray]:
        """(n, 3) [m] points that bound each part at its recorded pose."""
        return {part: mesh.vertices[ConvexHull(mesh.vertices).vertices] for part, mesh in self.meshes.items()}

    @cached_property
    def tops(self) -> dict[int, np.ndarray]:
        """(n, 3) [m] world: the points of each part that the image shows."""
        return {part: observed(mesh) for part, mesh in self._seen.parts.items()}

    @cached_property
    def points(self) -> dict[int, ColouredPoints]:
        """The image as points, by label of its masks."""
        return coloured_points(self.image)

    @cached_property
    def bounds(self) -> np.ndarray:
        """(n, 3) [m] world: points that bound kits and parts."""
        points = np.concatenate([self.kits.vertices, *(mesh.vertices for mesh in self.meshes.values())])
        return points[ConvexHull(points).vertices]

    def is_sure(self, part: int) -> bool:
        """Whether the shape of a part was found, and its motion is sure."""
        found = None if self.known is None else self.known.parts.get(part)
        return found is not None and not found.doubts

    def pivot(self, part: int) -> np.ndarray:
        """(3,) [m] world: the middle of what is seen of a part at its recorded pose."""
        return self.queries[part].pivot

    @cached_property
    def _seen(self) -> SeenScene:
        return seen_scene(self.image, self.queries, self.sensor != "ideal")

    def knowing(self, shapes: FoundShapes) -> EditedScene:
        """The scene with known shapes where they were found; those that no mask shows are further parts of it."""
        further = {part: shape.mesh for part, shape in shapes.parts.items() if part not in self.queries}
        if not further:
            return replace(self, known=shapes)
        bodies = [(shape.mesh, Pose.identity()) for shape in (shapes.kits, *shapes.parts.values())]
        view, labels = self.view, self.image.labels.copy()
        shown = render(view.camera, view.world_from_camera, bodies).body_ids
        for number, part in enumerate(shapes.parts, start=2):
            if part in further:
                labels[shown == number] = FIRST_PART_LABEL + part
        drawn, track = LabelledDepth(view, labels), _track("snap", self.sensor)
        queries = {
            part: Query(
                id=f"{self.recorded.id}-p{part}-{track}",
                scene_id=self.recorded.id,
                track=track,
                sensor=self.sensor,
                part=part,
                drawn=False,
                pivot=mesh.bounds.mean(0),
                guess=None,
                read_image=lambda: drawn,
            )
            for part, mesh in further.items()
        }
        return replace(self, known=shapes, drawn=drawn, queries={**self.queries, **queries})


def editable_queries(scene: RecordedScene, sensor: str) -> dict[int, Query]:
    """A query for each part that can be edited, by index, without the recorded guess: the hand replaces it.

    Raises InputError if there is none.
    """
    track = _track("snap", sensor)
    found = {query.part: replace(query, guess=None) for query in scene.queries if query.track == track}
    if not found:
        raise InputError(f"{scene.id}: no part of it can be edited from the {sensor} depth image")
    return dict(sorted(found.items()))


def answered_queries(queries: Iterable[Query], sensor: str) -> dict[str, Query]:
    """Queries that an edit answers, by id: of `snap`, with the hand in place of the recorded guess, and of `place`."""
    tracks = _track("snap", sensor), _track("place", sensor)
    return {query.id: query for query in queries if query.track in tracks}


def _track(kind: str, sensor: str) -> str:
    return kind if sensor == "ideal" else f"{kind}-{sensor}"


def _stated_base(dataset: Dataset) -> Pose | None:
    """base_from_camera of dataset.json; None if it states none."""
    value = dataset.summary.get("config", {}).get("base_from_camera")
    place = f"{dataset.root / 'dataset.json'}: config: base_from_camera"
    return None if value is None else stated_pose(value, place)


def _placed(mesh: Mesh, world_from_body: Pose) -> Mesh:
    return Mesh(world_from_body.apply(mesh.vertices), mesh.faces)
