"""Shows a workspace on a stage: parts, ghost, labels, panel."""

from __future__ import annotations

import numpy as np

from kit1000.editor import texts
from kit1000.editor.stage import Stage
from kit1000.editor.workspace import Workspace
from kit1000.pictures.scene_preview import part_colour
from kit1000.pose import Pose, unit_vector

KITS, OTHERS, NUMBER = "/kits", "/others", "/number"
OVER_PART, OVER_GHOST = np.array([0.0, 0.0, 0.02]), np.array([0.0, 0.0, 0.05])  # [m] of their labels
AWAY = 2.6  # radii of the scene: from there a square window shows all of it at 45 degrees
STRAIGHT_DOWN = np.array([0.0, -0.02, 1.0])  # not quite: the view keeps its upward direction
SLOT_VIEW = 0.3  # [m] from a plate


class Display:
    """What the page shows of a workspace."""

    def __init__(self, stage: Stage, workspace: Workspace) -> None:
        self.stage, self.workspace = stage, workspace
        scene = workspace.scene
        stage.show(KITS, scene.kits, texts.KIT_COLOUR, None)
        if len(scene.others.faces):
            stage.show(OTHERS, scene.others, texts.OTHER_COLOUR, None)
        for part, mesh in scene.meshes.items():
            stage.show(part_node(part), mesh, part_colour(part), None)
            stage.show(ghost_node(part), mesh, texts.confidence_colour(0), texts.GHOST_OPACITY)
            stage.look(ghost_node(part), visible=False)

    def moved(self, part: int) -> None:
        """A part in a drag: its pose and its ghost, nothing else."""
        self.stage.move(part_node(part), self.workspace.current[part].goal_from_now)
        self._ghost()

    def update(self) -> None:
        """Everything."""
        space = self.workspace
        for part, edit in space.current.items():
            self.stage.move(part_node(part), edit.goal_from_now)
            top = edit.goal_from_now.apply(space.scene.pivot(part)) + OVER_PART
            self.stage.label(f"/name/{part}", texts.part_label(part, edit, part == space.selected), top)
        self._ghost()
        self.stage.look(KITS, visible=not space.kits_hidden)
        self.stage.progress(space.known_share())
        self.stage.say("note", "")
        self.stage.say("parts", texts.parts_table(space.session.edits, space.selected))
        self.stage.say("fit", self._fit_text())
        names = [operation.name for operation in (*space.session.done, *reversed(space.session.undone))]
        self.stage.history(names, len(space.session.done))
        self._gizmo()

    def note(self, text: str) -> None:
        """A line that stays until the next event."""
        self.stage.say("note", text)

    def look(self, name: str) -> None:
        """Put the camera: camera, top, or slot for the plate under the selected part."""
        space = self.workspace
        middle, radius = space.scene.extent
        if name == "camera":
            towards = space.scene.view.world_from_camera.xyz - middle
            self.stage.look_from(middle + AWAY * radius * unit_vector(towards), middle)
        elif name == "top":
            self.stage.look_from(middle + AWAY * radius * STRAIGHT_DOWN, middle)
        elif space.selected is not None:
            image = space.current[space.selected].goal_from_now.apply(space.scene.pivot(space.selected))
            away = SLOT_VIEW * space.plate_of(space.selected).normal
            self.stage.look_from(image + away + (0, -0.01, 0), image)

    def _ghost(self) -> None:
        """The ghost of the selected part alone, with its number."""
        space = self.workspace
        shown = None if space.selected is None else space.ghost(space.selected)
        for part in space.scene.parts:
            if part != space.selected or shown is None:
                self.stage.look(ghost_node(part), visible=False)
        if shown is None or space.selected is None:
            self.stage.label(NUMBER, "", np.zeros(3))
            return
        self.stage.move(ghost_node(space.selected), shown.goal_from_now)
        self.stage.look(ghost_node(space.selected), texts.confidence_colour(shown.confidence), True)
        top = shown.goal_from_now.apply(space.scene.pivot(space.selected)) + OVER_GHOST
        self.stage.label(NUMBER, texts.confidence_text(shown.confidence), top)

    def _gizmo(self) -> None:
        space, part = self.workspace, self.workspace.selected
        if part is None or not space.shows_gizmo:
            self.stage.gizmo(None)
        else:
            motion = space.current[part].goal_from_now
            self.stage.gizmo(Pose(motion.wxyz, motion.apply(space.scene.pivot(part))))

    def _fit_text(self) -> str:
        space, part = self.workspace, self.workspace.selected
        if part is None:
            return texts.BEGIN
        lines = [texts.part_line(part, space.current[part])]
        fits, ghost = space.fits(part), space.ghost(part)
        if ghost is not None:
            lines.append(texts.ghost_line(ghost, space.fit_index % len(fits), len(fits), space.shift_to_ghost(part)))
        elif space.over_kits(part) and not space.current[part].snapped and space.snaps:
            lines.append(self.no_fit(part))
        if space.waits(part):
            lines.append(texts.WAITING)
        return "\n\n".join([*lines, self._contact_line(part)])

    def no_fit(self, part: int) -> str:
        """Why a part has no ghost."""
        space = self.workspace
        return texts.no_fit(space.proposals[part], space.over_kits(part), space.waits(part))

    def _contact_line(self, part: int) -> str:
        space = self.workspace
        if not space.over_kits(part):
            return texts.ON_TABLE
        contact = space.scene.contact(part, space.current[part].goal_from_now, space.plate_of(part))
        return f"{'True shapes' if space.scene.truth else 'As seen'}: {contact.text()}."


def part_node(part: int) -> str:
    """Name of a part on the page."""
    return f"/part/{part}"


def ghost_node(part: int) -> str:
    """Name of a part's ghost on the page."""
    return f"/ghost/{part}"
