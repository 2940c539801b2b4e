"""The two ways to the seating verdict side by side: closed form and exact booleans, in the same poses.

    python bench/bench_seating.py --pairs 12 --poses 40

Half of the poses are guesses up to 10 mm and 25 degrees off, half lie on the brink where the verdict flips.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, cycle

import numpy as np
import tyro

from kit1000.errors import Kit1000Error, Redraw
from kit1000.kits.acceptance import rotated_about_centroid
from kit1000.kits.contact import convex_edges
from kit1000.kits.kit import make_kit
from kit1000.kits.seating import (
    BISECTION_STEP,
    SEATED_LIMIT,
    InsertedPart,
    SeatingResult,
    contact_offset,
    contact_offset_by_booleans,
    seating_result,
    swept_solid,
)
from kit1000.mesh import solid_from_mesh
from kit1000.parts.catalog import FAMILIES
from kit1000.parts.family import make_part
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.values import Kit, Part

FARTHEST, STEEPEST = 10e-3, np.radians(25)
BAND = 0.1e-3  # [m] from a limit, within which the two may differ
BRINK_STEPS = np.array([-2e-2, -2e-3, 2e-3, 2e-2])  # shares of an error, about the share at which the verdict flips


@dataclass(frozen=True)
class Row:
    """One pose judged twice."""

    closed: SeatingResult
    judged: SeatingResult
    to_limit: float
    """[m] from the nearest limit"""
    closed_s: float
    judged_s: float


class Pair:
    """A part over its kit, ready for both ways."""

    def __init__(self, part: Part, kit: Kit) -> None:
        self.goal, self.depth = kit.slot.goals[0], kit.slot.depth
        self.plug, self.edges = InsertedPart.of(part.mesh, self.goal), convex_edges(kit.mesh)
        self.swept, self.plate = swept_solid(part.mesh, self.plug.axis), solid_from_mesh(kit.mesh)

    def closed(self, pose: Pose) -> SeatingResult:
        return seating_result(contact_offset(self.plug, self.edges, pose), self.plug, pose, self.goal, self.depth)

    def judged(self, pose: Pose) -> SeatingResult:
        return seating_result(
            contact_offset_by_booleans(self.swept, self.plug, self.plate, pose), self.plug, pose, self.goal, self.depth
        )

    def compared(self, pose: Pose) -> Row:
        """Both verdicts on a pose, timed."""
        start = time.perf_counter()
        closed = self.closed(pose)
        between = time.perf_counter()
        judged = self.judged(pose)
        return Row(closed, judged, self.to_limit(closed), between - start, time.perf_counter() - between)

    def to_limit(self, found: SeatingResult) -> float:
        """[m] how near a verdict is to one of its limits."""
        return min(
            abs(abs(found.contact_height) - min(SEATED_LIMIT, self.depth / 3)),
            abs(abs(found.contact_offset) - SEATED_LIMIT),
        )

    def moved(self, error: np.ndarray, share: float) -> Pose:
        """The goal with a share of an error (6,) [m, rad]: shift in the kit frame, turn about the centroid."""
        return Pose.from_translation(share * error[:3]) @ rotated_about_centroid(self.goal, share * error[3:])

    def brink(self, error: np.ndarray) -> float:
        """The share of an error at which the verdict flips."""
        low, high = 0.0, 1.0
        for _ in range(14):
            middle = (low + high) / 2
            low, high = (middle, high) if self.closed(self.moved(error, middle)).seated else (low, middle)
        return low


def main(pairs: int = 12, poses: int = 40, seed: int = 1) -> None:
    """Compare the verdicts on parts drawn from all families in turn.

    Args:
        pairs: of part and kit.
        poses: for each pair.
        seed: of the draws.
    """
    rows: list[Row] = []
    for number, pair in zip(range(pairs), drawn_pairs(seed), strict=False):
        pair.compared(pair.goal)  # numba compiles on the first
        rows += [pair.compared(pose) for pose in drawn_poses(pair, poses, stream(seed, "poses", number))]
    report(pairs, rows)


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
    """Guesses, and poses on the brink."""
    for number in range(poses):
        shift, turn = rng.normal(size=(2, 3))
        error = np.concatenate(
            [
                shift / np.linalg.norm(shift) * rng.uniform(0, FARTHEST),
                turn / np.linalg.norm(turn) * rng.uniform(0, STEEPEST),
            ]
        )
        share = 1.0 if number % 2 else pair.brink(error) * (1 + rng.choice(BRINK_STEPS))
        yield pair.moved(error, share)


def report(pairs: int, rows: list[Row]) -> None:
    """Print what agrees and what it costs."""
    both = [row for row in rows if np.isfinite([row.closed.contact_offset, row.judged.contact_offset]).all()]
    differences = np.array([abs(row.closed.contact_offset - row.judged.contact_offset) for row in both])
    verdicts = np.array([(r.closed.seated, r.closed.strict) != (r.judged.seated, r.judged.strict) for r in rows])
    near = np.array([row.to_limit < BAND for row in rows])
    seated = np.mean([row.closed.seated for row in rows])
    print(
        f"{pairs} pairs, {len(rows)} poses, {seated:.0%} seated, {near.mean():.1%} within {BAND * 1e3:g} mm of a limit"
    )
    print(
        f"rise: largest difference {differences.max() * 1e6:.1f} um, {(differences > BISECTION_STEP).sum()} above the step"
    )
    print(f"verdicts that differ: {verdicts.mean():.2%}, of these outside the band {(verdicts & ~near).sum()}")
    for name, times in (("closed form", [r.closed_s for r in rows]), ("booleans", [r.judged_s for r in rows])):
        print(f"{name}: {np.median(times) * 1e3:.2f} ms a query, 95 % below {np.quantile(times, 0.95) * 1e3:.2f} ms")


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except Kit1000Error as error:
        raise SystemExit(f"bench_seating: {error}") from error
