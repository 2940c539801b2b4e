"""Registration of a scene: kits and parts are found in a depth image, and all are refined together.

The kits are one rigid body that stands as designed; a part may stand on any of its stable faces. Masks tell where parts
may be, and never where they end: each shape is searched for over each mask, and a shape that no mask shows is searched
for in all that is left. Every fit is judged by what it leaves unexplained of the disparity image.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.optimize import linear_sum_assignment

from kit1000.errors import InputError
from kit1000.known_shapes.disparity import DisparityImage, Window
from kit1000.known_shapes.fit import COARSE, FINE, fit
from kit1000.known_shapes.height_search import HeightGrid, Place, Views, distinct, views_from_above
from kit1000.known_shapes.shapes import KnownShape, ShapeDistance, StandingShape, apart, neighbours
from kit1000.known_shapes.support import Support, seen_support
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth

KIT_YAWS, FEWEST_YAWS, YAW_STEP = 72, 16, 6e-3  # of kits; of parts, and [m] between two yaws at the rim of a part


class Screened(NamedTuple):
    """The most places that are compared as they are: in all, at one spot, and of one view."""

    places: int
    a_spot: int
    a_view: int


KIT_SCREENED, KIT_REFINED = Screened(24, 24, 24), 6  # for the kits, and how many of these are refined
MASK_SCREENED, MASK_REFINED = Screened(40, 40, 1), 3  # for a part over a mask
SPOT_SCREENED, SPOT_REFINED = Screened(160, 160, 1), 6  # at a spot beside all other bodies
GRID_SCREENED = Screened(300, 30, 24)  # on the whole table
RIVALS, SPOT = 3, 25e-3  # of these, that are refined in the whole image, and [m] within which they contradict a pose
EXCHANGE = 0.9  # of what two parts explain, that they must explain over each other's masks to be exchanged
ROOM = 8  # [px] in the small image, of windows that places share
ROUNDS, STAYED = 2, 1e-3  # of searches beside all other bodies, if these move by more [m]
OTHERS_REACH = 2  # [px] about another mask, whose pixels tell nothing about a part
GAP = 0.05  # [m] up to which shapes are rendered together
BADLY = 0.045  # of the pixels about a shape: it is searched everywhere
LEAST_GAIN = 12.0  # pixels of the small image that a shape must explain
SCALE_SPREAD = 1.7e-3  # of the depth scale of a stereo camera: uniform within 0.3 %
EDGE_CORRELATION = 25.0  # by which edges that vary slowly make the scale less certain than independent pixels would
SCALE_SPREAD_A_PX = 0.4e-3  # of the scale by one shape, for each pixel by which edges extend: 2.3e-3 for a D415 (val)
LEAST_SCALE_SPREAD = 1e-4
GOOD, CLEAR_LEAD = 0.03, 50.0  # unexplained share and lead of a certain pose: of 100 such poses of val 94 are right
MOST_SCALE = 3 * SCALE_SPREAD  # beyond, no camera is believed
MOST_SPREAD = 1.25e-3  # [m] of a body along the line of sight
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

    @property
    def faults(self) -> tuple[str, ...]:
        """Why the pose may be wrong; none if the image alone tells that it is right."""
        found = []
        if self.unexplained > GOOD:
            found.append(f"{self.unexplained:.0%} of what is seen about it is not explained")
        if self.lead is not None and self.lead < CLEAR_LEAD:
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
        self.rivals: defaultdict[str, list[StandingShape]] = defaultdict(list)
        """For each shape the other poses that were refined beside it."""
        self.exchanges: dict[tuple[int, int], tuple[StandingShape, StandingShape]] = {}
        """For two parts that may be over each other's masks, their places there."""

    def scene(self, kits: KnownShape, parts: Sequence[KnownShape], scale_spread: float) -> RegisteredScene:
        """All steps."""
        standing = self._kits(kits)
        bodies: list[StandingShape | None] = [standing, *self._over_masks(parts, standing)]
        self._refine(bodies, FINE[:2])
        self._place_missing(parts, bodies)
        self._settle(bodies, range(1, len(bodies)))
        bodies = self._exchanged(bodies)
        again = [bodies[0], *(self._well_placed(body, bodies) for body in bodies[1:])]
        if None in again:
            self._place_missing(parts, again)
            bodies = self._better(bodies, again, range(1, len(bodies)))
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
        found = self._candidates(self.grid, views_from_above(kits, KIT_YAWS), kits, KIT_SCREENED, KIT_REFINED)
        if not found:
            raise InputError("the image shows no kits of this shape")
        self.rivals[kits.name] = [shape for _, shape in found]
        return fit(self.image, found[0].shape, reaches=FINE[:2]).shape

    def _candidates(
        self,
        grid: HeightGrid | None,
        views: Sequence[Views],
        shape: KnownShape,
        screened: Screened,
        most: int,
        others: Sequence[StandingShape] = (),
        used: np.ndarray | None = None,
    ) -> list[Place]:
        """Places of a shape refined in the small image, with the pixels that they explain there, the most first.

        Args:
            grid: the heights, in which the shape is searched for; None: there are none.
            views: of the shape.
            shape: to find.
            screened: the numbers of places that are compared as they are: all faces and yaws have similar heights.
            most: the number of places that are refined.
            others: shapes beside it.
            used: (H / 2, W / 2) bool, the pixels that are compared; all if None.
        """

        windows: list[Window] = []  # places at one spot share what is behind them

        def gain(standing: StandingShape) -> Place:
            box = self.small.box(standing)
            window = next((each for each in windows if each.box.contains(box)), None)
            if window is None:
                window = self.small.window(standing, neighbours(standing, others, GAP), room=ROOM)
                windows.append(window)
            return Place(window.gain(standing, used), standing)

        def refined(standing: StandingShape) -> StandingShape:
            return fit(self.small, standing, neighbours(standing, others, GAP), reaches=COARSE, used=used).shape

        places = [] if grid is None else [gain(place.shape) for place in grid.places(shape, views, *screened)]
        places = distinct(sorted(places, key=_by_score), most)
        return sorted((gain(refined(place.shape)) for place in places), key=_by_score)

    def _over_masks(self, parts: Sequence[KnownShape], kits: StandingShape) -> list[StandingShape | None]:
        """Each part over a mask, so that all together explain the most pixels; None for a part that no mask fits."""
        masks = [int(label) for label in np.unique(self.labels) if label >= FIRST_PART_LABEL]
        grids, used = [self.grid.of_mask(label) for label in masks], [self._used(label) for label in masks]
        gains = np.zeros((len(parts), len(masks) + len(parts)))  # a part may be over no mask
        best: dict[tuple[int, int], StandingShape] = {}
        for i, part in enumerate(parts):
            views = _part_views(part)
            for j in range(len(masks)):
                found = self._candidates(grids[j], views, part, MASK_SCREENED, MASK_REFINED, [kits], used[j])
                if found and found[0].score > 0:
                    gains[i, j], best[i, j] = found[0]
        chosen = linear_sum_assignment(gains, maximize=True)[1]
        for i, j in combinations(range(len(parts)), 2):
            now, other = gains[i, chosen[i]] + gains[j, chosen[j]], gains[i, chosen[j]] + gains[j, chosen[i]]
            first, second = best.get((i, chosen[j])), best.get((j, chosen[i]))
            if other > EXCHANGE * now and first is not None and second is not None:
                self.exchanges[i + 1, j + 1] = first, second
        return [best.get((i, j)) for i, j in enumerate(chosen)]

    def _used(self, label: int) -> np.ndarray:
        """Pixels of the small image that no other part's mask has."""
        others = (self.labels >= FIRST_PART_LABEL) & (self.labels != label)
        return np.logical_not(binary_dilation(others, iterations=OTHERS_REACH))[::2, ::2]

    def _settle(self, bodies: list[StandingShape | None], which: Sequence[int]) -> None:
        """Search some parts again at their spots, beside all others, while these move."""
        before: dict[int, list[StandingShape]] = {}
        for i in [*which] * ROUNDS:
            body, others = bodies[i], [other for k, other in enumerate(bodies) if k != i and other is not None]
            if body is not None and not _stayed(before.get(i, []), beside := neighbours(body, others, GAP)):
                before[i], bodies[i] = beside, self._settled(body, others)

    def _settled(self, body: StandingShape, others: Sequence[StandingShape]) -> StandingShape:
        """A part, or the rival at its spot that explains more beside the others."""
        grid, shape = self.grid.without(others), body.shape
        near = grid.about(grid.footprint(body))
        found = self._candidates(near, _part_views(shape), shape, SPOT_SCREENED, SPOT_REFINED, others)
        most = self._window(body, others).gain(body)
        for _, rival in found[:RIVALS]:
            moved = fit(self.image, rival, neighbours(rival, others, GAP), reaches=FINE[:2]).shape
            self.rivals[shape.name].append(moved)
            gain = self._window(moved, others).gain(moved)
            if gain > most:
                most, body = gain, moved
        return body

    def _well_placed(self, body: StandingShape | None, bodies: Sequence[StandingShape | None]) -> StandingShape | None:
        """A body, but None if it is explained badly."""
        return body if body is not None and self._window(body, bodies).misfit(body) < BADLY else None

    def _exchanged(self, bodies: list[StandingShape | None]) -> list[StandingShape | None]:
        """Bodies of which two have changed their places, if they explain more so."""
        for (i, j), (first, second) in self.exchanges.items():
            other = [*bodies]
            other[i], other[j] = first, second
            bodies = self._better(bodies, other, (i, j))
        return bodies

    def _better(
        self, bodies: list[StandingShape | None], other: list[StandingShape | None], moved: Sequence[int]
    ) -> list[StandingShape | None]:
        """Bodies, or others that explain more once those that are moved are settled."""
        self._settle(other, moved)
        return other if self._explained(other) > self._explained(bodies) else bodies

    def _place_missing(self, parts: Sequence[KnownShape], bodies: list[StandingShape | None]) -> None:
        """Search the parts without a place in what all others leave, the one that explains the most first."""
        missing = {i for i, body in enumerate(bodies) if body is None}
        for _ in sorted(missing):
            others = [body for body in bodies if body is not None]
            grid, found = self.grid.without(others), {}
            for i in missing:
                part = parts[i - 1]
                candidates = self._candidates(grid, _part_views(part), part, GRID_SCREENED, SPOT_REFINED, others)
                if candidates and candidates[0].score > LEAST_GAIN:
                    found[i] = candidates[0]
            if not found:
                return
            i = max(found, key=lambda each: found[each].score)
            bodies[i] = found[i].shape
            missing.remove(i)

    def _explained(self, bodies: Sequence[StandingShape | None]) -> float:
        """The number of pixels that all parts explain, one after the other."""
        first, *rest = [body for body in bodies if body is not None]
        before = [[first, *rest[:k]] for k in range(len(rest))]
        return sum(self._window(body, others).gain(body) for body, others in zip(rest, before, strict=True))

    def _window(self, body: StandingShape, others: Sequence[StandingShape | None]) -> Window:
        return self.image.window(body, neighbours(body, others, GAP))

    def _refine(self, bodies: list[StandingShape | None], reaches: Sequence[float], scale: float = 1.0) -> None:
        """Move each body to where it and those beside it explain the image best."""
        for i, body in enumerate(bodies):
            if body is not None:
                bodies[i] = fit(self.image, body, neighbours(body, bodies, GAP), scale, reaches).shape

    def _scale(self, bodies: Sequence[StandingShape | None], before: float) -> tuple[float, float]:
        """The depth scale by the sizes of all bodies, and its standard deviation. before: the same without them."""
        certainty, total = before**-2, 0.0
        least = max(SCALE_SPREAD_A_PX * self.image.extension, LEAST_SCALE_SPREAD)
        for body in bodies:
            if body is None:
                continue
            found = fit(self.image, body, neighbours(body, bodies, GAP), reaches=FINE[1:], free_scale=True)
            own = 1 / (EDGE_CORRELATION * found.covariance[3, 3] + least**2)
            certainty, total = certainty + own, total + own * found.log_scale
        return float(np.exp(total / certainty)), float(certainty**-0.5)

    def _agreement(self, body: StandingShape, bodies: Sequence[StandingShape], scale: float) -> Agreement:
        """The agreement of a body, with its lead over rivals at its spot."""
        distance, pose = ShapeDistance(body.shape.mesh), body.camera_from_body()
        near = (other for other in self.rivals[body.shape.name] if apart(body, other) < SPOT)
        others = [each for each in near if distance.between(pose, each.camera_from_body()) > SAME_POSE]
        rest = [each for each in bodies if each is not body]
        gains = [self._window(each, rest).gain(each) for each in (body, *others)]
        lead = gains[0] - max(gains[1:]) if others else None
        return replace(agreement(self.image, body, neighbours(body, rest, GAP), scale), lead=lead)

    def _mask_of(self, body: StandingShape, scale: float) -> int:
        """The mask of a part with most of the body's pixels; 0 if there is none."""
        window = self.image.window(body, scale=scale)
        labels = self.labels[window.box.window][window.exact(body)[1]]
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
    return Agreement(window.misfit(body), None, float(np.median(off)))


def _stayed(before: Sequence[StandingShape], now: Sequence[StandingShape]) -> bool:
    """Whether shapes are where they were."""
    pairs = zip(before, now, strict=False)
    return len(before) == len(now) and all(a.level is b.level and apart(a, b) < STAYED for a, b in pairs)


def _part_views(part: KnownShape) -> list[Views]:
    radius = float(np.linalg.norm(part.mesh.extents)) / 2
    return views_from_above(part, max(FEWEST_YAWS, round(2 * np.pi * radius / YAW_STEP)))


def _by_score(place: Place) -> float:
    return -place.score
