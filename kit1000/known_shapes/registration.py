"""Registration of a scene: kits and parts are found in a depth image, and all are refined together.

The kits are one rigid body that stands as designed; a part may stand on any of its stable faces. Masks tell where parts
may be, and never where they end: each shape is searched for over each mask, and a shape that no mask shows is searched
for in all that is left. Every fit is judged by what it leaves unexplained of the disparity image.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.optimize import linear_sum_assignment

from kit1000.errors import InputError
from kit1000.known_shapes.disparity import DisparityImage
from kit1000.known_shapes.fit import COARSE, FINE, fit
from kit1000.known_shapes.height_search import HeightGrid, Place, templates
from kit1000.known_shapes.shapes import KnownShape, ShapeDistance, StandingShape, apart, neighbours
from kit1000.known_shapes.support import Support, seen_support
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth

KIT_YAWS, PART_YAWS = 72, 24
KIT_PLACES, PART_PLACES = 6, 6  # that are refined, of the kits, and of a part over a mask
SCREENED = 24  # places of a part over a mask that are compared as they are
MASK_CELLS = 8  # about a mask, in which a part is searched
WORSE_SCORE = 0.25  # below its best score elsewhere a part is not refined over a mask
RIVALS, SPOT = 6, 25e-3  # of a part that are compared beside all other bodies, and [m] from it
OTHERS_REACH = 2  # [px] about another mask, whose pixels tell nothing about a part
GAP = 0.05  # [m] up to which shapes are rendered together
BADLY_EXPLAINED = 0.045  # of the pixels about a shape: it is searched again
LEAST_GAIN = 50.0  # pixels that a shape must explain
AGAIN = 2  # searches of shapes that are explained badly
SCALE_SPREAD = 1.7e-3  # of the depth scale of a stereo camera: uniform within 0.3 %
EDGE_CORRELATION = 25.0  # by which edges that vary slowly make the scale less certain than independent pixels would
LEAST_SCALE_SPREAD = 1.5e-3  # of the scale by one shape: the amounts by which edges extend are those of the model
GOOD, LEAST_UNEXPLAINED, MARGIN = 0.035, 0.01, 2.0  # of what a certain pose and its rival leave unexplained
MOST_SCALE = 3 * SCALE_SPREAD  # beyond, no camera is believed
MOST_SPREAD = 1e-3  # [m] of a body along the line of sight
SAME_POSE = 3e-3  # [m] by which the surfaces of two poses differ that count as one


@dataclass(frozen=True)
class Agreement:
    """How well a pose explains the image."""

    unexplained: float
    """Share of the pixels in and about the shape."""
    rival: float | None
    """The same of the best other pose; None without one."""
    depth: float
    """[m] median absolute difference of measured and rendered depth."""

    @property
    def faults(self) -> tuple[str, ...]:
        """Why the pose may be wrong; none if the image alone tells that it is right."""
        found = []
        if self.unexplained > GOOD:
            found.append(f"{self.unexplained:.0%} of what is seen about it is not explained")
        if self.rival is not None and self.rival < MARGIN * max(self.unexplained, LEAST_UNEXPLAINED):
            found.append("another pose explains the image nearly as well")
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
    support: Support
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
        spread = self.scale_spread * float(np.linalg.norm(body.standing.camera_from_body().xyz))
        if spread > MOST_SPREAD:
            found.append(f"its distance is open: ± {spread * 1e3:.1f} mm along the line of sight")
        return tuple(found)


def register_scene(
    image: LabelledDepth,
    sensor: SensorFacts,
    kits: KnownShape,
    parts: Sequence[KnownShape],
    scale_spread: float = SCALE_SPREAD,
) -> RegisteredScene:
    """Find known shapes in a depth image.

    Args:
        image: the depth image with masks, which may be wrong at their borders.
        sensor: that took it.
        kits: all kits as one shape.
        parts: those of the scene, in any order; fewer than it shows parts is allowed.
        scale_spread: standard deviation of the depth scale about 1, before the sizes of the shapes tell it.

    Raises:
        InputError: the image shows no kits, or too little of the table.
    """
    return _Registration(image, sensor, seen_support(image)).scene(kits, parts, scale_spread)


class _Registration:
    """What all steps share: the image in two sizes, and the heights over its table."""

    def __init__(self, image: LabelledDepth, sensor: SensorFacts, support: Support) -> None:
        self.labels = image.labels
        self.image = DisparityImage.of(image, sensor, support)
        self.small = self.image.halved
        grid = HeightGrid.of(self.image, image.labels)
        if grid is None:
            raise InputError("nothing stands on the table: expected kits and parts in view")
        self.grid = grid
        self.rivals: defaultdict[str, list[tuple[float, StandingShape]]] = defaultdict(list)
        """For each shape all its refined places, with what they leave unexplained."""

    def scene(self, kits: KnownShape, parts: Sequence[KnownShape], scale_spread: float) -> RegisteredScene:
        """All steps."""
        standing = self._kits(kits)
        bodies: list[StandingShape | None] = [standing, *self._over_masks(parts, standing)]
        self._refine(bodies, FINE[:2])
        self._choose(bodies)
        for _ in range(AGAIN):
            if not self._search_again(parts, bodies):
                break
        self._choose(bodies)
        scale, spread = self._scale(bodies, scale_spread)
        self._refine(bodies, FINE, scale)
        found = [body for body in bodies if body is not None]
        labels = [ASSEMBLY_LABEL, *(self._mask_of(body, scale) for body in found[1:])]
        registered = (
            RegisteredBody(body, label if labels.count(label) == 1 else 0, self._agreement(body, found, scale))
            for body, label in zip(found, labels, strict=True)
        )
        return RegisteredScene(tuple(registered), self.image.support, scale, spread)

    def _kits(self, kits: KnownShape) -> StandingShape:
        """The kits, found in the whole image."""
        places = self.grid.places(kits, templates(kits, KIT_YAWS), KIT_PLACES, KIT_PLACES)
        if not places:
            raise InputError("the image shows no kits of this shape")
        scored = [self._coarse(place, ()) for place in places]
        scored.sort(key=lambda each: each[0])
        self.rivals[kits.name] = scored
        return fit(self.image, scored[0][1], reaches=FINE[:2]).shape

    def _coarse(
        self, place: Place, others: Sequence[StandingShape], used: np.ndarray | None = None
    ) -> tuple[float, StandingShape]:
        """A place refined in the small image, with what it leaves unexplained there."""
        shape = place.shape
        beside = [other for other in others if shape.near(other, GAP)]
        shape = fit(self.small, shape, beside, reaches=COARSE, used=used).shape
        return self.small.misfit(shape, beside, used=used), shape

    def _over_masks(self, parts: Sequence[KnownShape], kits: StandingShape) -> list[StandingShape | None]:
        """Each part over a mask, so that all together explain the most pixels; None for a part that no mask fits."""
        masks = [int(label) for label in np.unique(self.labels) if label >= FIRST_PART_LABEL]
        grids = {label: self.grid.of_mask(label, MASK_CELLS) for label in masks}
        used = {label: self._used(label) for label in masks}
        gains = np.zeros((len(parts), len(masks) + len(parts)))  # a part may be over no mask
        best: dict[tuple[int, int], StandingShape] = {}
        for i, part in enumerate(parts):
            views = templates(part, PART_YAWS)
            places = [grid.places(part, views, SCREENED, SCREENED) if grid else [] for grid in grids.values()]
            least = max((found[0].score for found in places if found), default=0.0) - WORSE_SCORE
            for j, label in enumerate(masks):
                for place in self._screened([each for each in places[j] if each.score > least], [kits], used[label]):
                    unexplained, shape = self._coarse(place, [kits], used[label])
                    self.rivals[part.name].append((unexplained, shape))
                    gain = self.small.gain_of(shape, neighbours(shape, [kits], GAP), used[label])
                    if gain > gains[i, j]:
                        gains[i, j], best[i, j] = gain, shape
        return [best.get(pair) for pair in zip(*linear_sum_assignment(gains, maximize=True), strict=True)]

    def _screened(
        self, places: Sequence[Place], others: Sequence[StandingShape], used: np.ndarray | None = None
    ) -> list[Place]:
        """The places that explain the most as they are: all faces and yaws of one spot have similar heights."""

        def gain(place: Place) -> float:
            return self.small.gain_of(place.shape, neighbours(place.shape, others, GAP), used)

        return sorted(places, key=gain, reverse=True)[:PART_PLACES]

    def _used(self, label: int) -> np.ndarray:
        """Pixels of the small image that no other part's mask has."""
        others = (self.labels >= FIRST_PART_LABEL) & (self.labels != label)
        return np.logical_not(binary_dilation(others, iterations=OTHERS_REACH))[::2, ::2]

    def _choose(self, bodies: list[StandingShape | None]) -> None:
        """Exchange each part for a rival at its spot that explains more beside the other bodies."""
        for i, body in enumerate(bodies):
            if body is None or i == 0:
                continue
            at_spot = [entry for entry in self.rivals[body.shape.name] if apart(entry[1], body) < SPOT]
            most = self.small.gain_of(body, neighbours(body, bodies, GAP))
            for _, rival in sorted(at_spot, key=lambda entry: entry[0])[:RIVALS]:
                others = [other for k, other in enumerate(bodies) if k != i]
                moved = fit(self.small, rival, neighbours(rival, others, GAP), reaches=(COARSE[-1], *FINE[:2])).shape
                gain = self.small.gain_of(moved, neighbours(moved, others, GAP))
                if gain > most:
                    most, bodies[i] = gain, moved
        self._refine(bodies, FINE[:2])

    def _search_again(self, parts: Sequence[KnownShape], bodies: list[StandingShape | None]) -> bool:
        """Search parts that are explained badly in what the others leave; returns whether there were any."""
        cost = [1.0 if body is None else self.image.misfit(body, neighbours(body, bodies, GAP)) for body in bodies]
        bad = [i for i in np.argsort(cost)[::-1].tolist() if i > 0 and cost[i] > BADLY_EXPLAINED]
        good = [body for i, body in enumerate(bodies) if body is not None and i not in bad]
        grid = self.grid.without(good)
        for i in bad:
            part, rest = parts[i - 1], [other for k, other in enumerate(bodies) if k != i]
            now = bodies[i]
            most = LEAST_GAIN if now is None else self.image.gain_of(now, neighbours(now, rest, GAP))
            places = grid.places(part, templates(part, PART_YAWS), 2 * SCREENED, SCREENED)
            for place in self._screened(places, good):
                unexplained, shape = self._coarse(place, good)
                gain = self.image.gain_of(shape, neighbours(shape, rest, GAP))
                if gain > most:
                    most, bodies[i] = gain, shape
                    self.rivals[part.name].append((unexplained, shape))
        if bad:
            self._refine(bodies, FINE[:2])
        return bool(bad)

    def _refine(self, bodies: list[StandingShape | None], reaches: Sequence[float], scale: float = 1.0) -> None:
        """Move each body to where it and those beside it explain the image best."""
        for i, body in enumerate(bodies):
            if body is not None:
                bodies[i] = fit(self.image, body, neighbours(body, bodies, GAP), scale, reaches).shape

    def _scale(self, bodies: Sequence[StandingShape | None], before: float) -> tuple[float, float]:
        """The depth scale by the sizes of all bodies, and its standard deviation. before: the same without them."""
        certainty, total = before**-2, 0.0
        for body in bodies:
            if body is None:
                continue
            found = fit(self.image, body, neighbours(body, bodies, GAP), reaches=FINE[1:], free_scale=True)
            own = 1 / (EDGE_CORRELATION * found.covariance[3, 3] + LEAST_SCALE_SPREAD**2)
            certainty, total = certainty + own, total + own * found.log_scale
        return float(np.exp(total / certainty)), float(certainty**-0.5)

    def _agreement(self, body: StandingShape, bodies: Sequence[StandingShape], scale: float) -> Agreement:
        """The agreement of a body, with its best rival."""
        beside, distance = neighbours(body, bodies, GAP), ShapeDistance(body.shape.mesh)
        others = sorted(self.rivals[body.shape.name], key=lambda each: each[0])
        rival = next((cost for cost, other in others if self._differs(body, other, distance)), None)
        return replace(agreement(self.image, body, beside, scale), rival=rival)

    @staticmethod
    def _differs(body: StandingShape, other: StandingShape, distance: ShapeDistance) -> bool:
        return distance.between(body.camera_from_body(), other.camera_from_body()) > SAME_POSE

    def _mask_of(self, body: StandingShape, scale: float) -> int:
        """The mask of a part with most of the body's pixels; 0 if there is none."""
        box = self.image.box(body)
        labels = self.labels[box.window][self.image.rendered([body], box, scale)[1]]
        counts = np.bincount(labels[labels >= FIRST_PART_LABEL], minlength=1)
        return int(counts.argmax()) if counts.any() else 0


def agreement(
    image: DisparityImage, body: StandingShape, beside: Sequence[StandingShape], scale: float = 1.0
) -> Agreement:
    """How well a shape at its place explains an image, with the shapes beside it."""
    box = image.box(body)
    exact, inside = image.rendered([body, *beside], box, scale)
    measured = image.measured[box.window]
    both = inside & (measured > 0)
    off = np.abs(image.gain / measured[both] - image.gain / exact[both]) if both.any() else np.array([np.inf])
    return Agreement(image.misfit(body, beside, scale), None, float(np.median(off)))
