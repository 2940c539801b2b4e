"""Where the robot and the seating test disagree: one insertion of each kind, cut open (needs `kit1000` 1.0.0).

python docs/pictures/disagreements.py data/kit1000
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.kits.seating import UP
from kit1000.mesh import Mesh, mesh_from_solid, solid_from_mesh
from kit1000.pictures.shading import KIT, PART, ColouredBody, contact_sheet, framing_camera, shaded_picture
from kit1000.planner.execute import Bench
from kit1000.pose import Pose, unit_vector

FOLDER = Path(__file__).parent
SIZE = (440, 340)  # [px]
RISE = 0.45  # of the line of sight above the plate


class Case(NamedTuple):
    """An insertion in the test split."""

    scene: str
    part: int
    guess: bool
    """Whether the guess of track snap is carried out, or the true motion."""
    names: tuple[str, str, str]
    """Of the pictures: as predicted, let go, at rest."""


CASES = (
    Case("test-s0070", 1, False, ("true motion: the test says seated", "stuck, let go", "beside the plate")),
    Case("test-s0126", 0, True, ("guess: the test says no", "let go above the slot", "it falls in: seated")),
    Case("test-s0197", 1, True, ("guess: the test says no", "stuck on the rim, let go", "it slides in: seated")),
)


def main(folder: Path) -> None:
    """Draw a row for each kind."""
    dataset = Dataset(folder)
    pictures = [picture for case in CASES for picture in draw(dataset, case)]
    sheet = contact_sheet(pictures, [name for case in CASES for name in case.names], columns=3)
    sheet.save(FOLDER / "disagreements.webp", quality=85, method=6)


def draw(dataset: Dataset, case: Case) -> list[np.ndarray]:
    """(H, W, 3) uint8 each: the part as predicted, when it is let go, and at rest, the plate cut open before it."""
    scene = dataset.recorded_scene(case.scene, truth=True)
    bench = Bench(scene, "ideal")
    query = next(query for query in scene.queries if query.track == "snap" and query.part == case.part)
    truth = scene.truth_of(query.id)
    motion = query.guess if case.guess and query.guess is not None else truth.goal_drawn
    trial, _ = bench.insert(case.part, motion)
    predicted = motion @ bench.poses[case.part]
    poses = (predicted, trial.release_pose, trial.rest_pose)
    goal = truth.goal_drawn @ bench.poses[case.part]
    away = _view(truth.world_from_kit.rotate(UP), trial.release_pose.xyz - goal.xyz)
    plates = _cut(bench.assembly.mesh.moved(bench.world_from_assembly), away, goal.xyz)
    part = bench.parts[case.part].mesh
    shown = [ColouredBody(part, pose, PART) for pose in (*poses, goal)]
    camera = framing_camera(shown, RISE * truth.world_from_kit.rotate(UP) - away, SIZE, margin=0.12)
    return [
        shaded_picture([ColouredBody(plates, Pose.identity(), KIT), body], *camera, ground=False) for body in shown[:3]
    ]


def _view(out: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(3,) unit: the line of sight along a plate with the normal `out` (3,) that shows an offset (3,) from the side."""
    return unit_vector(np.cross(offset, out))


def _cut(mesh: Mesh, away: np.ndarray, point: np.ndarray) -> Mesh:
    """What of a mesh lies behind a plane through a point, (3,) each."""
    return mesh_from_solid(solid_from_mesh(mesh).trim_by_plane(tuple(away), float(np.dot(away, point))))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
