"""Registration of a scene: the kits and each part are found in a depth image, and all are refined together.

The kits are one rigid body, printed as one or screwed together; they stand as designed. A part may stand on any of its
stable faces. Which mask shows which part is the assignment of least cost. Of every body the best pose is kept with the
best *other* one: where that explains the image nearly as well, or where the image is explained badly, only a person can
tell, and the body is not sure.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from kit1000.errors import InputError
from kit1000.labelling.agreement import Agreement, agreement
from kit1000.labelling.alignment import SCALE_SPREAD, PlacedShape, align
from kit1000.labelling.body_windows import BodyWindow, body_windows
from kit1000.labelling.standing_plane import Support, seen_support
from kit1000.labelling.starting_poses import KnownShape, Start, starts
from kit1000.mesh import Mesh, surface_points
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth

KIT_TURNS = 72  # starting turns of the kits
PART_TURNS = 36  # of a part
PAIR_TURNS = 12  # of a part over a mask, to tell which part a mask shows
TRIED, MOST_TRIED = 8, 24  # different starts of a body that are refined; more where none of them explains the image
SAME_START, SAME_POSE = 4e-3, 1e-3  # [m] by which poses differ that count as one
LEAST_MARGIN = 0.02  # of the cost, to that of another pose
MOST_SCALE = 3 * SCALE_SPREAD  # beyond, no camera is believed
MOST_SPREAD = 1.2e-3  # [m] of a body along the line of sight, which bent depths and their scale leave open
OFTEN = 400  # most starts that are looked through for different ones
DENSE, SPARSE = 6000, 600  # points of a surface that are searched, and that are looked up
FARTHEST = 98  # percent of the points: single ones of a sparse surface may lie farther from their neighbours


@dataclass(frozen=True, eq=False)
class RegisteredBody:
    """A body at its pose."""

    name: str
    """Name of its shape."""
    label: int
    """Its value in the masks."""
    placed: PlacedShape
    agreement: Agreement
    """How well the pose explains the image."""
    rival: float | None
    """Cost of the best pose at which the shape lies elsewhere; None without one."""

    def doubts(self, scale_spread: float, scale: float = 1.0) -> tuple[str, ...]:
        """Why the image alone does not settle the pose; none where it does. A person confirms it all the same.

        scale_spread, scale: of the depths, with its standard deviation.
        """
        found = list(self.agreement.faults)
        if self.rival is not None and self.rival - self.agreement.cost < LEAST_MARGIN:
            found.append("another pose explains the image nearly as well")
        if abs(scale - 1) > MOST_SCALE:
            found.append(f"the depth scale would be {(scale - 1) * 1e2:+.1f} %: wrong shapes, or wrong intrinsics")
        spread = float(np.hypot(self.placed.spread, scale_spread * np.linalg.norm(self.placed.centre)))
        if spread > MOST_SPREAD:
            found.append(f"its distance is open: ± {spread * 1e3:.1f} mm along the line of sight")
        return tuple(found)


@dataclass(frozen=True, eq=False)
class RegisteredScene:
    """The bodies of a scene: the kits first, then the parts in the order of their labels."""

    bodies: tuple[RegisteredBody, ...]
    support: Support
    scale: float
    """Measured over true depth, as far as the known sizes tell."""
    scale_spread: float


def register_scene(image: LabelledDepth, kits: KnownShape, parts: Sequence[KnownShape]) -> RegisteredScene:
    """Find known shapes in a labelled depth image.

    Args:
        image: the depth image; its masks say where bodies are, and may be somewhat too wide.
        kits: the kits as one body.
        parts: those of the scene, in any order; fewer than it shows parts is allowed.

    Raises:
        InputError: no kits or too few parts are in the masks, or too little of the table is in view.
    """
    support, windows = seen_support(image), body_windows(image)
    if ASSEMBLY_LABEL not in windows:
        raise InputError("the masks show no kits: import the image again and choose them by --kit")
    part_windows = [window for label, window in windows.items() if label >= FIRST_PART_LABEL]
    if len(part_windows) < len(parts):
        raise InputError(f"{len(parts)} parts given, and the masks show {len(part_windows)}: leave out the others")
    pairs = [(kits, windows[ASSEMBLY_LABEL]), *_assigned(parts, part_windows, support)]
    bodies = [_registered(shape, window, support) for shape, window in pairs]
    return together(bodies, support)


def together(bodies: Sequence[RegisteredBody], support: Support) -> RegisteredScene:
    """Bodies refined together: those that agree with the image tell the depth scale, and all follow it."""
    sound = [body.placed for body in bodies if not body.agreement.faults]
    scale, spread = 1.0, SCALE_SPREAD
    if sound:
        found = align(sound, support)
        scale, spread = found.scale, found.scale_spread
    aligned = align([body.placed for body in bodies], support, scale, fixed_scale=True)
    moved = (
        replace(body, placed=placed, agreement=agreement(placed, support, scale))
        for body, placed in zip(bodies, aligned.shapes, strict=True)
    )
    return RegisteredScene(tuple(moved), support, scale, spread)


def _assigned(
    parts: Sequence[KnownShape], windows: Sequence[BodyWindow], support: Support
) -> list[tuple[KnownShape, BodyWindow]]:
    """Which mask shows which part, in the order of the masks."""
    if len(parts) == len(windows) == 1:
        return [(parts[0], windows[0])]
    costs = np.ones((len(parts), len(windows)))
    for i, shape in enumerate(parts):
        for j, window in enumerate(windows):
            first = starts(shape, window, support, PAIR_TURNS)[:2]
            refined = (_refined(start, support) for start in first)
            costs[i, j] = min((agreement(placed, support).cost for placed in refined), default=1.0)
    rows, columns = linear_sum_assignment(costs)
    found = sorted(zip(columns.tolist(), rows.tolist(), strict=True))
    return [(parts[row], windows[column]) for column, row in found]


def _registered(shape: KnownShape, window: BodyWindow, support: Support) -> RegisteredBody:
    """The best pose of a shape in a window, with the cost of the best other one."""
    found = starts(shape, window, support, KIT_TURNS if window.label == ASSEMBLY_LABEL else PART_TURNS)
    if not found:
        raise InputError(f"{shape.name}: its mask has no depth: choose another image")
    distance = ShapeDistance(shape.mesh)
    scored: list[tuple[Agreement, PlacedShape]] = []
    for start in _different(found, distance):
        if len(scored) >= TRIED and not min(scored, key=_cost)[0].faults:
            break
        placed = _refined(start, support)
        scored.append((agreement(placed, support), placed))
    scored.sort(key=_cost)
    best, placed = scored[0]
    others = (
        score.cost
        for score, other in scored[1:]
        if distance.between(placed.camera_from_body, other.camera_from_body) > SAME_POSE
    )
    return RegisteredBody(shape.name, window.label, placed, best, next(others, None))


def _cost(entry: tuple[Agreement, PlacedShape]) -> float:
    return entry[0].cost


def _refined(start: Start, support: Support) -> PlacedShape:
    return align([start.placed], support, fixed_scale=True).shapes[0]


def _different(found: Sequence[Start], distance: ShapeDistance) -> Iterator[Start]:
    """The first MOST_TRIED starts that differ from each other, each looked for when it is asked for."""
    kept: list[Start] = []
    for start in found[:OFTEN]:
        pose: Pose = start.placed.camera_from_body
        if all(distance.between(pose, other.placed.camera_from_body) > SAME_START for other in kept):
            kept.append(start)
            yield start
        if len(kept) == MOST_TRIED:
            return


class ShapeDistance:
    """The distance between poses of one shape: up to its symmetries, and those that no one declared."""

    def __init__(self, mesh: Mesh) -> None:
        """Prepare a mesh, in its own frame."""
        points = surface_points(mesh, DENSE, stream(0, "labelling", "surface"))
        self._tree, self._points = KDTree(points), points[:SPARSE]
        self._spacing = self._far(self._points + 1e-12, 2)

    def between(self, a: Pose, b: Pose) -> float:
        """[m] from the surface at one pose to that at the other, nearly the largest; 0 where they coincide."""
        moved = (a.inverse() @ b).apply(self._points)
        return max(self._far(moved, 1) - self._spacing, 0.0)

    def _far(self, points: np.ndarray, rank: int) -> float:
        """[m] to the neighbour of a rank, nearly the largest."""
        distances = np.reshape(self._tree.query(points, k=rank)[0], (len(points), rank))
        return float(np.percentile(distances[:, -1], FARTHEST))
