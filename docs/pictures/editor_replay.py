"""The edit of `editor.py` as one offline page in 3D, by viser's own export.

python docs/pictures/editor_replay.py data/kit1000
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
import viser
from editor import recorded
from numpy.typing import ArrayLike

from kit1000.editor.page import Panel, ViserStage
from kit1000.editor.pointing import Eye
from kit1000.editor.serve import serving

OUT = Path(__file__).with_name("editor-replay.html")
NOTICE = f"<!-- Holds the client of viser {viser.__version__}, https://viser.studio, Apache License 2.0. -->"
OVER_SCENE = np.array([0.0, 0.0, 0.22])  # [m] of the caption


class Replay(ViserStage):
    """A page that is recorded instead of looked at."""

    def __init__(self, server: viser.ViserServer, eye: Eye) -> None:
        super().__init__(server, Panel.of_editor("scene", snaps=True))
        self.eye = eye
        self.recording = server.get_scene_serializer()

    def look_from(self, eye: ArrayLike, target: ArrayLike) -> None:
        """Put the camera where the film has it."""
        super().look_from(self.eye.world_from_camera.xyz, target)
        self._middle = np.asarray(target, float)

    def take(self, caption: str, milliseconds: int, pointer: tuple[float, float] | None = None) -> None:
        """Show a caption, and wait."""
        self.label("/caption", caption, self._middle + OVER_SCENE)
        self.flush()
        self.recording.insert_sleep(milliseconds / 1000)


def main(data: Path) -> None:
    """Edit the scene, and write the page."""
    with serving(None) as (server, _):
        page = recorded(data, partial(Replay, server)).recording.as_html()
    OUT.write_text(page.replace("<head>", f"<head>{NOTICE}", 1), encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
