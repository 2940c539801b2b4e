"""The page on which a person corrects labels: shapes over measured points, whose colours are the residual.

A click selects a body, which then has a gizmo; a drag slides it over the table, with ctrl it turns. `fit` lets it fall
into place from there. Everything else is `kit1000.labelling.corrections`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import viser

from kit1000.editor.display import FIELD, NARROW, framed
from kit1000.editor.page import eye_of
from kit1000.editor.serve import serving
from kit1000.editor.texts import TABLE_COLOUR, plain
from kit1000.errors import Kit1000Error
from kit1000.interrupts import wait_until_interrupted
from kit1000.labelling.corrections import Correction
from kit1000.labelling.label_records import read_record
from kit1000.labelling.labelling_session import OwnScenes, publish, report_lines
from kit1000.pictures.shading import KIT, part_colour
from kit1000.pose import Pose
from kit1000.values import FIRST_PART_LABEL

OPACITY, POINT = 0.6, 1.0e-3  # of the shapes; [m] of a point
POINTS, GIZMO = "/points", "/gizmo"
UP = np.array([0.0, 0.0, 1.0])
TURN = 2 * np.pi  # [rad] for a drag across the height of the window
AROUND = 0.04  # [m] of table about the bodies
HELP = (
    "Click a shape, then drag it over the table; ctrl-drag turns it, the gizmo does both in space. **fit** lets it "
    "fall into place. Points: red is nearer than the shape, blue farther, yellow: no mask, purple: no shape."
)


class LabelPage:
    """The page of one scene."""

    def __init__(self, server: viser.ViserServer, correction: Correction) -> None:
        """Show a scene on a server."""
        self.server, self.correction = server, correction
        self.selected: str | None = None
        self._meshes: dict[str, Any] = {}
        self._drag: tuple[Pose, np.ndarray, tuple[float, float]] | None = None
        self._holding = False
        self._dress()
        self.update()

    @property
    def person(self) -> str:
        """The name of who confirms, as the page has it."""
        return self._person.value

    @person.setter
    def person(self, name: str) -> None:
        self._person.value = name

    def update(self) -> None:
        """Show everything as it is."""
        for name, handle in self._meshes.items():
            pose = self.correction.world_from_body(name)
            handle.wxyz, handle.position = pose.wxyz, pose.xyz
        points, colours = self.correction.points()
        self.server.scene.add_point_cloud(
            POINTS, points.astype(np.float32), colours, point_size=POINT, precision="float32"
        )
        self._gizmo.visible = self.selected is not None
        if self.selected is not None and not self._holding:
            pose = self.correction.world_from_body(self.selected)
            middle = pose.apply(self.correction.mesh(self.selected).bounds.mean(0))
            self._gizmo.wxyz, self._gizmo.position = pose.wxyz, middle
        lines = report_lines(self.correction.record)
        chosen = f"**{plain(self.selected)}** is selected" if self.selected else "nothing is selected"
        self._report.content = "\n\n".join([chosen, *map(plain, lines)])
        self.server.flush()

    def select(self, name: str) -> None:
        """Select a body."""
        self.selected = name
        self.update()

    def drag(
        self, name: str, ray: tuple[np.ndarray, np.ndarray], screen: tuple[float, float], phase: str, turns: bool
    ) -> None:
        """Slide a body over the table so that the point that was grabbed stays under the pointer, or turn it.

        Args:
            name: the body.
            ray: (3,) [m] where the eye is, and (3,) the direction to the pointer.
            screen: of the pointer, 0 to 1 from the left and from the top.
            phase: start, update or end.
            turns: whether it turns about the vertical.
        """
        eye, direction = ray
        if phase == "start":
            self.selected = name
            pose = self.correction.world_from_body(name)
            height = float(pose.apply(self.correction.mesh(name).bounds.mean(0))[2])
            self._drag = pose, _at_height(eye, direction, height), screen
            return
        if self._drag is None:
            return
        pose, grabbed, start = self._drag
        if turns:
            middle = Pose.from_translation(pose.apply(self.correction.mesh(name).bounds.mean(0)))
            turn = Pose.from_rotvec((screen[0] - start[0]) * TURN * UP)
            moved = middle @ turn @ middle.inverse() @ pose
        else:
            moved = Pose.from_translation(_at_height(eye, direction, float(grabbed[2])) - grabbed) @ pose
        handle = self._meshes[name]
        handle.wxyz, handle.position = moved.wxyz, moved.xyz
        if phase == "end":
            self._drag = None
            self.correction.move(name, moved)
            self.update()

    def carry(self, handle: Pose, done: bool) -> None:
        """Move the selected body with the gizmo."""
        if self.selected is None:
            return
        middle = self.correction.mesh(self.selected).bounds.mean(0)
        pose = handle @ Pose.from_translation(-middle)
        node = self._meshes[self.selected]
        node.wxyz, node.position = pose.wxyz, pose.xyz
        self._holding = not done
        if done:
            self.correction.move(self.selected, pose)
            self.update()

    def fit(self) -> None:
        """Let the selected body fit from where it is."""
        if self.selected is not None:
            self.correction.fit(self.selected)
            self.update()

    def take_back(self) -> None:
        """Take back the last move."""
        self.correction.take_back()
        self.update()

    def confirm(self, everything: bool) -> None:
        """Confirm the selected body or all, save, and write the truth once all are confirmed."""
        names = ["all"] if everything else [self.selected] if self.selected else []
        self.correction.confirm(names, self.person)
        self.correction.save()
        self.update()
        if self.correction.record.confirmed:
            scenes, record = self.correction.scenes, self.correction.record
            without = publish(scenes, [record])
            self.correction = Correction(scenes, read_record(scenes.root, record.scene_id), self.correction.kits)
            self._say(f"truth is written; without truth: {', '.join(without) or 'none'}")

    def _say(self, text: str) -> None:
        self._note.content = plain(text)

    def _dress(self) -> None:
        server, gui, correction = self.server, self.server.gui, self.correction
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="small")
        gui.main_panel.dock_right()
        server.scene.set_up_direction("+z")
        clouds = [correction.world_from_body(name).apply(correction.mesh(name).vertices) for name in correction.names]
        points = np.concatenate(clouds)
        eye, middle = framed(points, correction.world_from_camera.xyz - points.mean(0), NARROW)
        camera = server.initial_camera
        camera.position, camera.look_at, camera.up = eye, middle, UP
        camera.fov, camera.near = FIELD, 0.02
        (left, near, _), (right, far, _) = points.min(0) - AROUND, points.max(0) + AROUND
        place = ((left + right) / 2, (near + far) / 2, -1e-3)
        server.scene.add_box("/table", TABLE_COLOUR, (right - left, far - near, 1e-3), position=place)
        for name in correction.names:
            mesh, label = correction.mesh(name), correction.body(name).label
            colour = KIT if label < FIRST_PART_LABEL else part_colour(label - FIRST_PART_LABEL)
            vertices, faces = mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)
            handle = server.scene.add_mesh_simple(
                f"/body/{label}", vertices, faces, color=colour, opacity=OPACITY, flat_shading=True, side="double"
            )
            self._meshes[name] = handle
            handle.on_click(partial(self._clicked, name))
            for modifier in (None, "cmd/ctrl"):
                handle.on_drag("left", modifier=modifier)(partial(self._dragged, name, modifier is not None))  # type: ignore[arg-type]
        self._gizmo = server.scene.add_transform_controls(GIZMO, scale=0.08, visible=False, depth_test=False)
        self._gizmo.on_update(self._gizmo_moved)
        gui.add_markdown(HELP)
        self._report = gui.add_markdown("")
        for label, action in (("fit", self.fit), ("take back", self.take_back)):
            gui.add_button(label).on_click(partial(self._pressed, action))
        self._person = gui.add_text("your name", "")
        for label, everything in (("confirm the selected", False), ("confirm all", True)):
            gui.add_button(label).on_click(partial(self._pressed, partial(self.confirm, everything)))
        self._note = gui.add_markdown("")

    # Events: viser runs these coroutines in order. What goes wrong is said on the page.

    async def _clicked(self, name: str, event: Any) -> None:
        self._call(partial(self.select, name))

    async def _dragged(self, name: str, turns: bool, event: Any) -> None:
        eye = eye_of(event.client)
        screen = tuple(float(value) for value in event.end_screen_pos)
        first = tuple(float(value) for value in event.start_screen_pos)
        at = first if event.phase == "start" else screen
        ray = eye.world_from_camera.xyz, eye.ray(at)  # type: ignore[arg-type]
        self._call(partial(self.drag, name, ray, at, event.phase, turns))  # type: ignore[arg-type]

    async def _gizmo_moved(self, event: Any) -> None:
        handle = Pose(np.array(event.target.wxyz), np.array(event.target.position))
        self._call(partial(self.carry, handle, event.phase == "end"))

    async def _pressed(self, action: Callable[[], None], event: Any) -> None:
        self._call(action)

    def _call(self, action: Callable[[], None]) -> None:
        try:
            action()
        except (Kit1000Error, OSError) as error:
            self._say(str(error))
            self.server.flush()


def _at_height(eye: np.ndarray, direction: np.ndarray, height: float) -> np.ndarray:
    """(3,) [m] where a ray meets the level plane at a height; for one that never does, a far point of it."""
    fall = min(float(direction[2]), -1e-2)
    return eye + direction * ((height - float(eye[2])) / fall)


@contextlib.contextmanager
def labelling(
    root: Path, scene_id: str | None, port: int | None, origins: tuple[str, ...]
) -> Iterator[tuple[LabelPage, str]]:
    """A page while the block runs, and its address; scene_id: None for the first scene of the folder."""
    scenes = OwnScenes.of(root, scene_id)
    record = read_record(root, scenes.scene_ids[0])
    correction = Correction(scenes, record)
    with serving(port, origins, "kit1000 label") as (server, address):
        yield LabelPage(server, correction), address


def run_label_page(root: Path, scene_id: str | None, port: int | None, origins: tuple[str, ...] = ()) -> None:
    """Serve the page of a scene until Ctrl-C."""
    with labelling(root, scene_id, port, origins) as (page, address), contextlib.suppress(KeyboardInterrupt):
        print(f"{address}  {page.correction.record.scene_id} (Ctrl-C ends; confirmed labels are saved)", flush=True)
        wait_until_interrupted()
