"""The picture of the robot at work: one part from the table to its slot, drawn from a trace (`make pictures`)."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from kit1000.camera import Camera, look_at
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.generation.build import generate
from kit1000.generation.presets import PRESETS
from kit1000.mesh import Mesh, convex_hull, mesh_from_solid
from kit1000.pictures.shading import INK, KIT, PART, SLATE, ColouredBody, contact_sheet, shaded_picture
from kit1000.planner.execute import SceneRun, run_scene
from kit1000.planner.robot import CUPS, capsule_ends, shape
from kit1000.planner.trace import read_trace, state_at, trace_bytes

FOLDER = Path(__file__).parent
SCENE = "test-s0001"
SIZE = (620, 560)  # [px]
EYE, TARGET, FOCAL = (0.95, -0.75, 0.75), (-0.15, 0.0, 0.17), 860
BALL_POINTS = 160
FRAMES = (
    ("lower", "pick"),
    ("lift", "lift"),
    ("carry", "hover, 100 mm out"),
    ("insert", "straight in"),
    ("leave", "let go"),
)
"""Legs at whose ends the pictures are taken, and their captions."""


def main(folder: Path | None = None) -> None:
    """Draw the picture from the scene of a dataset, of a new one of the preset `tiny` without a folder."""
    if folder is None:
        with TemporaryDirectory() as temporary:
            generate(PRESETS["tiny"], Path(temporary))
            main(Path(temporary))
        return
    scene = Dataset(folder).recorded_scene(SCENE, truth=True)
    motions = {q.part: scene.truth_of(q.id).goal_drawn for q in scene.queries if q.track == "place"}
    run = run_scene(scene, motions)
    sheet = contact_sheet([draw(scene, run, end) for end in frame_ends(run)], [text for _, text in FRAMES], columns=5)
    sheet.save(FOLDER / "robot.png", optimize=True)


def frame_ends(run: SceneRun) -> list[float]:
    """[s] at which the legs of FRAMES end, for the part that was inserted last."""
    legs = {event.leg.name: event for event in run.events if event.leg is not None and event.part == run.order[-1]}
    return [legs[name].start + legs[name].leg.duration for name, _ in FRAMES]  # pyright: ignore[reportOptionalMemberAccess]


def draw(scene: RecordedScene, run: SceneRun, seconds: float) -> np.ndarray:
    """(H, W, 3) uint8: the cell at a time."""
    geometry = scene.split.dataset.geometry
    assembly, *parts = scene.scene.bodies
    joints, poses = state_at(read_trace(trace_bytes(run)), [body.world_from_body for body in parts], seconds)
    bodies = [ColouredBody(geometry.assembly(assembly.id).mesh, assembly.world_from_body, KIT)]
    bodies += [ColouredBody(geometry.part(body.id).mesh, pose, PART) for body, pose in zip(parts, poses, strict=True)]
    for capsule, ends in zip(shape(CUPS[0]), capsule_ends(joints, CUPS[0]), strict=True):
        colour = INK if capsule.link == 6 else SLATE
        bodies.append(ColouredBody(capsule_mesh(ends, capsule.radius), run.world_from_base, colour))
    column = np.array([[0, 0, -run.world_from_base.xyz[2] + 0.07], [0, 0, 0]])
    bodies.append(ColouredBody(capsule_mesh(column, 0.07), run.world_from_base, INK))
    camera = Camera(*SIZE, fx=FOCAL, fy=FOCAL, cx=(SIZE[0] - 1) / 2, cy=(SIZE[1] - 1) / 2)
    return shaded_picture(bodies, camera, look_at(EYE, TARGET))


def capsule_mesh(ends: np.ndarray, radius: float) -> Mesh:
    """The surface of a capsule between ends (2, 3) [m]."""
    height = (2 * np.arange(BALL_POINTS) + 1) / BALL_POINTS - 1
    angle = np.arange(BALL_POINTS) * np.pi * (3 - 5**0.5)
    level = np.sqrt(1 - height**2)
    ball = radius * np.column_stack([level * np.cos(angle), level * np.sin(angle), height])
    return mesh_from_solid(convex_hull(np.concatenate([ends[0] + ball, ends[1] + ball])))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
