"""Comparison of our kits with the scheme of the paper's release: seconds, faces and clearance, timed in one run.

    python bench/speed/kits.py

Both make kits of the same parts, which are stretched to the box of the release, with its clearance of 10 mm and its
block of 120 mm. A third row is our kit as a dataset has it: parts of 50 mm, a clearance of 2.5 mm.

The scheme of the release is written again in plain numpy. A pinhole 100 m below the part stands in for an orthographic
camera; its depth image fills a grid of voxels of 0.89 mm, in which everything above the part's lower surface is solid.
Copies of that, shifted by every whole number of voxels from -11 to 12 along x and y, make the cavity, and marching
cubes cut it out of a block of 120 mm. Steps, constants and the offset of the cavity are those of the release. Our
renderer makes the depth image; it is faster than that of the release, which favours the release.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, cycle
from pathlib import Path

import numpy as np
from manifold3d import Manifold
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from bench.measured import run, timed
from benchmark.measurements import Column, Measurement, estimate
from kit1000.camera import Camera
from kit1000.errors import Redraw
from kit1000.kits.clearance import points_along
from kit1000.kits.kit import CLEARANCE, KitDesign, Plate, design_kit
from kit1000.mesh import Mesh, defect_float32, solid_from_mesh
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.render import render
from kit1000.symmetry import Symmetry
from kit1000.values import Part

# The scheme of the release.
VOXEL = 0.89e-3  # [m]
TRUNCATION = 5 * VOXEL
BOX = np.array([80e-3, 80e-3, 50e-3])  # [m] every part is stretched to fill it
MARGIN = 10e-3  # [m] nominal; whole voxels make it 9.8 to 10.7 mm
SHIFTS = range(-11, 13)
BLOCK = (135, 135, 25)
PASTED_AT = 12  # voxels; 11 would centre it
CAVITY_LAYERS = 23  # of 25: two remain as a floor
BLOCK_HEIGHT = 9e-3  # [m] z of the block's middle when the part stands on z = 0
DISTANCE, FAR = 100.0, 100.05  # [m] from the camera to the part's underside, and the far limit of depth
CAMERA = Camera(1280, 720, 63e4, 63e4, 640.0, 360.0)

# What is compared.
LONGEST = 50e-3  # [m]
BLOCK_PLATE = Plate((0.12, 0.12), 22e-3)  # the release's block
HEIGHTS = np.array([3e-3, 6e-3, 9e-3, 12e-3, 15e-3])  # [m] at which the release's walls are measured
SCHEMES = (
    f"scheme of the release, {MARGIN * 1e3:g} mm",
    f"ours, the same parts, {MARGIN * 1e3:g} mm",
    f"ours, {LONGEST * 1e3:g} mm parts, {CLEARANCE * 1e3:g} mm",
)
COLUMNS = (
    Column("scheme", "kit, nominal clearance"),
    Column("n", "parts"),
    Column("seconds", "mean, s", 3),
    Column("median", "median", 3),
    Column("longest", "longest", 3),
    Column("ratio", "times the release", 1),
    Column("faces", "faces, median", 0),
    Column("smallest", "clearance from, mm", 2),
    Column("largest", "to, mm", 2),
    Column("closed", "closed, %", 0, True),
)


@dataclass(frozen=True)
class Kits:
    """Time both kit generators on parts sampled from all families in turn."""

    parts: int = 12
    """Number of parts."""
    seed: int = 1
    """Seed of the draws."""
    out: Path | None = None
    """JSON file of the table, such as results/speed-kits.json."""


@dataclass(frozen=True)
class Row:
    """One kit."""

    seconds: float
    faces: int
    smallest: float
    """[m] from a wall to the part's swept shadow"""
    largest: float
    """[m]"""
    closed: bool
    """watertight after rounding to float32, as most files and readers do"""


def main(options: Kits) -> None:
    """Print the table."""
    sampled = sampled_parts(options.seed)
    compare(next(sampled))  # numba compiles on the first
    rows = [compare(next(sampled)) for _ in range(options.parts)]
    measurement = Measurement.begin()
    title = f"Seconds to make a kit, {options.parts} parts from all families in turn"
    table = measurement.table("kits", title, *COLUMNS)
    for k, scheme in enumerate(SCHEMES):
        table.add(scheme=scheme, **summary([row[k] for row in rows], [row[0] for row in rows]))
    measurement.report(options.out)


def summary(rows: Sequence[Row], release: Sequence[Row]) -> dict[str, object]:
    """The values of a line. release: the kits of the same parts by the scheme of the release."""
    seconds = estimate([row.seconds for row in rows])
    ratios = [row.seconds / other.seconds for row, other in zip(rows, release, strict=True)]
    return {
        "n": len(rows),
        "seconds": seconds,
        "median": seconds["median"],
        "longest": max(row.seconds for row in rows),
        "ratio": 1.0 if rows == release else estimate(ratios),
        "faces": np.median([row.faces for row in rows]),
        "smallest": 1e3 * min(row.smallest for row in rows),
        "largest": 1e3 * max(row.largest for row in rows),
        "closed": np.mean([row.closed for row in rows]),
    }


def sampled_parts(seed: int) -> Iterator[Part]:
    """Parts from all families in turn, those that make a kit in both ways."""
    for number, name in zip(count(), cycle(FAMILIES), strict=False):
        try:
            dims = FAMILIES[name].draw(stream(seed, "bench", number))
            part = make_part(f"bench-{number}", name, dims, LONGEST)
            design_kit(part)
            design_kit(standing_part(stretched(part.mesh)), MARGIN, BLOCK_PLATE)
        except Redraw:
            continue
        yield part


def compare(part: Part) -> tuple[Row, Row, Row]:
    """The release's kit, ours for the same stretched part, and ours for the part as sampled."""
    standing = stretched(part.mesh)
    seconds, kit = timed(lambda: release_kit(standing))
    release = Row(seconds, len(kit.faces), *wall_distances(kit, standing), defect_float32(kit) is None)
    stretched_part = standing_part(standing)
    ours_stretched = timed(lambda: design_kit(stretched_part, MARGIN, BLOCK_PLATE))
    return release, our_row(*ours_stretched), our_row(*timed(lambda: design_kit(part)))


def our_row(seconds: float, design: KitDesign) -> Row:
    mesh, measured = design.kit.mesh, design.measured_clearance
    return Row(seconds, len(mesh.faces), measured.smallest, measured.largest, defect_float32(mesh) is None)


def standing_part(standing: Mesh) -> Part:
    """A stretched mesh as a part without declared symmetry."""
    mesh = Mesh(standing.vertices - standing.centroid, standing.faces)
    return Part("stretched", "stretched", mesh, Symmetry.none(), {}, 1.0)


def wall_distances(kit: Mesh, standing: Mesh) -> tuple[float, float]:
    """Nearest and farthest [m] of the cavity's walls from what the part sweeps, horizontally.

    A step of the floor may be wrong by one voxel without counting as a wall: the nearest wall is measured from
    the shadow one voxel lower, the farthest from the shadow one voxel higher.
    """
    part, plate = solid_from_mesh(standing), solid_from_mesh(kit)
    near, far = [], []
    for height in HEIGHTS:
        loops = sorted(plate.slice(height).to_polygons(), key=np.ptp)[:-1]  # the largest is the block
        walls = outline(loops)
        near.append(KDTree(shadow_outline(part, height - VOXEL)).query(walls)[0].min())
        far.append(KDTree(shadow_outline(part, height + VOXEL)).query(walls)[0].max())
    return float(min(near)), float(max(far))


def shadow_outline(part: Manifold, height: float) -> np.ndarray:
    """(n, 2) [m] points on the outline of a standing part's shadow up to a height [m]."""
    return outline(part.trim_by_plane((0, 0, -1), -height).project().to_polygons())


def outline(loops: list[np.ndarray]) -> np.ndarray:
    """(n, 2) points along polygons, at most 0.4 mm apart."""
    return np.concatenate([points_along(loop) for loop in loops])


def stretched(mesh: Mesh) -> Mesh:
    """The part as the release prepares it: non-uniformly scaled to the box, centred, standing on z = 0."""
    vertices = (mesh.vertices - mesh.bounds.mean(0)) * (BOX / mesh.extents)
    return Mesh(vertices + [0, 0, BOX[2] / 2], mesh.faces)


def release_kit(standing: Mesh) -> Mesh:
    """The kit of a stretched part, in the frame in which the standing part is seated."""
    grown = dilated(occupancy(standing))
    block = np.full(BLOCK, -1.0, np.float32)  # negative is solid
    nx, ny = min(grown.shape[0], BLOCK[0] - PASTED_AT), min(grown.shape[1], BLOCK[1] - PASTED_AT)
    pasted = block[PASTED_AT : PASTED_AT + nx, PASTED_AT : PASTED_AT + ny, -CAVITY_LAYERS:]
    pasted[:] = grown[:nx, :ny, :CAVITY_LAYERS]  # 1 in the cavity, 0 around it
    for axis in range(3):
        edge = np.moveaxis(block, axis, 0)
        edge[0] = edge[-1] = 1
    vertices, faces, _, _ = marching_cubes(block, 0.0)
    placed = (vertices - np.array(BLOCK) / 2) * VOXEL + [0, 0, BLOCK_HEIGHT]
    return Mesh(placed, faces.astype(np.int32))


def occupancy(standing: Mesh) -> np.ndarray:
    """(nx, ny, nz) bool: voxels above the part's lower surface, in its box grown by 10 mm along x and y."""
    low, high = standing.bounds
    low, high = low - [MARGIN, MARGIN, 0], high + [MARGIN, MARGIN, 0]
    x, y, z = (low[axis] + VOXEL * np.arange(np.ceil((high - low)[axis] / VOXEL)) for axis in range(3))
    ahead = (DISTANCE + z)[None, None]  # (1, 1, nz) along the line of sight
    # Looking up with +x upwards in the image: the camera's x runs along +y, its y along -x.
    u = np.rint(CAMERA.fx * y[None, :, None] / ahead + CAMERA.cx).astype(int)
    v = np.rint(-CAMERA.fy * x[:, None, None] / ahead + CAMERA.cy).astype(int)
    depth = depth_image(standing)[np.broadcast_to(v, np.broadcast_shapes(u.shape, v.shape)), u]
    signed = np.clip((depth - ahead) / TRUNCATION, -1, 1)
    return signed < 0


def depth_image(standing: Mesh) -> np.ndarray:
    """(720, 1280) [m] from 100 m below the part, looking up, +x upwards in the image."""
    rotation = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # columns: the camera's x, y, z in the world
    below = Pose.from_rotation_matrix(rotation, np.array([0, 0, -DISTANCE]))
    depth = render(CAMERA, below, [(standing, Pose.identity())]).depth
    return np.where(depth > 0, depth, FAR)


def dilated(occupied: np.ndarray) -> np.ndarray:
    """The union of all shifted copies: a square of 24 voxels, half a voxel off the middle."""
    reach = max(SHIFTS)
    padded = np.pad(occupied, ((reach, reach), (reach, reach), (0, 0)))
    nx, ny, _ = occupied.shape
    grown = np.zeros_like(occupied)
    for dx in SHIFTS:
        for dy in SHIFTS:
            grown |= padded[reach - dx : reach - dx + nx, reach - dy : reach - dy + ny]
    return grown


if __name__ == "__main__":
    run(main, Kits, __doc__)
