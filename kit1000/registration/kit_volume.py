"""The kits of a scene, as an image shows them or as they truly are: points, volumes of plates, and their cavities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Protocol

import numpy as np
from scipy.ndimage import find_objects, label

from kit1000.perception.image_kinds import Noise
from kit1000.perception.observed.columns import MaskedView, observed_distance
from kit1000.perception.observed.pixels import oriented_points
from kit1000.perception.observed.plates import Plane, find_planes, on_plane, plane_frame, without_nested
from kit1000.pose import Pose
from kit1000.registration.geometry.cavity import VOXEL, Cavity, find_cavity, holes_in, plate_grid
from kit1000.rng import stream
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, Query, TrueGeometry
from kit1000.voxels import Grid, Volume, signed_distance, surface_points

WIDER = 1.4  # factor on the width of maps if the border cuts all cavities: a guess may err along two axes
DEEPER = (2.0, 3.0)  # factors on the depth of the cut if a cavity seems to run out over a rim: noise may bend the rim
MOST_MAPS = 24  # maps that are searched: eight planes, some of them with many holes
LEAST_REGION = 1e-4  # [m^2] a smaller hole holds no part

WIDE_AREA = 0.025  # [m^2] seen area of a wide plate; two plates in one plane show less
REACH = 0.11  # [m] along an axis, from the middle of a plate to a border that one map still shows
WIDEST = 0.25  # [m] from the middle of a wide plate to its border, beyond which it is not looked at
BORDER = 0.02  # [m] beyond the border of a wide plate, within its map
WITHIN = 98  # percentile of the distances of points from the middle, that stands for the border
MOST_HOLES = 12  # largest holes of a wide plate that are looked into
WAVY_CUT = 2.0  # factor on the depth of the cut in a wide plate, if noise bends rims

COARSE = 2e-3  # [m] voxels of the true volume in which planes are searched
TRUE_NOISE = Noise(0.5e-3, float(np.radians(1.5)), 1)


class Kits(Protocol):
    """The kits of a scene."""

    @property
    def noise(self) -> Noise:
        """Noise of their points and normals."""
        ...

    def oriented_points(self, box: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
        """Points (n, 3) [m] on the kits within a box (2, 3) or everywhere, their normals, the area [m^2] of a point."""
        ...

    def volume(self, grid: Grid) -> Volume:
        """The kits on a grid."""
        ...


@dataclass(frozen=True, eq=False)
class SeenKits:
    """The kits as an image shows them, or several images."""

    images: Sequence[MaskedView]
    noise: Noise

    @classmethod
    def of(cls, images: Sequence[LabelledDepth], noise: Noise) -> SeenKits:
        """The pixels of the kits in labelled images."""
        return cls([MaskedView.of(image, ASSEMBLY_LABEL) for image in images], noise)

    def oriented_points(self, box: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
        """Points of the pixels, with normals from their neighbours."""
        found = [oriented_points(view, mask, self.noise.window) for view, mask in self.images]
        points, normals = (np.concatenate([each[k] for each in found]) for k in (0, 1))
        inside = np.ones(len(points), bool) if box is None else ((points >= box[0]) & (points <= box[1])).all(1)
        return points[inside], normals[inside], float(np.mean([area for *_, area in found])) / len(found)

    def volume(self, grid: Grid) -> Volume:
        """What the images show."""
        return observed_distance(grid, self.images)


@dataclass(frozen=True, eq=False)
class TrueKits:
    """The kits as they are."""

    geometry: TrueGeometry
    noise: Noise = TRUE_NOISE

    def oriented_points(self, box: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
        """Zero crossings of a coarse volume, with its gradients."""
        if box is None:
            corners = self.geometry.world_from_assembly.apply(self.geometry.assembly.vertices)
            box = np.stack([corners.min(0), corners.max(0)])
        shape = np.ceil((box[1] - box[0]) / COARSE).astype(int) + 4
        grid = Grid.centred(Pose.from_translation(box.mean(0)), tuple(shape.tolist()), COARSE)
        volume = self.volume(grid)
        points = surface_points(volume)
        return points, _gradients(volume, points), COARSE**2 * 2 / 3  # 1.5 crossings a cell on average

    def volume(self, grid: Grid) -> Volume:
        """The exact distance."""
        true = self.geometry
        return signed_distance(grid, [(true.assembly, true.world_from_assembly)], threads=1)


class KitCavities:
    """The cavities of a scene's kits near a guess; each width of map is searched once, for all parts of the scene."""

    def __init__(self, kits: Kits, query: Query) -> None:
        """query: its guess bounds the search, its id names the stream of random draws."""
        self.kits, self.query = kits, query
        self._found: dict[float, list[Cavity]] = {}

    @property
    def noise(self) -> Noise:
        """Noise of the kits."""
        return self.kits.noise

    def within(self, side: float) -> list[Cavity]:
        """The cavities in maps of a width [m]."""
        if side not in self._found:
            self._found[side] = find_cavities(self.kits, self.query, side)
        return self._found[side]


def find_cavities(kits: Kits, query: Query, side: float) -> list[Cavity]:
    """The cavities of all plates near the guess; without a guess those of all plates.

    If no map holds a cavity, WIDER ones are searched. A plate without a cavity is then cut DEEPER. If noise bends rims,
    plates are cut deeper at once, and small holes are left out beside a cavity that holds a part.

    Args:
        kits: of the scene.
        query: its guess and id, see `KitCavities`.
        side: [m] width of the maps.
    """
    frames, noise = _plate_frames(kits, query, side), kits.noise
    small: list[Cavity] = []
    for wide, cuts in ((side, (1.0, *DEEPER) if noise.wavy_rims else (1.0,)), (WIDER * side, (1.0, *DEEPER))):
        found = [_cavity(kits.volume(plate_grid(frame, wide)), frame, noise, cuts) for frame in frames]
        cavities = [cavity for cavity in found if cavity is not None]
        large = [cavity for cavity in cavities if _holds_a_part(cavity)]
        if large:
            return large if noise.wavy_rims else cavities
        small = small or cavities
    return small


def _plate_frames(kits: Kits, query: Query, side: float) -> list[Pose]:
    """world_from_plate of each map of a width [m] that is searched for a cavity."""
    guessed = None if query.guess is None else query.guess.apply(query.pivot)
    box = None if guessed is None else guessed + np.array([[-side / 2], [side / 2]])
    points, normals, area = kits.oriented_points(box)
    planes = find_planes(points, normals, area, kits.noise, stream(0, "registration", query.id))
    planes = without_nested(planes, points, normals, kits.noise)
    if guessed is not None:
        return [plane_frame(plane, guessed) for plane in planes]
    about = (plate_frames(kits, plane, points, normals, side) for plane in planes)
    return list(chain.from_iterable(about))[:MOST_MAPS]


def _cavity(volume: Volume, world_from_plate: Pose, noise: Noise, cuts: Sequence[float]) -> Cavity | None:
    """The first cavity that holds a part, by deeper and deeper cuts; if none does, the first."""
    first = None
    for deeper in cuts:
        cavity = find_cavity(volume, world_from_plate, noise, deeper)
        if _holds_a_part(cavity):
            return cavity
        first = first or cavity
    return first


def _holds_a_part(cavity: Cavity | None) -> bool:
    """Whether there is a cavity, and its region is larger than LEAST_REGION."""
    return cavity is not None and np.count_nonzero(cavity.region) * VOXEL**2 > LEAST_REGION


def plate_frames(kits: Kits, plane: Plane, points: np.ndarray, normals: np.ndarray, side: float) -> list[Pose]:
    """world_from_plate of the maps of a plate: one about its middle, or of a wide plate one about each hole.

    Args:
        kits: of the scene.
        plane: of the plate.
        points: (n, 3) [m] world, on the kits.
        normals: (n, 3) unit.
        side: [m] width of a map.
    """
    frame, noise = plane_frame(plane, plane.point), kits.noise
    if plane.area < WIDE_AREA:
        return [frame]
    local = frame.inverse().apply(points[on_plane(plane, points, normals, noise)])[:, :2]
    reach = float(np.percentile(np.abs(local), WITHIN, axis=0).max()) if len(local) else 0.0
    if reach <= max(REACH, side / 2):
        return [frame]
    volume = kits.volume(plate_grid(frame, 2 * min(reach + BORDER, WIDEST)))
    holes = holes_in(volume, noise.distance, WAVY_CUT if noise.wavy_rims else 1.0)
    centres = [frame.apply(np.append((cell - (len(holes) - 1) / 2) * VOXEL, 0.0)) for cell in _centres(holes)]
    return [plane_frame(plane, centre) for centre in centres] or [frame]


def _centres(holes: np.ndarray) -> Sequence[np.ndarray]:
    """(2,) cells: the middles of the largest of holes (n, n) bool that may hold a part."""
    names, count = label(holes)  # type: ignore[misc]
    areas = np.bincount(names.ravel(), minlength=count + 1)[1:] * VOXEL**2
    boxes = find_objects(names)
    order = [i for i in np.argsort(-areas, kind="stable").tolist() if areas[i] > LEAST_REGION][:MOST_HOLES]
    return [np.array([(side.start + side.stop - 1) / 2 for side in boxes[i]]) for i in order]


def _gradients(volume: Volume, points: np.ndarray) -> np.ndarray:
    """(n, 3) unit gradients of the distance at the voxels nearest to points (n, 3) [m]."""
    limit = np.array(volume.grid.shape) - 2
    i, j, k = np.clip(np.rint(volume.grid.indices(points)).astype(int), 1, limit).T
    v = volume.values
    gradients = np.stack(
        [
            v[i + 1, j, k] - v[i - 1, j, k],
            v[i, j + 1, k] - v[i, j - 1, k],
            v[i, j, k + 1] - v[i, j, k - 1],
        ],
        axis=-1,
    )
    return gradients / np.maximum(np.linalg.norm(gradients, axis=1, keepdims=True), 1e-12)
