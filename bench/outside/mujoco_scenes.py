"""Do exported scenes work in an engine of others? MuJoCo inserts parts.

    make mujoco DATA=data/kit1000

Each part starts out along the insertion axis of a motion, is lowered by a compliant hand along a straight line and is
released, as in `kit1000.sim.insertion`; the exact seating test judges where it comes to rest. Scenes are exported as by
`kit1000 export --format mjcf`.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from bench.measured import measured_dataset, run
from benchmark.measurements import Column, Measurement, rate
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.export.mjcf import SCENE, Shapes, write_scene
from kit1000.kits.seating import HOVER
from kit1000.mesh import inertia
from kit1000.metrics import seatings
from kit1000.pose import Pose, quaternion_conjugate, quaternion_multiply
from kit1000.rng import stream
from kit1000.sim.insertion import HAND_SPEED, MAX_FORCE, MAX_TORQUE, clamp_norm, classify_outcome
from kit1000.values import Truth

mujoco: Any = importlib.import_module("mujoco")  # from an environment of its own
FREQUENCY, MAX_LAG = 500.0, 1e-3  # [rad/s] of part and hand, stiffer than in `kit1000.sim.insertion`; [m] when blocked
CATCH_UP, REST = 0.1, 1.5  # [s] that the hand waits at the end of its path, and that a part may take to come to rest
OFFSET = 1.5  # clearances by which a wrong motion is off, in a random direction along the plate
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Options:
    """What is measured."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder. Default: a new tiny one."""
    pairs: int = 100
    """Number of parts that are inserted."""
    wrong: int = 50
    """Number of them that are also inserted by wrong motions."""
    out: Path | None = None
    """JSON file to write."""


@dataclass(frozen=True, eq=False)
class Engine:
    """A scene in MuJoCo."""

    model: Any
    data: Any

    @staticmethod
    def load(path: Path) -> Engine:
        """A scene file."""
        model = mujoco.MjModel.from_xml_path(str(path))
        return Engine(model, mujoco.MjData(model))

    def place(self, part: int, pose: Pose) -> None:
        """Put a part at rest at world_from_part."""
        self.data.qpos[7 * part : 7 * part + 7] = [*pose.xyz, *pose.wxyz]
        self.data.qvel[6 * part : 6 * part + 6] = 0.0

    def pose(self, part: int) -> Pose:
        """world_from_part"""
        xyz, wxyz = np.split(self.data.qpos[7 * part : 7 * part + 7].copy(), [3])
        return Pose(wxyz, xyz)

    def step(self, seconds: float) -> None:
        """Advance the simulation."""
        mujoco.mj_step(self.model, self.data, nstep=round(seconds / self.model.opt.timestep))

    def insert(self, part: int, tensor: np.ndarray, target: Pose, out: np.ndarray) -> tuple[Pose, Pose]:
        """Lower a part along `out` (3,) to its target world_from_part and release it: its poses then, and at rest.

        tensor: (3, 3) [kg m^2] inertia in the part's frame.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.place(part, Pose(target.wxyz, target.xyz + HOVER * out))
        body = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, f"p{part}")
        mass, dt = self.model.body_mass[body], self.model.opt.timestep
        for step in range(round((HOVER / HAND_SPEED + CATCH_UP) / dt)):
            left = max(HOVER - HAND_SPEED * dt * step, 0.0)
            hand, now = target.xyz + left * out, self.pose(part)
            linear, angular = np.split(self.data.qvel[6 * part : 6 * part + 6], 2)
            if (now.xyz - hand) @ out > MAX_LAG:
                break
            pull = FREQUENCY**2 * (hand - now.xyz) - 2 * FREQUENCY * (linear + HAND_SPEED * (left > 0) * out)
            error = Pose(quaternion_multiply(quaternion_conjugate(now.wxyz), target.wxyz), np.zeros(3)).rotvec()
            twist = tensor @ (FREQUENCY**2 * error - 2 * FREQUENCY * angular)
            force = clamp_norm(mass * pull, MAX_FORCE) - mass * self.model.opt.gravity
            self.data.xfrc_applied[body] = [*force, *now.rotate(clamp_norm(twist, MAX_TORQUE))]
            mujoco.mj_step(self.model, self.data)
        released = self.pose(part)
        self.data.xfrc_applied[body] = 0.0
        self.step(REST)
        return released, self.pose(part)


def chosen_scenes(dataset: Dataset, pairs: int) -> Iterator[tuple[RecordedScene, list[Truth]]]:
    """Scenes of the test split with truths about parts that no earlier one has, those with most new parts first."""
    split, seen = dataset.split("test-all", truth=True), set[str]()
    truths = {
        scene.id: [scene.truth_of(query.id) for query in scene.queries if query.track == "snap"] for scene in split
    }
    while pairs > 0 and truths:
        new = {name: [truth for truth in each if truth.part_id not in seen] for name, each in truths.items()}
        name = max(new, key=lambda name: len(new[name]))
        if not new[name]:
            return
        yield split.scene(name), new[name][:pairs]
        pairs -= len(new[name])
        seen |= {truth.part_id for truth in new[name]}
        del truths[name]


def off(truth: Truth) -> Pose:
    """The true motion, OFFSET clearances off along the plate."""
    angle = stream(0, "off", truth.query_id).uniform(0, 2 * np.pi)
    shift = OFFSET * truth.slot.clearance * np.array([np.cos(angle), np.sin(angle), 0.0])
    return Pose.from_translation(truth.world_from_kit.rotate(shift)) @ truth.goal_drawn


def inserted(
    engine: Engine, dataset: Dataset, recorded: RecordedScene, truth: Truth, motion: Pose
) -> tuple[Pose, Pose, bool]:
    """The motions of a part until its release and until it rests, and whether it left its kit."""
    number = [body.id for body in recorded.scene.bodies[1:]].index(truth.part_id)
    part, kit = dataset.geometry.part(truth.part_id), dataset.geometry.kit(truth.part_id)
    target, out = motion @ truth.world_from_part, truth.world_from_kit.rotate(UP)
    poses = engine.insert(number, inertia(part.mesh, part.mass), target, out)
    kit_from_world, back = truth.world_from_kit.inverse(), truth.world_from_part.inverse()
    outcome = classify_outcome(kit, *(kit_from_world @ pose for pose in poses)).outcome
    return poses[0] @ back, poses[1] @ back, outcome == "left"


def main(options: Options) -> None:
    """Measure, print and write."""
    with measured_dataset(options.data) as (dataset, scratch):
        measurement, shapes = Measurement.begin(dataset), Shapes(dataset)
        chosen = list(chosen_scenes(dataset, options.pairs))
        engines = {}
        for recorded, _ in tqdm(chosen, desc="export", unit="", disable=None):
            (scratch / recorded.id).mkdir()
            write_scene(recorded, shapes, scratch / recorded.id)
            engines[recorded.id] = Engine.load(scratch / recorded.id / SCENE)
        measure_insertions(measurement, dataset, chosen, engines, options.wrong)
        measurement.report(options.out)


def measure_insertions(
    measurement: Measurement,
    dataset: Dataset,
    chosen: Sequence[tuple[RecordedScene, list[Truth]]],
    engines: dict[str, Engine],
    wrong: int,
) -> None:
    """Insert parts by true motions, and the first `wrong` of them by wrong ones."""
    trained = {row["family"] for row in dataset.geometry.parts.values() if row["split"] == "train"}
    pairs = [(recorded, truth) for recorded, truths in chosen for truth in truths]
    table = measurement.table(
        "insertions",
        f"Insertions in MuJoCo, {len(pairs)} parts of the test split",
        Column("motion", "motion"),
        Column("n", "n"),
        Column("released", "seated at release, %", 0, True),
        Column("seated", "seated at rest, %", 0, True),
        Column("left", "left the kit", 0),
    )
    for name, motion_of, count in (
        ("true", lambda truth: truth.goal_drawn, len(pairs)),
        (f"{OFFSET} clearances off", off, wrong),
    ):
        truths = [truth for _, truth in pairs[:count]]
        results = [
            inserted(engines[recorded.id], dataset, recorded, truth, motion_of(truth))
            for recorded, truth in tqdm(pairs[:count], desc=name, unit="", disable=None)
        ]
        *made, left = zip(*results, strict=True)
        released, seated = (seatings(Pose.stack(m), truths, dataset.geometry, exact="all").seated for m in made)
        held_out = np.array([truth.family not in trained for truth in truths])
        for label, rows in (("", np.ones(len(truths), bool)), (", held-out families", held_out)):
            if rows.any():
                rates = {"released": rate(released[rows]), "seated": rate(seated[rows])}
                table.add(motion=name + label, n=int(rows.sum()), **rates, left=int(np.array(left)[rows].sum()))


if __name__ == "__main__":
    run(main, Options, __doc__)
