"""Comparison of our kits with the scheme of the paper's release: seconds, faces and clearance, timed in one run.

    python bench/speed/kits.py

The same parts, stretched to the release's box, with the release's 10 mm of clearance in its 120 mm block;
then ours once more as it stands in the dataset (50 mm parts, 2.5 mm).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, cycle
from pathlib import Path

import numpy as np
import tyro
from manifold3d import Manifold
from scipy.spatial import KDTree

from bench.speed.release_kits import MARGIN, VOXEL, release_kit, stretched
from bench.speed.timing import timed
from benchmark.measurements import Column, Measurement, estimate
from kit1000.errors import Kit1000Error, Redraw
from kit1000.kits.clearance import points_along
from kit1000.kits.kit import CLEARANCE, KitDesign, Plate, design_kit
from kit1000.mesh import Mesh, defect_float32, solid_from_mesh
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.rng import stream
from kit1000.symmetry import Symmetry
from kit1000.values import Part

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
    """Time both kit generators on parts drawn from all families in turn."""

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
    drawn = drawn_parts(options.seed)
    compare(next(drawn))  # numba compiles on the first
    rows = [compare(next(drawn)) for _ in range(options.parts)]
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


def drawn_parts(seed: int) -> Iterator[Part]:
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
    """The release's kit, ours for the same stretched part, and ours for the part as drawn."""
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


if __name__ == "__main__":
    try:
        main(tyro.cli(Kits))
    except Kit1000Error as error:
        raise SystemExit(f"kits: {error}") from error
