"""The page on which a person corrects labels: shapes over measured points, whose colours are the residual.

A click selects a body, which then has a gizmo; a drag slides it over the table, or turns it with ctrl. The page is that
of the editor (`page`); `kit1000.labelling.corrections` does everything else.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kit1000.editor.display import NARROW, body_node, framed
from kit1000.editor.dragging import TURN_PER_HEIGHT, Modifier, rotated
from kit1000.editor.page import Panel, ViserStage
from kit1000.editor.pointing import Eye
from kit1000.editor.serve import serving
from kit1000.editor.texts import plain
from kit1000.interrupts import wait_until_interrupted
from kit1000.labelling.corrections import Correction
from kit1000.labelling.label_records import read_record
from kit1000.labelling.labelling_session import OwnScenes, publish, report_lines
from kit1000.pictures.shading import KIT, part_colour
from kit1000.pose import Pose
from kit1000.values import FIRST_PART_LABEL

OPACITY = 0.6  # of the shapes
POINTS = "/points"
UP = np.array([0.0, 0.0, 1.0])
AROUND = 0.04  # [m] of table about the bodies
HELP = (
    "Click a shape, then drag it over the table; ctrl-drag turns it, the gizmo does both in space. **fit** lets it "
    "fall into place. Points: red is nearer than the shape, blue farther, yellow: no mask, purple: no shape."
)
BUTTONS = {
    "Shape": {"fit": "fit", "take back": "take-back"},
    "Confirm": {"the selected": "confirm", "all": "confirm-all"},
}


class _Drag(NamedTuple):
    """A drag in progress."""

    name: str
    before: Pose
    eye: Eye
    start: tuple[float, float]  # on the screen
    turns: bool
    after: Pose


class LabelPage:
    """Takes the events of the page of one scene; its bodies are the labels of the masks."""

    drags = True

    def __init__(self, stage: ViserStage, correction: Correction) -> None:
        """Show a scene."""
        self.stage, self.correction = stage, correction
        self.selected: str | None = None
        self._drag: _Drag | None = None
        self._names = {correction.body(name).label: name for name in correction.names}
        for label, name in self._names.items():
            colour = KIT if label < FIRST_PART_LABEL else part_colour(label - FIRST_PART_LABEL)
            stage.show(body_node(label), correction.mesh(name), colour, OPACITY)
        self._look(NARROW)
        self.update()
        stage.listen(self)

    @property
    def bodies(self) -> tuple[int, ...]:
        """The labels of the bodies."""
        return tuple(self._names)

    def update(self) -> None:
        """Show everything as it is."""
        for label, name in self._names.items():
            self.stage.move(body_node(label), self.correction.world_from_body(name))
        self.stage.dots(POINTS, *self.correction.points())
        if self.selected is None:
            self.stage.gizmo(None)
        else:
            pose = self.correction.world_from_body(self.selected)
            self.stage.gizmo(Pose(pose.wxyz, pose.apply(self._middle(self.selected))))
        chosen = f"**{plain(self.selected)}** is selected" if self.selected else "nothing is selected"
        self.stage.say("fit", "\n\n".join([chosen, *map(plain, report_lines(self.correction.record))]))
        self.stage.flush()

    def framed(self, eye: Eye) -> None:
        """The shape of the window is known, or has changed: show the whole scene, unless something is selected."""
        if self.selected is None:
            self._look(eye.aspect)
            self.stage.flush()

    def select(self, body: int | None) -> None:
        """Select a body."""
        self.selected = None if body is None else self._names[body]
        self.update()

    def grab(
        self, body: int, eye: Eye, screen: tuple[float, float], point: np.ndarray, modifier: Modifier = None
    ) -> None:
        """A drag begins; with ctrl it turns the body about the vertical."""
        del point
        self.selected = name = self._names[body]
        before = self.correction.world_from_body(name)
        self._drag = _Drag(name, before, eye, screen, modifier == "cmd/ctrl", before)

    def drag(self, screen: tuple[float, float]) -> None:
        """Slide the body so that the point of its middle plane that was grabbed stays under the pointer, or turn it."""
        if self._drag is None:
            return
        name, before, eye, start, turns, _ = self._drag
        middle = self._middle(name)
        if turns:
            after = rotated(before, middle, UP, (screen[0] - start[0]) * TURN_PER_HEIGHT)
        else:
            height = float(before.apply(middle)[2])
            grabbed, point = (_at_height(eye, place, height) for place in (start, screen))
            after = Pose.from_translation(point - grabbed) @ before
        self._drag = self._drag._replace(after=after)
        self.stage.move(body_node(self.correction.body(name).label), after)

    def release(self) -> None:
        """The drag ends."""
        drag, self._drag = self._drag, None
        if drag is not None:
            self.correction.move(drag.name, drag.after)
            self.update()

    def carry(self, gizmo: Pose, done: bool) -> None:
        """Move the selected body with the gizmo."""
        if self.selected is None:
            return
        pose = gizmo @ Pose.from_translation(-self._middle(self.selected))
        if done:
            self.correction.move(self.selected, pose)
            self.update()
        else:
            self.stage.move(body_node(self.correction.body(self.selected).label), pose)

    def command(self, verb: str, eye: Eye | None = None) -> None:
        """A button."""
        del eye
        if verb == "fit" and self.selected is not None:
            self.correction.fit(self.selected)
        elif verb == "take-back":
            self.correction.take_back()
        elif verb == "confirm-all":
            self._confirm(["all"])
        elif verb == "confirm":
            self._confirm([self.selected] if self.selected else [])
        self.update()

    def _confirm(self, names: list[str]) -> None:
        """Confirm bodies, save, and write the truth when all are confirmed."""
        self.correction.confirm(names, self.stage.entered)
        self.correction.save()
        if self.correction.record.confirmed:
            scenes, record = self.correction.scenes, self.correction.record
            without = publish(scenes, [record])
            self.correction = Correction(scenes, read_record(scenes.root, record.scene_id), self.correction.kits)
            self.stage.say("note", plain(f"truth is written; without truth: {', '.join(without) or 'none'}"))

    def _middle(self, name: str) -> np.ndarray:
        """(3,) [m] of a body in its own frame."""
        return self.correction.mesh(name).bounds.mean(0)

    def _look(self, aspect: float) -> None:
        points = shown_points(self.correction)
        away = self.correction.world_from_camera.xyz - points.mean(0)
        self.stage.look_from(*framed(points, away, aspect))


def shown_points(correction: Correction) -> np.ndarray:
    """(n, 3) [m] world: the vertices of all bodies."""
    return np.concatenate([correction.world_from_body(i).apply(correction.mesh(i).vertices) for i in correction.names])


def _at_height(eye: Eye, screen: tuple[float, float], height: float) -> np.ndarray:
    """(3,) [m] where the ray to a place on the screen meets the level plane at a height; a far point if it does not."""
    start, direction = eye.world_from_camera.xyz, eye.ray(screen)
    fall = min(float(direction[2]), -1e-2)
    return start + direction * ((height - float(start[2])) / fall)


@contextlib.contextmanager
def labelling(root: Path, scene_id: str | None, port: int | None) -> Iterator[tuple[LabelPage, str]]:
    """A page while the block runs, and its address; scene_id: None for the first scene of the folder."""
    scenes = OwnScenes.of(root, scene_id)
    correction = Correction(scenes, read_record(root, scenes.scene_ids[0]))
    points = shown_points(correction)[:, :2]
    (left, near), (right, far) = points.min(0) - AROUND, points.max(0) + AROUND
    table = np.array([(left, near), (right, near), (right, far), (left, far)])
    with serving(port, "kit1000 label") as (server, address):
        yield LabelPage(ViserStage(server, Panel(HELP, BUTTONS, field="your name"), table), correction), address


def run_label_page(root: Path, scene_id: str | None, port: int | None) -> None:
    """Serve the page of a scene until Ctrl-C."""
    with labelling(root, scene_id, port) as (page, address), contextlib.suppress(KeyboardInterrupt):
        print(f"{address}  {page.correction.record.scene_id} (Ctrl-C ends; confirmed labels are saved)", flush=True)
        wait_until_interrupted()
