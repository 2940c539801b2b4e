"""Do exported scenes work in an engine of others? MuJoCo inserts parts, lets scenes settle and counts its steps.

    make mujoco DATA=data/kit1000

Each part starts out along the insertion axis of a motion, is lowered by a compliant hand along a straight line and is
released, as in `kit1000.sim.insertion`; the exact seating test judges where it comes to rest. Scenes are exported as by
`kit1000 export --format mjcf`. Steps a second are those of one thread, by processor time.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from bench.measured import measured_dataset, run
from benchmark.measurements import Column, Measurement, estimate, rate
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.export.mjcf import SCENE, Fit, Shape, Shapes, assembly_pieces, write_scene
from kit1000.kits.convex_pieces import convex_prisms
from kit1000.kits.seating import HOVER
from kit1000.mesh import inertia
from kit1000.metrics import seatings
from kit1000.pose import Pose, quaternion_angle, quaternion_conjugate, quaternion_multiply
from kit1000.rng import stream
from kit1000.sim.insertion import HAND_SPEED, MAX_FORCE, MAX_TORQUE, clamp_norm, classify_outcome
from kit1000.values import Truth

mujoco: Any = importlib.import_module("mujoco")  # from an environment of its own
FREQUENCY, MAX_LAG = 500.0, 1e-3  # [rad/s] of part and hand, stiffer than in `kit1000.sim.insertion`; [m] when blocked
CATCH_UP, REST = 0.1, 1.5  # [s] that the hand waits at the end of its path, and that a part may take to come to rest
OFFSET = 1.5  # clearances by which a wrong motion is off, in a random direction along the plate
SETTLING = 1.0  # [s]
MOVED = (1e-3, np.radians(1.0))  # [m] and [rad]: a part that moves less is settled
SPEED_STEPS = 1000
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
    settled: int = 20
    """Number of scenes that settle."""
    timed: int = 5
    """Number of scenes whose steps are counted."""
    out: Path | None = None
    """JSON file to write."""


@dataclass(frozen=True, eq=False)
class Engine:
    """A scene in MuJoCo."""

    model: Any
    data: Any

    @staticmethod
    def load(path: Path, hulls: bool = False) -> Engine:
        """A scene file. hulls: bodies touch by their visual meshes, of which MuJoCo takes the hulls."""
        spec = mujoco.MjSpec.from_file(str(path))
        if hulls:
            for geom in list(spec.geoms):
                if geom.classname.name == "collision":
                    spec.delete(geom)
                elif geom.classname.name == "visual":
                    geom.contype = geom.conaffinity = 1
        model = spec.compile()
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


class PrismShapes(Shapes):
    """Parts as exported, kits of the prisms of the URDF."""

    def _fit(self, part_id: str) -> Fit:
        kit, fit = self.geometry.kit(part_id), super()._fit(part_id)
        return Fit(fit.part, Shape.of(kit.mesh, convex_prisms(kit)), fit.clearance)


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


def settled_move(engine: Engine) -> list[tuple[float, float]]:
    """How far each part of a scene moves [m] and rotates [rad] within SETTLING."""
    mujoco.mj_resetData(engine.model, engine.data)
    parts = range(engine.model.nq // 7)
    before = [engine.pose(part) for part in parts]
    engine.step(SETTLING)
    after = [engine.pose(part) for part in parts]
    return [
        (float(np.linalg.norm(a.xyz - b.xyz)), float(quaternion_angle(a.wxyz, b.wxyz)))
        for a, b in zip(before, after, strict=True)
    ]


def steps_a_second(engine: Engine, goals: Sequence[tuple[int, Pose]] = ()) -> float:
    """Steps a second of processor time. goals: parts that stand in their kits instead of on the table."""
    mujoco.mj_resetData(engine.model, engine.data)
    for part, pose in goals:
        engine.place(part, pose)
    mujoco.mj_step(engine.model, engine.data, nstep=100)
    start = time.process_time()
    mujoco.mj_step(engine.model, engine.data, nstep=SPEED_STEPS)
    return SPEED_STEPS / (time.process_time() - start)


def main(options: Options) -> None:
    """Measure, print and write."""
    with measured_dataset(options.data) as (dataset, scratch):
        measurement, shapes, prisms = Measurement.begin(dataset), Shapes(dataset), PrismShapes(dataset)
        chosen = list(chosen_scenes(dataset, options.pairs))
        engines = {}
        for recorded, _ in tqdm(chosen, desc="export", unit="", disable=None):
            (scratch / recorded.id).mkdir()
            write_scene(recorded, shapes, scratch / recorded.id)
            engines[recorded.id] = Engine.load(scratch / recorded.id / SCENE)
        measure_insertions(measurement, dataset, chosen, engines, options.wrong)
        measure_settling(measurement, [engines[recorded.id] for recorded, _ in chosen[: options.settled]])
        measure_shapes(measurement, dataset, shapes, [recorded for recorded, _ in chosen])
        timed = [recorded for recorded, _ in chosen[: options.timed]]
        for recorded in timed:
            (scratch / f"{recorded.id}-prisms").mkdir()
            write_scene(recorded, prisms, scratch / f"{recorded.id}-prisms")
        measure_speed(measurement, scratch, timed)
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


def measure_settling(measurement: Measurement, engines: Sequence[Engine]) -> None:
    """Let scenes settle."""
    moves = np.array([move for engine in engines for move in settled_move(engine)])
    table = measurement.table(
        "settling",
        f"Parts of {len(engines)} scenes after {SETTLING:g} s in MuJoCo",
        Column("n", "parts"),
        Column("settled", "moved less than 1 mm and 1 degree, %", 0, True),
        Column("median", "median, mm", 3),
        Column("largest", "largest, mm", 3),
    )
    settled = (moves < MOVED).all(1)
    table.add(n=len(moves), settled=rate(settled), median=1e3 * np.median(moves[:, 0]), largest=1e3 * moves[:, 0].max())


def measure_shapes(measurement: Measurement, dataset: Dataset, shapes: Shapes, scenes: Sequence[RecordedScene]) -> None:
    """What the pieces miss and add."""
    assemblies = [dataset.geometry.assembly(recorded.scene.bodies[0].id) for recorded in scenes]
    fits = {mount.kit.id: shapes.fit(mount.kit.id) for assembly in assemblies for mount in assembly.mounts}
    table = measurement.table(
        "shapes",
        f"Convex pieces of {len(fits)} kits and parts of {len(assemblies)} assemblies",
        Column("shape", "shape"),
        Column("n", "n"),
        Column("pieces", "pieces", 0),
        Column("most", "most", 0),
        Column("within", "at most 200, %", 0, True),
        Column("missing", "missing, %", 2),
        Column("extra", "extra, %", 2),
        Column("clearance", "smallest clearance left, mm", 2),
    )
    for name, each in (("kit", [fit.kit for fit in fits.values()]), ("part", [fit.part for fit in fits.values()])):
        counts = [len(shape.pieces) for shape in each]
        table.add(
            shape=name,
            n=len(each),
            pieces=estimate(counts),
            most=max(counts),
            missing=np.mean([100 * shape.missing / shape.mesh.volume for shape in each]),
            extra=np.mean([100 * shape.extra / shape.mesh.volume for shape in each]),
            clearance=1e3 * min(fit.clearance for fit in fits.values()),
        )
    walls = {name: fit.kit.pieces for name, fit in fits.items()}
    prisms = {name: convex_prisms(dataset.geometry.kit(name)) for name in fits}
    for name, pieces in (("assembly", walls), ("assembly of prisms", prisms)):
        counts = np.array([len(assembly_pieces(assembly, pieces)) for assembly in assemblies])
        table.add(shape=name, n=len(counts), pieces=estimate(counts), most=counts.max(), within=np.mean(counts <= 200))


def measure_speed(measurement: Measurement, scratch: Path, scenes: Sequence[RecordedScene]) -> None:
    """Count steps a second of scenes with joined pieces, prisms and hulls."""
    table = measurement.table(
        "speed",
        f"Steps a second of {len(scenes)} scenes in MuJoCo, one thread",
        Column("collision", "collision geometry"),
        Column("n", "scenes"),
        Column("pieces", "pieces of a scene", 0),
        Column("table", "parts on the table", 0),
        Column("seated", "parts in their kits", 0),
    )
    for name, ending, hulls in (("pieces", "", False), ("prisms", "-prisms", False), ("whole meshes", "", True)):
        counts, tables, kits = [], [], []
        for recorded in scenes:
            engine = Engine.load(scratch / f"{recorded.id}{ending}" / SCENE, hulls)
            counts.append(int((engine.model.geom_contype > 0).sum()) - 1)
            tables.append(steps_a_second(engine))
            parts = [body.id for body in recorded.scene.bodies[1:]]
            goals = [
                (parts.index(truth.part_id), truth.goal_drawn @ truth.world_from_part)
                for truth in recorded.truths.values()
            ]
            kits.append(np.nan if hulls else steps_a_second(engine, goals))
        speeds = {"table": np.mean(tables), "seated": float(np.mean(kits))}
        table.add(collision=name, n=len(scenes), pieces=np.mean(counts), **speeds)


if __name__ == "__main__":
    run(main, Options, __doc__)
