"""python examples/mujoco_scene.py tiny

Exports a scene as MJCF, lets it settle in MuJoCo and renders it by its camera. Needs `pip install mujoco`.
"""

from __future__ import annotations

from pathlib import Path

import mujoco  # pyright: ignore[reportMissingImports] (in an environment of its own)
import numpy as np
import tyro
from PIL import Image

from kit1000 import Dataset
from kit1000.export import export


def main(
    data: tyro.conf.Positional[Path] = Path("tiny"), out: Path = Path("mjcf"), picture: Path | None = None
) -> None:
    """Export and simulate.

    Args:
        data: the dataset folder.
        out: folder for the scene.
        picture: PNG file to render; needs OpenGL, without a screen MUJOCO_GL=egl.
    """
    scene_id = Dataset(data).split("test").scene_ids[0]
    export(data, "mjcf", out, [scene_id])
    model = mujoco.MjModel.from_xml_path(str(out / scene_id / "scene.xml"))
    state = mujoco.MjData(model)
    start = state.qpos.copy()
    mujoco.mj_step(model, state, nstep=500)
    moved = np.abs(state.qpos - start).reshape(-1, 7)[:, :3].max()
    print(f"{scene_id}: {model.ngeom} geoms, parts moved by {1e3 * moved:.3f} mm in {state.time:.1f} s")
    if picture is not None:
        with mujoco.Renderer(model, 720, 1280) as renderer:
            renderer.update_scene(state, "camera")
            Image.fromarray(renderer.render()).save(picture)


if __name__ == "__main__":
    tyro.cli(main)
