"""The method registration-known: known shapes are registered to the image; the insertion follows from the shapes."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.known_shapes.registration import CONFIDENCE_DECIMALS, RegisteredBody, register_scene
from kit1000.known_shapes.several_images import PlacedScene, SeenPart, agreed_motions, one_part
from kit1000.known_shapes.shapes import KITS, KnownShape
from kit1000.known_shapes.support import Support, recorded_support
from kit1000.mesh import Mesh
from kit1000.perception.calibration import camera_estimate_by
from kit1000.perception.calibration.depth_scale import SCALE_SPREAD, DepthScale, in_true_lengths
from kit1000.perception.sensor_facts import SensorFacts, sensor_of
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.registration.method import TrueScene, fits_in
from kit1000.registration.predictor import stated_clearances
from kit1000.registration.rank import confidence, from_elsewhere
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, Query, SceneShapes, TrueGeometry, View

KEPT = 8  # scenes of images


@dataclass(frozen=True, eq=False)
class FoundShape:
    """A known shape where it was found."""

    name: str
    mesh: Mesh
    """[m] world."""
    doubts: tuple[str, ...]
    """Why its pose may be wrong; none if the image alone settles it."""


@dataclass(frozen=True, eq=False)
class FoundShapes:
    """The known shapes of an image where they were found."""

    kits: FoundShape
    parts: Mapping[int, FoundShape]
    """By index of the part; those that no mask shows have indices above all masks. A part of another shape is left
    out."""
    missing: tuple[str, ...] = ()
    """Names of the shapes that were not found."""


@dataclass(frozen=True, eq=False)
class KnownShapeRegistration:
    """Predicts by the poses of known shapes."""

    dataset: Dataset
    _last: dict[View, PlacedScene | InputError] = field(default_factory=dict)

    reads = "shapes"

    def __call__(self, query: Query, shapes: SceneShapes | None, /) -> PredictedMotion:
        """The best of `propose`; without any the guess or no motion, with confidence 0.

        So is an image that cannot be read, such as one without a table; stderr says once why.
        """
        given = _given(query, shapes)
        nothing = PredictedMotion(Pose.identity() if query.guess is None else query.guess, 0.0)
        known = query.view in self._last
        try:
            return next(iter(self.propose(query, given)), nothing)
        except InputError as fault:
            if not known:
                print(f"{query.scene_id}: {fault}; its queries get confidence 0", file=sys.stderr)
            return nothing

    def propose(self, query: Query, shapes: SceneShapes | None, /) -> list[PredictedMotion]:
        """All insertions of the part whose registered pose is nearest to the query's pivot, the best first.

        If dataset.json states several images of the scene, each is registered, and what they agree on comes first.
        Raises InputError for an image that shows no table, or no kits.
        """
        return self.together([query, *from_elsewhere(self.dataset, query)], _given(query, shapes))

    def together(self, queries: Sequence[Query], shapes: SceneShapes) -> list[PredictedMotion]:
        """The same by several images of one part, which cameras took in one world.

        Raises InputError if the first image shows no table, or no kits; others may.
        """
        first, *others = queries
        seen = [self._registered(first, shapes).seen(first.pivot)]
        for other in others:
            with suppress(InputError):
                seen.append(self._registered(other, shapes).seen(other.pivot))
        parts = one_part([part for part in seen if part is not None])
        return agreed_motions([self._insertions(first, part, shapes) for part in parts], first.pivot)

    def find(self, queries: Sequence[Query], shapes: SceneShapes) -> FoundShapes:
        """Where the shapes are, for a person to look at. queries: about parts of one image.

        Raises InputError for an image that shows no table, or no kits.
        """
        found = self._registered(queries[0], shapes)
        nearest = {query.part: entry for query in queries if (entry := found.nearest(query.pivot)) is not None}
        parts: dict[int, RegisteredBody] = {}
        for part in sorted(nearest, key=lambda part: nearest[part][1]):  # masks may cut a part into several
            body, far = nearest[part]
            if far <= body.standing.radius and body not in parts.values():
                parts[part] = body
        unmasked = [body for body in found.parts if body not in parts.values()]
        parts |= dict(enumerate(unmasked, int(queries[0].image.labels.max()) - FIRST_PART_LABEL + 1))
        shown = {part: _shown(found, body, shapes.goals.get(body.name)) for part, body in parts.items()}
        missing = shapes.parts.keys() - {body.name for body in found.parts}
        return FoundShapes(_shown(found, found.scene.bodies[0]), shown, tuple(sorted(missing)))

    def _insertions(self, query: Query, part: SeenPart, shapes: SceneShapes) -> list[PredictedMotion]:
        """All insertions of a part: its goals, the nearest to a guess first; or those that registration finds.

        Goals of a symmetric part are equally right: without a guess, the one that the depth scale leaves least open is
        first. The first that registration finds is as sure as the poses, others less by what tells them apart.
        """
        name, scene, camera = part.body.name, part.placed.scene, part.placed.world_from_camera
        world_from_kits = part.placed.world_from(scene.bodies[0])

        def in_camera(goal_from_now: Pose) -> Pose:
            return camera.inverse() @ goal_from_now @ camera

        def sure(goal_from_now: Pose) -> float:
            return scene.confidence(part.body, in_camera(goal_from_now))

        if name in shapes.goals:
            motions, guess = list(world_from_kits @ shapes.goals[name] @ part.world_from_part.inverse()), query.guess
            if guess is None:
                motions.sort(key=lambda motion: scene.left_open(in_camera(motion)))
            else:
                motions.sort(key=lambda motion: float((motion @ guess.inverse()).angle()))
            return [PredictedMotion(motion, sure(motion)) for motion in motions]
        geometry = TrueGeometry(shapes.parts[name], part.world_from_part, shapes.assembly, world_from_kits)
        stated = shapes.clearances.get(name)
        fits = fits_in(TrueScene(query, geometry), (stated,) if stated else stated_clearances(self.dataset))
        odds = [confidence(fit, fits) for fit in fits]
        shares = [1.0, *(min(each / max(odds[0], 1e-6), 1.0) for each in odds[1:])]
        return [
            PredictedMotion(fit.goal_from_now, round(sure(fit.goal_from_now) * share, CONFIDENCE_DECIMALS))
            for fit, share in zip(fits, shares, strict=False)
        ]

    def _registered(self, query: Query, shapes: SceneShapes) -> PlacedScene:
        """The scene of a query's image; those of the last images are kept, for queries come scene by scene."""
        if query.view not in self._last:
            if len(self._last) == KEPT:
                del self._last[next(iter(self._last))]
            try:
                self._last[query.view] = self._register(query, shapes)
            except InputError as fault:
                self._last[query.view] = fault
        found = self._last[query.view]
        if isinstance(found, InputError):
            raise found
        return found

    def _register(self, query: Query, shapes: SceneShapes) -> PlacedScene:
        sensor = sensor_of(self.dataset.summary, query.sensor, query.scene_id)
        image, support, scale = _calibrated(query.image, sensor)
        parts = [KnownShape.of(name, mesh) for name, mesh in shapes.parts.items()]
        scene = register_scene(image, sensor, KnownShape.upright(KITS, shapes.assembly), parts, scale, support)
        world_from_camera = image.view.world_from_camera
        if not sensor.simulated_table:  # its height over the table was measured
            world_from_camera = in_true_lengths(world_from_camera, scene.scale)
        return PlacedScene(scene, world_from_camera)


def _shown(placed: PlacedScene, body: RegisteredBody, goals: Pose | None = None) -> FoundShape:
    """A body for a person to look at. goals: of a part in the kits; what is in doubt is then the motion."""
    scene, mesh = placed.scene, body.standing.shape.mesh.moved(placed.world_from(body))
    if goals is None:
        return FoundShape(body.name, mesh, scene.doubts(body))
    return FoundShape(body.name, mesh, scene.motion_doubts(body, scene.surest_motion(body, goals)))


def _given(query: Query, shapes: SceneShapes | None) -> SceneShapes:
    """The shapes, or an error that says how to give them."""
    if shapes is None:
        raise InputError(f"{query.id}: registration of known shapes needs the shapes of the scene: give --shapes")
    return shapes


def _calibrated(image: LabelledDepth, sensor: SensorFacts) -> tuple[LabelledDepth, Support | None, DepthScale | None]:
    """An image with the camera and the depths that its table shows, the table, and what is known of the depth scale.

    None for a table or a scale that only the image itself and its sensor tell.
    """
    if sensor.kind.exact:
        return image, recorded_support(image), DepthScale(spread=1e-5)
    if not sensor.simulated_table:  # its world was made of the image, so its table tells nothing about the scale
        return image, None, None
    estimate = camera_estimate_by(image.view, image.labels, sensor)
    calibrated = LabelledDepth(estimate.view, image.labels)
    spread = float(np.sqrt(np.linalg.inv(estimate.information)[6, 6])) * SCALE_SPREAD
    return calibrated, recorded_support(calibrated), DepthScale(spread=spread)
