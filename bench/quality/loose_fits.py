"""An attack on the pairs of a dataset: does a part also go into its slot where it is near no goal?

    python bench/quality/loose_fits.py data/kit1000 --count 150

It shares no search with `kit1000.kits.loose_fits`. Random poses beyond the limits, about the goals and on every face
the part can rest on, are ranked by the number of points that are inside the kit; from the best, Nelder and Mead's
simplex lowers the exact height of contact. A pair falls when a pose fits by contact alone (`seated` without its limit
of rotation), upright within 5 degrees, and turned or shifted beyond the limits (10 degrees, 5 mm) from every goal.

With --jams it also counts poses tilted by more than 5 degrees and 10 degrees from every goal: these are jammed, not
another way to put the part in, and `seated` refuses them by their rotation.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from scipy.optimize import minimize
from tqdm import tqdm

from benchmark.measurements import Column, Measurement, rate
from kit1000.dataset.reader import Dataset
from kit1000.kits.contact import contact_features, vertical_contact_offset
from kit1000.kits.face import resting_faces
from kit1000.kits.goals import nearest_about_axis
from kit1000.kits.height_fields import lower_envelope
from kit1000.kits.loose_fits import near_goal_limits
from kit1000.kits.seating import BISECTION_STEP, SEATED_LIMIT, UP, InsertedPart, contact_offset
from kit1000.mesh import Mesh, surface_points
from kit1000.numerics.compiled import compiled
from kit1000.pose import Pose, quaternion_angle
from kit1000.values import Kit, Part

UPRIGHT_DEG = 5.0  # most tilt of a part that goes in upright
CELL = 0.25e-3  # [m] of the height field
POINTS = 2000  # on the part's surface, beside its vertices
TURNED_POSES, ANY_POSES = 10_000, 3_000  # random poses about the goals, and on each face
REFINED_TURNED, REFINED_ANY = 3, 1  # best of them that are refined
MOST_INSIDE = 100  # points; a pose with more is far from fitting
LOOKED_AT = 200  # best poses of which those near a goal, or near a better one, are left out
STEPS = 40  # contacts of one descent
FIRST_STEPS, HOPELESS = 12, 2e-3  # after so many contacts, all higher than the limit by this [m], it is given up
UNIT = np.array([np.radians(1.0), 0.5e-3, 0.5e-3, np.radians(1.0), np.radians(1.0)])  # of yaw, shift and tilt

POSE_COLUMNS = (
    Column("part", "part"),
    Column("kind", "kind"),
    Column("turn_deg", "rotation about the axis, °", 1),
    Column("shift_mm", "offset, mm", 1),
    Column("tilt_deg", "tilt, °", 1),
    Column("height_mm", "height, mm", 2),
)


@dataclass(frozen=True)
class Attack:
    """Attack the parts and kits of a dataset."""

    data: tyro.conf.Positional[Path]
    """Dataset folder."""
    count: int = 150
    """Pairs attacked, drawn at random."""
    seed: int = 0
    """Seed of all draws."""
    jams: bool = False
    """Look for jammed poses as well."""
    out: Path | None = None
    """JSON file of the tables, such as results/loose-fits.json."""


class Start(NamedTuple):
    """A face down, and a random pose on it: yaw, shift and tilt (5,) [rad, m]."""

    base: Pose
    up: np.ndarray
    """(3,) unit, part frame: upright on that face."""
    state: np.ndarray


class Found(NamedTuple):
    """A pose that fits near no goal."""

    turn_deg: float
    """About the insertion axis, from the nearest goal; 180 on another face."""
    shift_mm: float
    tilt_deg: float
    height_mm: float


class Target:
    """A pair under attack."""

    def __init__(self, part: Part, kit: Kit, rng: np.random.Generator) -> None:
        self.part, self.slot, self.rng = part, kit.slot, rng
        self.edges, self.kit_edges = part.mesh, kit.mesh
        self.kit_features = contact_features(self.kit_edges, np.eye(3), np.zeros(3), 1.0)
        angle, self.most_shift = near_goal_limits(kit.slot.clearance)
        self.most_deg = float(np.degrees(angle))
        self.deep = min(SEATED_LIMIT, kit.slot.depth / 3) - BISECTION_STEP
        heights, self.corner = lower_envelope(Mesh(kit.mesh.vertices * [1, 1, -1], kit.mesh.faces[:, ::-1]), CELL)
        self.heights = np.where(np.isfinite(heights), -heights, 0.0)
        self.points = rng.permutation(np.concatenate([part.mesh.vertices, surface_points(part.mesh, POINTS, rng)]))

    def fit(self) -> Found | None:
        """A pose in which the part goes in upright, near no goal."""
        for start in [*self.best_turned(), *self.best_on_faces()]:
            found = self.descend(start, (0.0, UPRIGHT_DEG))
            if found:
                return found
        return None

    def jam(self) -> Found | None:
        """A tilted pose that fits, 10 degrees from every goal."""
        design = self.slot.goals[0]
        for angle in np.radians(np.arange(0, 360, 45)):
            tilt = np.radians(self.most_deg + 0.3) * np.array([np.cos(angle), np.sin(angle)])
            found = self.descend(Start(design, design.inverse().rotate(UP), np.array([0, 0, 0, *tilt])), (5.0, 90.0))
            if found:
                return found
        return None

    def best_turned(self) -> list[Start]:
        """Poses turned by up to 6 degrees beyond the limit from the design pose, a little shifted and tilted."""
        design, n = self.slot.goals[0], TURNED_POSES
        yaw = np.radians(self.most_deg + self.rng.uniform(0.02, 6, n)) * self.rng.choice([-1, 1], n)
        shift = self.rng.uniform(-1, 1, (n, 2)) * (self.slot.clearance + 1.5e-3)
        tilt = np.radians(self.rng.uniform(-4.5, 4.5, (n, 2))) * self.rng.uniform(0, 1, (n, 1))
        return self.ranked(design, design.inverse().rotate(UP), np.column_stack([yaw, shift, tilt]), REFINED_TURNED)

    def best_on_faces(self) -> Iterator[Start]:
        """Poses at any yaw on each face, near no goal."""
        for face in resting_faces(self.part.mesh, 0.01):
            low, high = self.part.mesh.moved(face.plane_from_part).bounds
            base = Pose(face.plane_from_part.wxyz, self.slot.goals.xyz[0] * [1, 1, 0])
            room = self.slot.clearance + np.abs(low + high)[:2].max() + 3e-3
            states = np.column_stack(
                [
                    self.rng.uniform(0, 2 * np.pi, ANY_POSES),
                    self.rng.uniform(-room, room, (ANY_POSES, 2)),
                    np.radians(self.rng.uniform(-1, 1, (ANY_POSES, 2))),
                ]
            )
            lowest = self.slot.goals.xyz[:, 2].min() - self.deep
            if -low[2] - self.slot.depth > self.slot.goals.xyz[:, 2].max() + self.deep or high[2] < lowest:
                continue
            yield from self.ranked(base, -face.normal, states, REFINED_ANY)

    def ranked(self, base: Pose, up: np.ndarray, states: np.ndarray, count: int) -> list[Start]:
        """The states with the fewest points inside the kit, at the greatest height that counts; at least 2 degrees or
        1 mm apart."""
        n = np.zeros(len(states))
        tilts, yaws = Pose.from_rotvec(np.column_stack([states[:, 3:], n])), np.column_stack([n, n, states[:, 0]])
        rotations = (tilts @ Pose.from_rotvec(yaws) @ Pose(base.wxyz, np.zeros(3))).rotation_matrix()
        xyz = np.column_stack([base.xyz[:2] + states[:, 1:3], np.full(len(states), self.slot.goals.xyz[:, 2].max())])
        inside = _points_inside(self.points, self.heights, *self.corner, rotations, xyz + [0, 0, self.deep])
        chosen: list[np.ndarray] = []
        for i in np.argsort(inside, kind="stable")[:LOOKED_AT]:
            if all((np.abs(states[i] - other) > 2 * UNIT).any() for other in chosen) and self.is_other(base, states[i]):
                chosen.append(states[i])
            if len(chosen) == count:
                break
        return [Start(base, up, state) for state in chosen]

    def pose(self, base: Pose, state: np.ndarray) -> Pose:
        """The base pose turned, shifted and tilted."""
        turn = Pose.from_rotvec(np.array([*state[3:], 0.0])) @ Pose.from_rotvec(np.array([0, 0, state[0]]))
        return Pose((turn @ Pose(base.wxyz, np.zeros(3))).wxyz, base.xyz + [*state[1:3], 0])

    def is_other(self, base: Pose, state: np.ndarray) -> bool:
        """Whether a pose is turned from every goal."""
        return self.turned(self.pose(base, state))[0] > self.most_deg

    def turned(self, pose: Pose) -> tuple[float, float, float]:
        """Turn [deg] about the vertical from the nearest goal, tilt [deg] against it, shift [m]."""
        best = (np.inf, 180.0, 0.0, 0.0)
        for goal in self.slot.goals:
            near = goal if self.slot.free_axis is None else nearest_about_axis(pose, goal, self.slot.free_axis)
            w, _, _, z = (pose @ near.inverse()).wxyz
            turn = float(np.degrees(2 * np.arctan2(abs(z), abs(w))))
            tilt = float(np.degrees(2 * np.arccos(np.clip(np.hypot(w, z), 0, 1))))
            turn = 180.0 if tilt > 30 else turn  # on another face
            shift = float(np.linalg.norm(pose.xyz - near.xyz))
            best = min(best, (max(turn / self.most_deg, shift / self.most_shift), turn, tilt, shift))
        return best[1:]

    def descend(self, start: Start, tilts: tuple[float, float]) -> Found | None:
        """The first pose of a simplex that fits, is tilted [deg] as wanted and lies beyond the limits."""
        found: list[Found] = []
        heights: list[float] = []

        def cost(scaled: np.ndarray) -> float:
            if found or (len(heights) >= FIRST_STEPS and min(heights) > self.deep + HOPELESS):
                return 0.0
            pose = self.pose(start.base, scaled * UNIT)
            moving = contact_features(self.edges, pose.rotation_matrix(), np.array([*pose.xyz[:2], 0.0]), -1.0)
            z = max(vertical_contact_offset(moving, self.kit_features), -1.0)
            pose = Pose(pose.wxyz, np.array([*pose.xyz[:2], z]))
            tilt = float(np.degrees(np.arccos(np.clip(pose.rotate(start.up)[2], -1, 1))))
            turn, _, shift = self.turned(pose)
            far = quaternion_angle(pose.wxyz, start.base.wxyz) > np.radians(self.most_deg) if tilts[0] else False
            beyond = self.most_deg * max(turn / self.most_deg, shift / self.most_shift, 1.01 if far else 0.0)
            outside = max(1.0005 * self.most_deg - beyond, 0) + max(tilt - tilts[1], 0) + max(tilts[0] - tilt, 0)
            height = float(np.abs(z - self.slot.goals.xyz[:, 2]).min())
            heights.append(height)
            if height <= self.deep and outside == 0 and self.fits(pose):
                found.append(Found(turn, shift * 1e3, tilt, height * 1e3))
            return height * 1e3 + 3 * outside

        first = start.state / UNIT
        simplex = np.concatenate([first[None], first + np.eye(5)])
        minimize(cost, first, method="Nelder-Mead", options={"maxfev": STEPS, "initial_simplex": simplex})
        return found[0] if found else None

    def fits(self, pose: Pose) -> bool:
        """Whether contact alone passes the seating test, along the insertion axis as the pose carries it."""
        goal = min(self.slot.goals, key=lambda goal: quaternion_angle(pose.wxyz, goal.wxyz))
        axis = goal.inverse().rotate(UP)
        axis = axis if pose.rotate(axis)[2] > 0.9 else pose.inverse().rotate(UP)
        offset = contact_offset(InsertedPart(self.edges, axis), self.kit_edges, pose)
        contact = pose.xyz + offset * pose.rotate(axis)
        height = np.abs(contact[2] - self.slot.goals.xyz[:, 2]).min()
        return bool(height <= self.deep and abs(offset) < SEATED_LIMIT - BISECTION_STEP)


@compiled
def _points_inside(points, heights, x0, y0, rotations, positions):
    """(n,) the number of points that lie below the height field in each of n poses."""
    inside = np.zeros(rotations.shape[0], np.int64)
    for k in range(rotations.shape[0]):
        r = rotations[k]
        for p in range(points.shape[0]):
            a, b, c = points[p]
            i = round((r[0, 0] * a + r[0, 1] * b + r[0, 2] * c + positions[k, 0] - x0) / CELL)
            j = round((r[1, 0] * a + r[1, 1] * b + r[1, 2] * c + positions[k, 1] - y0) / CELL)
            if 0 <= i < heights.shape[0] and 0 <= j < heights.shape[1]:
                inside[k] += heights[i, j] > r[2, 0] * a + r[2, 1] * b + r[2, 2] * c + positions[k, 2] + 1e-5
            if inside[k] > MOST_INSIDE:
                break
    return inside


def main(run: Attack) -> int:
    """Print the share of pairs that fall, and the pose in which each does."""
    dataset = Dataset(run.data)
    ids = sorted(dataset.geometry.kits)
    chosen = sorted(np.random.default_rng(run.seed).choice(ids, min(run.count, len(ids)), replace=False))
    found: dict[str, list[Found | None]] = {"loose fit": []} | ({"jam": []} if run.jams else {})
    for number, part_id in enumerate(tqdm(chosen, desc="pairs", unit="", disable=None)):
        rng = np.random.default_rng([run.seed, number])
        target = Target(dataset.geometry.part(part_id), dataset.geometry.kit(part_id), rng)
        found["loose fit"].append(target.fit())
        if run.jams:
            found["jam"].append(target.jam())
    measurement = Measurement.begin(dataset)
    columns = (
        Column("kind", "kind"),
        Column("n", "pairs"),
        Column("fallen", "fallen", 0),
        Column("rate", "fallen, %", 1, True),
    )
    rates = measurement.table("rates", "Pairs whose part goes into its slot near no goal", *columns)
    poses = measurement.table("poses", "Poses in which it does", *POSE_COLUMNS)
    for kind, results in found.items():
        fallen = [result is not None for result in results]
        rates.add(kind=kind, n=len(results), fallen=sum(fallen), rate=rate(fallen))
        for part_id, result in zip(chosen, results, strict=True):
            if result is not None:
                poses.add(kind=kind, part=str(part_id), **result._asdict())
    measurement.report(run.out)
    return 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Attack, description=__doc__)))
