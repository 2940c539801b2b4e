"""Search of known shapes in a scene: where kits and parts stand, so that all together explain the most pixels.

Masks tell where parts may be, and never where they end: each part is searched for over each mask, and a part that no
mask shows in what all others leave. The height map proposes places, the disparity image ranks them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.optimize import linear_sum_assignment

from kit1000.errors import InputError
from kit1000.known_shapes.disparity import DisparityImage, Window
from kit1000.known_shapes.fit import COARSE, FINE, fit
from kit1000.known_shapes.height_search import HeightGrid, Place, Views, distinct, views_from_above
from kit1000.known_shapes.shapes import KnownShape, StandingShape, apart, neighbours
from kit1000.values import FIRST_PART_LABEL

KIT_YAWS, FEWEST_YAWS, YAW_STEP = 72, 16, 6e-3  # of kits; of parts, and [m] between two yaws at the rim of a part


class Screened(NamedTuple):
    """The most places that are compared as they are: in all, at one spot, and of one view."""

    places: int
    a_spot: int
    a_view: int


KIT_SCREENED, KIT_REFINED = Screened(24, 24, 24), 6  # for the kits, and how many of these are refined
NEARBY = np.array([(x, y, 0.0) for x, y in product(np.linspace(-16e-3, 16e-3, 5), repeat=2)])
"""[m] moves of kits that explain the image badly: a cavity that is seen obliquely misleads the heights."""
MASK_SCREENED, MASK_REFINED = Screened(20, 20, 1), 2  # for a part over a mask
SPOT_SCREENED, SPOT_REFINED = Screened(100, 100, 1), 5  # at a spot beside all other bodies
DOUBTFUL, DOUBTFUL_SCREENED = 0.018, Screened(450, 450, 2)  # the same for a part that leaves more unexplained
GRID_SCREENED = Screened(300, 30, 24)  # on the whole table
RIVALS, SPOT = 3, 25e-3  # of these, that are refined in the whole image, and [m] within which they contradict a pose
ROOM = 8  # [px] in the small image, of windows that places share
ROUNDS, STAYED = 2, 1e-3  # of searches beside all other bodies, if these move by more [m]
OTHERS_REACH = 2  # [px] about another mask, whose pixels tell nothing about a part
GAP = 0.05  # [m] up to which shapes are rendered together
BADLY = 0.045  # of the pixels about a shape: it is searched everywhere
SPOILS = 0.15  # of the pixels that a part explains: it may be exchanged
HOPEFUL = 0.7  # of what two parts explain: an exchange that explains less before parts settle is dropped
LEAST_GAIN = 12.0  # pixels of the small image that a shape must explain

Bodies = list[StandingShape | None]
"""The kits, then each part; None for one without a place."""


class SceneSearch:
    """The image in two sizes and its heights, and what was found in them."""

    def __init__(self, image: DisparityImage, labels: np.ndarray) -> None:
        """Prepare an image. labels: (H, W) its masks; raises InputError if nothing stands on the table."""
        self.image, self.small, self.labels = image, image.halved, labels
        grid = HeightGrid.of(image, labels)
        if grid is None:
            raise InputError("nothing stands on the table: expected kits and parts in view")
        self.grid = grid
        self.rivals: defaultdict[str, list[StandingShape]] = defaultdict(list)
        """For each shape the other poses that were refined beside it."""

    def bodies(self, kits: KnownShape, parts: Sequence[KnownShape]) -> Bodies:
        """Where the kits and the parts are; raises InputError if the image shows no such kits."""
        standing = self._kits(kits)
        bodies: Bodies = [standing, *self._over_masks(parts, standing)]
        self.refine(bodies, FINE[:2])
        self._place_missing(parts, bodies)
        self._settle(bodies, range(1, len(bodies)))
        bodies = self._exchanged(bodies)
        again = [bodies[0], *(None if self._fails(body, bodies) else body for body in bodies[1:])]
        if None in again:
            self._place_missing(parts, again)
            bodies = self._better(bodies, again, range(1, len(bodies)))
        return bodies

    def refine(self, bodies: Bodies, reaches: Sequence[float], scale: float = 1.0) -> None:
        """Move each body to where it and those beside it explain the image best."""
        for i, body in enumerate(bodies):
            if body is not None:
                bodies[i] = fit(self.image, body, neighbours(body, bodies, GAP), scale, reaches).shape

    def window(self, body: StandingShape, others: Sequence[StandingShape | None]) -> Window:
        """The window about a body before others."""
        return self.image.window(body, neighbours(body, others, GAP))

    def _kits(self, kits: KnownShape) -> StandingShape:
        """The kits, found in the whole image; raises InputError if it shows none."""
        found = self._candidates(self.grid, views_from_above(kits, KIT_YAWS), kits, KIT_SCREENED, KIT_REFINED)
        if not found:
            raise InputError("the image shows no kits of this shape")
        standing = fit(self.image, found[0].shape, reaches=2 * FINE).shape
        if self.image.window(standing).explained(standing).misfit > BADLY:
            near = [each.at(each.place + move) for _, each in found for move in NEARBY]
            found = self._refined(near, KIT_REFINED)
            standing = fit(self.image, found[0].shape, reaches=2 * FINE).shape
        self.rivals[kits.name] = [shape for _, shape in found]
        return standing

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
        """Places of a shape by its heights, the best of them refined.

        Args:
            grid: the heights, in which the shape is searched for; None: there are none.
            views: of the shape.
            shape: to find.
            screened: the numbers of places that are compared as they are: all faces and yaws have similar heights.
            most: the number of places that are refined.
            others: shapes beside it.
            used: (H / 2, W / 2) bool, the pixels that are compared; all if None.
        """
        places = [] if grid is None else grid.places(shape, views, *screened)
        return self._refined([place.shape for place in places], most, others, used)

    def _refined(
        self,
        places: Sequence[StandingShape],
        most: int,
        others: Sequence[StandingShape] = (),
        used: np.ndarray | None = None,
    ) -> list[Place]:
        """The best of some places refined in the small image, with the pixels that they explain there, most first."""
        windows: list[Window] = []  # places at one spot share what is behind them

        def gain(standing: StandingShape) -> Place:
            box = self.small.box(standing)
            window = next((each for each in windows if each.box.contains(box)), None)
            if window is None:
                window = self.small.window(standing, neighbours(standing, others, GAP), room=ROOM)
                windows.append(window)
            return Place(window.cropped(box).explained(standing, used).gain, standing)

        def refined(standing: StandingShape) -> StandingShape:
            return fit(self.small, standing, neighbours(standing, others, GAP), reaches=COARSE, used=used).shape

        best = distinct(sorted(map(gain, places), key=_by_score), most)
        return sorted((gain(refined(place.shape)) for place in best), key=_by_score)

    def _over_masks(self, parts: Sequence[KnownShape], kits: StandingShape) -> Bodies:
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
        return [best.get((i, j)) for i, j in enumerate(chosen)]

    def _used(self, label: int) -> np.ndarray:
        """Pixels of the small image that no other part's mask has."""
        others = (self.labels >= FIRST_PART_LABEL) & (self.labels != label)
        return np.logical_not(binary_dilation(others, iterations=OTHERS_REACH))[::2, ::2]

    def _settle(self, bodies: Bodies, which: Sequence[int]) -> None:
        """Search some parts again at their spots, beside all others, while these move."""
        before: dict[int, list[StandingShape]] = {}
        for i in [*which] * ROUNDS:
            body, others = bodies[i], [other for k, other in enumerate(bodies) if k != i and other is not None]
            if body is None:
                continue
            beside = neighbours(body, others, GAP)
            if i not in before or not _stayed(before[i], beside):
                before[i], bodies[i] = beside, self._settled(body, others)

    def _settled(self, body: StandingShape, others: Sequence[StandingShape]) -> StandingShape:
        """A part, or the rival at its spot that explains more beside the others."""
        found = self.window(body, others).explained(body)
        most, screened = found.gain, DOUBTFUL_SCREENED if found.misfit > DOUBTFUL else SPOT_SCREENED
        for _, rival in self._at_spot(body.shape, body, others, screened)[:RIVALS]:
            moved = fit(self.image, rival, neighbours(rival, others, GAP), reaches=FINE[:2]).shape
            self.rivals[body.shape.name].append(moved)
            gain = self.window(moved, others).explained(moved).gain
            if gain > most:
                most, body = gain, moved
        return body

    def _at_spot(
        self, shape: KnownShape, spot: StandingShape, others: Sequence[StandingShape], screened: Screened
    ) -> list[Place]:
        """Places of a shape where another stands, which goes, beside others; the one that explains the most first."""
        grid = self.grid.without(others)
        near = grid.about(grid.footprint(spot))
        return self._candidates(near, _part_views(shape), shape, screened, SPOT_REFINED, others)

    def _gain(self, body: StandingShape, others: Sequence[StandingShape]) -> float:
        """The pixels of the small image that a body explains beside others."""
        return self.small.window(body, neighbours(body, others, GAP)).explained(body).gain

    def _fails(self, body: StandingShape | None, bodies: Bodies) -> bool:
        """Whether a part has no place, or one where it explains the image so badly that another may be right."""
        if body is None:
            return True
        return self.window(body, bodies).explained(body).misfit > BADLY

    def _doubted(self, body: StandingShape, bodies: Bodies) -> bool:
        """Whether another pose of a part may explain more."""
        found = self.window(body, bodies).explained(body)
        return found.misfit > DOUBTFUL or found.left > SPOILS * found.gain

    def _exchanged(self, bodies: Bodies) -> Bodies:
        """Bodies of which two that are in doubt have changed their places, if they explain more so."""
        doubtful = [i for i, body in enumerate(bodies) if i and body and self._doubted(body, bodies)]
        for i, j in combinations(doubtful, 2):
            first, second = bodies[i], bodies[j]
            assert first is not None
            assert second is not None
            others = [body for k, body in enumerate(bodies) if k not in (i, j) and body is not None]
            over = self._at_spot(first.shape, second, others, SPOT_SCREENED)[:1]
            under = self._at_spot(second.shape, first, [*others, *(place.shape for place in over)], SPOT_SCREENED)[:1]
            now = sum(self._gain(body, others) for body in (first, second))
            if over and under and over[0].score + under[0].score > HOPEFUL * now:
                other = [*bodies]
                other[i], other[j] = over[0].shape, under[0].shape
                bodies = self._better(bodies, other, (i, j))
        return bodies

    def _better(self, bodies: Bodies, other: Bodies, moved: Sequence[int]) -> Bodies:
        """Bodies, or others that explain more once those that are moved are settled."""
        self._settle(other, moved)
        return other if self._explained(other) > self._explained(bodies) else bodies

    def _place_missing(self, parts: Sequence[KnownShape], bodies: Bodies) -> None:
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
        return sum(self.window(body, others).explained(body).gain for body, others in zip(rest, before, strict=True))


def _stayed(before: Sequence[StandingShape], now: Sequence[StandingShape]) -> bool:
    """Whether shapes are where they were."""
    pairs = zip(before, now, strict=False)
    return len(before) == len(now) and all(a.level is b.level and apart(a, b) < STAYED for a, b in pairs)


def _part_views(part: KnownShape) -> list[Views]:
    radius = float(np.linalg.norm(part.mesh.extents)) / 2
    return views_from_above(part, max(FEWEST_YAWS, round(2 * np.pi * radius / YAW_STEP)))


def _by_score(place: Place) -> float:
    return -place.score
