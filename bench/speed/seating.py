"""Comparison of the two computations of the seating test, closed form and exact booleans, at the same poses.

    python bench/speed/seating.py

Half of the poses have random errors up to 10 mm and 25 degrees, half lie near the limit of being seated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, cycle
from pathlib import Path

import numpy as np
import tyro

from bench.exact_offset import contact_offset_by_booleans, swept_solid
from bench.speed.timing import timed
from benchmark.measurements import Column, Measurement, estimate
from kit1000.errors import Kit1000Error, Redraw
from kit1000.kits.acceptance import rotated_about_centroid
from kit1000.kits.kit import make_kit
from kit1000.kits.seating import (
    BISECTION_STEP,
    SEATED_LIMIT,
    InsertedPart,
    SeatingResult,
    contact_offset,
    seating_result,
)
from kit1000.mesh import solid_from_mesh
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.values import Kit, Part

MAX_SHIFT, MAX_ANGLE = 10e-3, np.radians(25)  # [m], [rad] of a random error
LIMIT_BAND = 0.1e-3  # [m] from a limit, within which the two results may differ
LIMIT_STEPS = np.array([-2e-2, -2e-3, 2e-3, 2e-2])  # relative steps of an error about the limit of being seated
AGREEMENT = (
    Column("n", "poses"),
    Column("seated", "seated, %", 1, True),
    Column("near", f"within {LIMIT_BAND * 1e3:g} mm of a limit, %", 1, True),
    Column("offset", "offset, largest difference, um", 1),
    Column("above", f"offsets differing by more than {BISECTION_STEP * 1e6:g} um", 0),
    Column("differ", "verdicts that differ, %", 2, True),
    Column("outside", "of these farther from a limit", 0),
)
SECONDS = (
    Column("way", "computation"),
    Column("n", "poses"),
    Column("ms", "mean, ms", 2),
    Column("median", "median", 2),
    Column("late", "95th percentile", 2),
    Column("ratio", "times the closed form", 1),
)


@dataclass(frozen=True)
class Seating:
    """Compare both computations on parts drawn from all families in turn."""

    pairs: int = 24
    """Number of pairs of part and kit."""
    poses: int = 40
    """Number of poses of each pair."""
    seed: int = 1
    """Seed of the draws."""
    out: Path | None = None
    """JSON file of the tables, such as results/speed-seating.json."""


@dataclass(frozen=True)
class Row:
    """Both results for one pose."""

    pair: str
    """Label of the pair."""
    closed_form: SeatingResult
    booleans: SeatingResult
    to_limit: float
    """[m] from the nearest limit"""
    closed_form_s: float
    booleans_s: float


class Pair:
    """A part and its kit, prepared for both computations."""

    def __init__(self, part: Part, kit: Kit) -> None:
        self.goal, self.depth = kit.slot.goals[0], kit.slot.depth
        self.part, self.edges = InsertedPart.of(part.mesh, self.goal), kit.mesh
        self.swept, self.plate = swept_solid(part.mesh, self.part.axis), solid_from_mesh(kit.mesh)

    def closed_form(self, pose: Pose) -> SeatingResult:
        return seating_result(contact_offset(self.part, self.edges, pose), self.part, pose, self.goal, self.depth)

    def booleans(self, pose: Pose) -> SeatingResult:
        return seating_result(
            contact_offset_by_booleans(self.swept, self.part, self.plate, pose), self.part, pose, self.goal, self.depth
        )

    def compare(self, pose: Pose, label: str) -> Row:
        """Both results for a pose, timed."""
        closed_form_s, closed_form = timed(lambda: self.closed_form(pose))
        booleans_s, booleans = timed(lambda: self.booleans(pose))
        return Row(label, closed_form, booleans, self.to_limit(closed_form), closed_form_s, booleans_s)

    def to_limit(self, result: SeatingResult) -> float:
        """[m] distance of a result to the nearest of its limits."""
        return min(
            abs(abs(result.contact_height) - min(SEATED_LIMIT, self.depth / 3)),
            abs(abs(result.contact_offset) - SEATED_LIMIT),
        )

    def moved(self, error: np.ndarray, share: float) -> Pose:
        """The goal with a share of an error (6,) [m, rad]: shift in the kit frame, rotation about the centroid."""
        return Pose.from_translation(share * error[:3]) @ rotated_about_centroid(self.goal, share * error[3:])

    def seated_share(self, error: np.ndarray) -> float:
        """The share of an error at which the part is no longer seated."""
        low, high = 0.0, 1.0
        for _ in range(14):
            middle = (low + high) / 2
            low, high = (middle, high) if self.closed_form(self.moved(error, middle)).seated else (low, middle)
        return low


def main(options: Seating) -> None:
    """Print the tables."""
    rows: list[Row] = []
    for number, pair in zip(range(options.pairs), drawn_pairs(options.seed), strict=False):
        pair.compare(pair.goal, "")  # numba compiles on the first
        poses = drawn_poses(pair, options.poses, stream(options.seed, "poses", number))
        rows += [pair.compare(pose, str(number)) for pose in poses]
    measurement = Measurement.begin()
    title = f"Seating test by closed form and by exact booleans, {options.pairs} pairs"
    measurement.table("agreement", title, *AGREEMENT).add(**agreement(rows))
    table = measurement.table("seconds", "Milliseconds a pose", *SECONDS)
    times = np.array([(row.closed_form_s, row.booleans_s) for row in rows]) * 1e3  # (n, 2)
    clusters = [row.pair for row in rows]
    for way, values in zip(("closed form", "exact booleans"), times.T, strict=True):
        ms = estimate(values, clusters)
        ratio = ms["median"] / np.median(times[:, 0])
        late = np.quantile(values, 0.95)
        table.add(way=way, n=len(rows), ms=ms, median=ms["median"], late=late, ratio=ratio)
    measurement.report(options.out)


def drawn_pairs(seed: int) -> Iterator[Pair]:
    """Pairs from all families in turn."""
    for number, name in zip(count(), cycle(FAMILIES), strict=False):
        rng = stream(seed, "seating", number)
        try:
            part = make_part(name, name, FAMILIES[name].draw(rng), rng.uniform(35e-3, 50e-3))
            yield Pair(part, make_kit(part))
        except Redraw:
            continue


def drawn_poses(pair: Pair, poses: int, rng: np.random.Generator) -> Iterator[Pose]:
    """Poses with random errors, and others near the limit of being seated."""
    for number in range(poses):
        shift, axis = rng.normal(size=(2, 3))
        error = np.concatenate(
            [
                shift / np.linalg.norm(shift) * rng.uniform(0, MAX_SHIFT),
                axis / np.linalg.norm(axis) * rng.uniform(0, MAX_ANGLE),
            ]
        )
        share = 1.0 if number % 2 else pair.seated_share(error) * (1 + rng.choice(LIMIT_STEPS))
        yield pair.moved(error, share)


def agreement(rows: Sequence[Row]) -> dict[str, object]:
    """How well both agree."""
    both = [row for row in rows if np.isfinite([row.closed_form.contact_offset, row.booleans.contact_offset]).all()]
    differences = np.array([abs(row.closed_form.contact_offset - row.booleans.contact_offset) for row in both])
    differ = np.array([_flags(row.closed_form) != _flags(row.booleans) for row in rows])
    near = np.array([row.to_limit < LIMIT_BAND for row in rows])
    return {
        "n": len(rows),
        "seated": np.mean([row.closed_form.seated for row in rows]),
        "near": near.mean(),
        "offset": 1e6 * differences.max(),
        "above": (differences > BISECTION_STEP).sum(),
        "differ": differ.mean(),
        "outside": (differ & ~near).sum(),
    }


def _flags(result: SeatingResult) -> tuple[bool, bool]:
    return result.seated, result.strict


if __name__ == "__main__":
    try:
        main(tyro.cli(Seating))
    except Kit1000Error as error:
        raise SystemExit(f"seating: {error}") from error
