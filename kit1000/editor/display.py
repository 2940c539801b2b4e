"""Shows a workspace on a page: parts or points, cups, ghost, labels, panel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kit1000.editor import texts
from kit1000.editor.hand import NAMES, PICK, PLACE, HandWorkspace, cup_mesh
from kit1000.editor.texts import Colour
from kit1000.editor.workspace import Workspace
from kit1000.mesh import Mesh
from kit1000.numerics.trigonometry import tangent
from kit1000.pictures.shading import framing_camera, part_colour
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL

if TYPE_CHECKING:
    from kit1000.editor.page import ViserStage

KITS, OTHERS = "/kits", "/others"
OVER_PART = np.array([0.0, 0.0, 0.035])  # [m] of its label, as seen from aside
BEYOND_PART = np.array([0.0, 0.035, 0.0])  # [m] of the same, as seen from above: it must not cover the part
UP_THE_CUP = np.array([0.0, 0.0, 0.07])  # [m] of its label, from the lip where it hangs
FIELD = float(np.radians(45))  # of view from the top of the window to its bottom, as in the paper
NARROW = 0.9  # width over height of a window that is not yet known: that of a small screen beside the panel
BORDER = 0.06  # of the window around the scene
STRAIGHT_DOWN = np.array([0.0, -0.02, 1.0])  # not quite: the view keeps its upward direction
SLOT_VIEW = 0.3  # [m] from a plate
CUP_COLOURS: dict[int, Colour] = {PICK: (70, 175, 60), PLACE: (240, 200, 30)}


class Display:
    """What the page shows of a workspace."""

    def __init__(self, stage: ViserStage, workspace: Workspace) -> None:
        self.stage, self.workspace = stage, workspace
        self._label_offset = OVER_PART
        scene = workspace.scene
        self._by_hand = by_hand = isinstance(workspace, HandWorkspace)
        if by_hand and not scene.truth:
            self._add_points()
        else:
            self._add_bodies()
            if len(scene.others.faces):
                stage.show(OTHERS, scene.others, texts.OTHER_COLOUR, None)
        if isinstance(workspace, HandWorkspace):
            for cup in NAMES:
                pose, mesh = workspace.rest(cup), cup_mesh()
                placed = Mesh(pose.apply(mesh.vertices), mesh.faces)
                stage.show(body_node(cup), placed, CUP_COLOURS[cup], None)
        self._add_ghosts()

    def know_shapes(self) -> None:
        """Show the known shapes of the scene instead of what is seen of its bodies."""
        self._add_bodies()
        self._add_ghosts()
        self.update()

    def moved(self, body: int) -> None:
        """A body in a drag: its pose, its label, its ghost and what there is to say of it, nothing else."""
        self.stage.move(body_node(body), self.workspace.current[body].goal_from_now)
        self._label(body)
        self._ghost()
        self.stage.say("fit", self._fit_text())

    def update(self) -> None:
        """Everything."""
        space = self.workspace
        for body, edit in space.current.items():
            self.stage.move(body_node(body), edit.goal_from_now)
            self._label(body)
        self._ghost()
        sought = space.sought()
        self.stage.progress(1 - len(sought) / max(len(space.scene.parts), 1))
        self.stage.say("note", "")
        in_hand, known = self._part_in_hand(), space.scene.known
        self.stage.say("parts", texts.parts_list(space.part_edits, in_hand, sought, known, space.not_found))
        self.stage.say("fit", self._fit_text())
        self._gizmo()

    def note(self, text: str) -> None:
        """A line that stays until the next event."""
        self.stage.say("note", text)

    def look(self, name: str, aspect: float = NARROW) -> None:
        """Put the camera: camera, top, or slot for the plate under the selected body. aspect: of the window."""
        space = self.workspace
        self._label_offset = OVER_PART if name == "camera" else BEYOND_PART
        if name in ("camera", "top"):
            middle = space.scene.bounds.mean(0)
            towards = space.scene.view.world_from_camera.xyz - middle if name == "camera" else STRAIGHT_DOWN
            self.stage.look_from(*framed(space.scene.bounds, towards, aspect))
        elif space.selected is not None:
            image = space.current[space.selected].goal_from_now.apply(space.pivot(space.selected))
            away = SLOT_VIEW * space.plate_of(space.selected).normal
            self.stage.look_from(image + away + (0, -0.01, 0), image)
        for body in space.current:
            self._label(body)

    def _add_bodies(self) -> None:
        """Kits and parts as meshes."""
        scene = self.workspace.scene
        self.stage.show(KITS, scene.kits, texts.KIT_COLOUR, None)
        for part, mesh in scene.meshes.items():
            self.stage.show(body_node(part), mesh, part_colour(part), None)

    def _add_ghosts(self) -> None:
        """A ghost of each part, hidden; none under hand control."""
        self._ghosts = {} if self._by_hand else self.workspace.scene.meshes
        for part, mesh in self._ghosts.items():
            self.stage.show(ghost_node(part), mesh, texts.confidence_colour(0), texts.GHOST_OPACITY)
            self.stage.look(ghost_node(part), visible=False)

    def _part_in_hand(self) -> int | None:
        space = self.workspace
        return None if space.selected is None else space.carried(space.selected)

    def _label(self, body: int) -> None:
        """The label over a part or a cup, with the number of its ghost."""
        space = self.workspace
        motion, pivot = space.current[body].goal_from_now, space.pivot(body)
        if body in NAMES:
            text, top = texts.cup_label(body == PICK, body == space.selected), motion.apply(pivot + UP_THE_CUP)
        else:
            unsure = space.scene.known is not None and not space.scene.is_sure(body)
            text = texts.part_label(body, space.current[body], body == self._part_in_hand(), unsure)
            top = motion.apply(pivot) + self._label_offset
        ghost = space.ghost(body) if body == space.selected else None
        number = "" if ghost is None else f" · {texts.confidence_text(ghost.confidence)}"
        self.stage.label(f"/name/{body}", text + number, top)

    def _add_points(self) -> None:
        """The image as points, one cloud for each part that can be moved."""
        scene, others = self.workspace.scene, []
        for label, (points, colours) in scene.points.items():
            part = label - FIRST_PART_LABEL
            if label == ASSEMBLY_LABEL:
                self.stage.dots(KITS, points, colours)
            elif part in scene.parts:
                self.stage.dots(body_node(part), points, colours)
            else:
                others.append((points, np.full_like(colours, texts.OTHER_COLOUR)))
        if others:
            self.stage.dots(OTHERS, *map(np.concatenate, zip(*others, strict=True)))

    def _ghost(self) -> None:
        """The ghost of the selected body alone."""
        space = self.workspace
        shown = None if space.selected is None else space.ghost(space.selected)
        for body in self._ghosts:
            if body != space.selected or shown is None:
                self.stage.look(ghost_node(body), visible=False)
        if shown is not None and space.selected is not None:
            self.stage.move(ghost_node(space.selected), shown.goal_from_now)
            self.stage.look(ghost_node(space.selected), texts.confidence_colour(shown.confidence), True)

    def _gizmo(self) -> None:
        space, body = self.workspace, self.workspace.selected
        if body is None or not space.shows_gizmo:
            self.stage.gizmo(None)
        else:
            motion = space.current[body].goal_from_now
            self.stage.gizmo(Pose(motion.wxyz, motion.apply(space.pivot(body))))

    def _fit_text(self) -> str:
        """The part in the hand, where it may snap, how it lies, and what can be done next."""
        space, body = self.workspace, self.workspace.selected
        done = all(edit.confirmed for edit in space.part_edits.values())
        if body is None:
            return texts.ALL_DONE if done else texts.BEGIN[space.interface]
        part = space.carried(body)
        if part is None:
            return texts.PICK_FIRST if body == PLACE else self._pick_text()
        lines = [texts.part_line(part, space.part_edit(body)), self._snap_text(body)]
        if space.assists and not space.over_kits(body):
            lines.append(texts.ON_TABLE if part == body else texts.NOT_OVER_PLATE)
        if done:
            lines.append(texts.ALL_DONE)
        elif space.current[body].confirmed:
            lines.append(texts.GO_ON)
        elif space.over_kits(body) and not space.waits(body) and space.ghost(body) is None:
            lines.append(texts.CONFIRM[space.interface])
        return "\n\n".join(filter(None, lines))

    def _snap_text(self, body: int) -> str:
        """The ghost, or why there is none over a plate; nothing of a part that has snapped."""
        space, fits = self.workspace, self.workspace.fits(body)
        if fits:
            index = space.fit_index % len(fits)
            line = texts.ghost_line(fits[index], index, len(fits), space.shift_to(body, fits[index]))
            return f"{line} {texts.WAITING}" if space.waits(body) else line
        free = space.snaps and not space.current[body].snapped
        return self.no_fit(body) if free and space.over_kits(body) else ""

    def _pick_text(self) -> str:
        """Text of the picking cup in the hand."""
        part = self.workspace.carried(PLACE)
        return texts.NOTHING_PICKED if part is None else texts.picked(part)

    def no_fit(self, body: int) -> str:
        """Why a body has no ghost."""
        space = self.workspace
        if space.current[body].snapped:
            return texts.SNAPPED_ALREADY
        return texts.no_fit(space.proposals[body], space.over_kits(body), space.waits(body))


def framed(points: np.ndarray, direction: np.ndarray, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """(3,), (3,) [m]: where to look from, and at what, so that points (n, 3) [m] fill a window.

    direction: (3,) from them to the eye, any length. aspect: of the window, width over height.
    """
    size = (max(1, round(1000 * aspect)), 1000)
    field = 2 * float(np.arctan(tangent(FIELD / 2) * max(aspect, 1.0)))
    cloud = Mesh(points, np.zeros((0, 3), np.int32))
    _, pose = framing_camera([(cloud, Pose.identity())], direction, size, float(np.degrees(field)), BORDER)
    ahead = pose.inverse().apply(points)[:, 2].mean()
    return pose.xyz, pose.apply(np.array([0.0, 0.0, ahead]))


def body_node(body: int) -> str:
    """Name of a part or a cup on the page."""
    return f"/body/{body}"


def ghost_node(body: int) -> str:
    """Name of a body's ghost on the page."""
    return f"/ghost/{body}"
