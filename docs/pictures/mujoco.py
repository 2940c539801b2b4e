"""Pictures rendered by MuJoCo: `MUJOCO_GL=egl .viewers/mujoco/bin/python docs/pictures/mujoco.py DATA`.

They are those of the guides to MuJoCo and gymnasium; `make mujoco` makes that environment.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image

from kit1000.camera import look_at
from kit1000.dataset.reader import Dataset
from kit1000.export.mjcf import FLIPPED, SCENE, write_mjcf
from kit1000.values import Query

mujoco: Any = importlib.import_module("mujoco")
FOLDER = Path(__file__).parent
SIZE = (560, 440)  # [px]
NOW, GUESS, GOAL = (0.91, 0.45, 0.16, 1), (0.24, 0.47, 0.78, 0.9), (0.16, 0.63, 0.31, 1)


def render(spec: Any, eye: np.ndarray, target: np.ndarray, groups: tuple[int, ...]) -> np.ndarray:
    """A scene from a place (3,) [m], with the geoms of some groups."""
    pose = look_at(eye, target) @ FLIPPED
    spec.worldbody.add_camera(name=f"eye{groups}", pos=pose.xyz, quat=pose.wxyz, fovy=30)
    spec.visual.quality.offsamples = 8
    model = spec.compile()
    data, option = mujoco.MjData(model), mujoco.MjvOption()
    option.geomgroup[:] = [group in (0, *groups) for group in range(6)]
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        renderer.update_scene(data, f"eye{groups}", option)
        return renderer.render()


def save(name: str, *pictures: np.ndarray) -> None:
    """Write pictures side by side."""
    Image.fromarray(np.hstack(pictures)).quantize(128).save(FOLDER / f"{name}.png", optimize=True)


def lifted(query: Query) -> float:
    """[m] height to which the guess moves the part."""
    assert query.guess is not None
    return float(query.guess.apply(query.pivot)[2])


def main(data: Path, scene_id: str = "test-s0017") -> None:
    """Export a scene and draw both pictures."""
    dataset = Dataset(data)
    recorded = dataset.split("test-all", truth=True).scene(scene_id)
    with TemporaryDirectory() as folder:
        path = str(write_mjcf(dataset, Path(folder), [scene_id]) / scene_id / SCENE)
        kits = recorded.scene.bodies[0].world_from_body.xyz + (0, 0, 0.03)
        spec, rng = mujoco.MjSpec.from_file(path), np.random.default_rng(3)
        for geom in spec.geoms:
            if geom.classname.name == "collision":
                geom.rgba = [*rng.uniform(0.25, 0.95, 3), 1]
        eye = kits + (0.32, -0.26, 0.42)
        save("mujoco", render(spec, eye, kits, (2,)), render(spec, eye, kits, (3,)))
        spec = mujoco.MjSpec.from_file(path)
        query = max((query for query in recorded.queries if query.track == "snap"), key=lifted)
        truth = recorded.truth_of(query.id)
        assert query.guess is not None
        spec.body(f"p{query.part}").first_geom().rgba = NOW
        for motion, colour in ((query.guess, GUESS), (truth.goal_drawn, GOAL)):
            pose = motion @ truth.world_from_part
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"p{query.part}", rgba=colour, pos=pose.xyz, quat=pose.wxyz
            )
        middle = (kits + truth.world_from_part.xyz) / 2
        save("gymnasium", render(spec, middle + (0.5, -0.25, 0.5), middle, (2,)))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
