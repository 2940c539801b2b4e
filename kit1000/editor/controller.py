"""Joins session, motions, proposals and records: takes the events of a page, and calls the page to show the result.

It knows no browser. Its methods may be called from any thread: they run one after another.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import partial, wraps
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from kit1000.editor import texts
from kit1000.editor.display import Display
from kit1000.editor.dragging import KEY_MOTIONS, NAMES, Drag, Held, KeyMotion, Modifier
from kit1000.editor.hand import BareHandWorkspace, HandWorkspace
from kit1000.editor.keys import Interface, verbs_of
from kit1000.editor.moves import write_moves
from kit1000.editor.picks import Pick, moves_of
from kit1000.editor.pointing import Eye
from kit1000.editor.proposals import takes_by_letting_go
from kit1000.editor.records import EventLog, write_predictions_of
from kit1000.editor.scene import EditedScene, answered_queries
from kit1000.editor.session import PartEdit, same_motion
from kit1000.editor.worker import Completion, Result, Worker
from kit1000.editor.workspace import Step, Workspace
from kit1000.pose import Pose

if TYPE_CHECKING:
    from kit1000.editor.page import ViserStage

INTERFACES: Mapping[Interface, type[Workspace]] = {
    each.interface: each for each in (Workspace, HandWorkspace, BareHandWorkspace)
}
Method = TypeVar("Method", bound=Callable[..., Any])


def exclusive(method: Method) -> Method:
    """One call at a time, and all it shows is sent at its end."""

    @wraps(method)
    def locked(self: Controller, *args: Any, **options: Any) -> Any:
        with self.lock:
            result = method(self, *args, **options)
            self.stage.flush()
            return result

    return cast(Method, locked)


class Controller:
    """The editor of one scene."""

    def __init__(
        self, scene: EditedScene, stage: ViserStage, log: EventLog, asker: Worker | None, moves: bool = False
    ) -> None:
        """Show the scene as the log has it, by the log's interface.

        asker: answers guesses; None: nothing snaps. moves: whether moves.json is written beside the predictions.
        """
        self.lock = threading.RLock()
        self.stage, self.log, self.asker = stage, log, asker
        self.space = INTERFACES[log.header.interface](scene, asker is not None)
        self.space.adopt(log.restored(self.space.edited))
        self.display = Display(stage, self.space)
        self.held = False
        """Whether nothing can be moved, as while a robot carries parts out."""
        self._drag: Drag | None = None
        self._picks: dict[int, Pick] | None = {} if moves else None
        self._scene_verbs: Mapping[str, Callable[[Eye | None], None]] = {
            "view-camera": partial(self._look, "camera"),
            "view-top": partial(self._look, "top"),
            "deselect": lambda _: self.select(None),
            "undo": lambda _: self._step("undo"),
            "redo": lambda _: self._step("redo"),
            "take-all": lambda _: self._take_all(),
            "confirm-all": lambda _: self._confirm(
                *(part for part, edit in self.space.part_edits.items() if edit.snapped)
            ),
            "reset-all": lambda _: self._do(Step("put all back", self.space.put_back(self.space.edited))),
        }
        self._body_verbs: Mapping[str, Callable[[int], None]] = {
            "view-slot": lambda _: self.display.look("slot"),
            "gizmo": self._switch_gizmo,
            "confirm": self._confirm,
            "reset": lambda body: self._do(Step(f"{self.space.name(body)}: put back", self.space.put_back([body]))),
            "next": self._next,
            "take": self._take,
        }
        self.display.look("camera")
        self._adopt()
        stage.flush()

    # Events of the page.

    @property
    def bodies(self) -> tuple[int, ...]:
        """The parts or cups that can be moved."""
        return self.space.bodies

    @property
    def drags(self) -> bool:
        """Whether they can be dragged and not only be moved by the gizmo."""
        return self.space.assists

    @exclusive
    def framed(self, eye: Eye) -> None:
        """The shape of the window is known, or has changed: show the whole scene, unless something was done."""
        if not self.space.session.done:
            self.display.look("camera", eye.aspect)

    @exclusive
    def select(self, body: int | None) -> None:
        """Take a part or a cup into the hand, or none."""
        if body is not None and body not in self.space.bodies:
            return
        self.space.choose(body)
        if body is not None and self.asker is not None:
            self.asker.prefer(body)
        self._ask()
        self.display.update()

    @exclusive
    def grab(
        self, body: int, eye: Eye, screen: tuple[float, float], point: np.ndarray, modifier: Modifier = None
    ) -> None:
        """A drag of a part or a cup begins.

        Args:
            body: its index.
            eye: the browser's camera.
            screen: where the pointer is, 0 to 1 from the left, and from the top.
            point: (3,) [m] world, of the body under the pointer.
            modifier: the key that is held.
        """
        space = self.space
        if body not in space.bodies or self._is_held():
            return
        space.choose(body)
        self.display.update()
        if not space.assists:
            return
        before, plate, surface = space.session.edits[body], space.plate_of(body), space.surface(body)
        self._drag = Drag(body, before, space.cloud(body), space.pivot(body), eye, screen, point, plate, modifier)
        surface.support(eye, screen)  # renders once, so that each step is a lookup

    @exclusive
    def drag(self, screen: tuple[float, float]) -> None:
        """The pointer moves."""
        drag = self._drag
        motion = drag and drag.motion(self.space.surface(drag.body), screen)
        if drag is not None and motion is not None:
            self.space.current[drag.body] = drag.before.moved(motion, drag.turns)
            self.display.moved(drag.body)

    @exclusive
    def release(self) -> None:
        """The pointer lets go: one operation. Near a fit it takes that."""
        drag, self._drag = self._drag, None
        if drag is None:
            return
        edit, name = self.space.current[drag.body], NAMES[drag.modifier]
        ghost = self.space.ghost(drag.body)
        if edit is not drag.before and ghost and takes_by_letting_go(ghost, edit, drag.pivot):
            edit, name = edit.taken(ghost.goal_from_now, ghost.confidence), f"{name} and snap"
        self._move(name, drag.body, edit)

    @exclusive
    def carry(self, gizmo: Pose, done: bool) -> None:
        """The gizmo at the selected body moves, world_from_gizmo; done: it was let go, which is one operation."""
        body = self.space.selected
        if body is None:
            return
        motion = gizmo @ Pose.from_translation(-self.space.pivot(body))
        if done:
            self.place(body, motion)
        else:
            self.space.current[body] = self.space.session.edits[body].moved(motion, True)
            self.display.moved(body)

    @exclusive
    def place(self, body: int, motion: Pose, name: str = "gizmo") -> None:
        """A part or a cup put into any pose: by the gizmo, by a script, or because a robot has left it there."""
        space = self.space
        if body in space.session.edits:
            if body in space.bodies:
                space.choose(body)
            self._move(name, body, space.session.edits[body].moved(motion, True))

    @exclusive
    def command(self, verb: str, eye: Eye | None = None) -> None:
        """A key or a button. eye: the browser's camera, for what depends on it."""
        space = self.space
        if verb not in verbs_of(space.interface, space.snaps):
            return
        if verb.startswith("select-"):
            self._number(int(verb.removeprefix("select-")) - 1)
        elif verb in self._scene_verbs:
            self._scene_verbs[verb](eye)
        elif space.selected is None:
            self.display.note(texts.CHOOSE[space.interface])
        elif verb in self._body_verbs:
            self._body_verbs[verb](space.selected)
        else:
            self._move_by_key(KEY_MOTIONS[verb], space.selected, eye)

    @exclusive
    def received(self, result: Result) -> None:
        """What the worker has found."""
        (part, guess), space = result.job, self.space
        proposals = space.proposals[part]
        if guess is None:
            proposals.found = result.proposals
        elif same_motion(guess, space.current[part].goal_from_now):
            proposals.answers, proposals.guess = result.proposals, guess
        else:
            return  # the hand has moved on
        proposals.failure = result.failure
        if part == space.selected:
            space.fit_index = 0
        self.display.update()

    @exclusive
    def completed(self, completion: Completion) -> None:
        """What the method has found of the known shapes of the scene."""
        if completion.shapes is not None:
            self.space.know(completion.shapes)
            self._save()
            self.display.know_shapes()
        elif completion.failure:
            self.space.not_found = texts.no_shapes(completion.failure)
            self.display.update()

    # What follows from them.

    def _number(self, part: int) -> None:
        if part not in self.space.scene.parts:
            self.display.note(texts.no_part(part))
            return
        body, step = self.space.pointed_at(part)
        if step.edits:
            self._do(step)
        self.select(body)

    def _look(self, name: str, eye: Eye | None) -> None:
        self.display.look(name, *(() if eye is None else (eye.aspect,)))

    def _switch_gizmo(self, body: int) -> None:
        del body
        self.space.shows_gizmo = not self.space.shows_gizmo
        self.display.update()

    def _move_by_key(self, key: KeyMotion, body: int, eye: Eye | None) -> None:
        space = self.space
        edit = space.session.edits[body]
        held = Held(edit.goal_from_now, space.cloud(body), space.pivot(body), space.plate_of(body), eye)
        self._move(key.name, body, edit.moved(key.motion(held), key.turns))

    def _take_all(self) -> None:
        nothing = texts.NOTHING_TO_SNAP_YET if self.space.sought() else texts.NOTHING_TO_SNAP
        self._do_or_say(self.space.snapped_all(), nothing)

    def _take(self, body: int) -> None:
        ghost = self.space.ghost(body)
        if ghost is None:
            self.display.note(self.display.no_fit(body))
            return
        edit = self.space.session.edits[body].taken(ghost.goal_from_now, ghost.confidence)
        self._move(f"snap ({100 * ghost.confidence:.0f} %)", body, edit)

    def _next(self, body: int) -> None:
        ghost = self.space.ghost(body)
        if ghost is None:
            self.display.note(self.display.no_fit(body))
            return
        self.log.add("refuse", part=body, confidence=ghost.confidence)
        self.space.fit_index += 1
        self.display.update()

    def _confirm(self, *bodies: int) -> None:
        step = self.space.confirmed(bodies)
        self._do_or_say(step, texts.NOTHING_TO_CONFIRM[self.space.interface])

    def _do_or_say(self, step: Step | None, otherwise: str) -> None:
        """Do a step, or say why there is none."""
        if step is None:
            self.display.note(otherwise)
        else:
            self._do(step)

    def _move(self, name: str, body: int, edit: PartEdit) -> None:
        """A body moved by hand, or snapped, under its name in the history."""
        self._do(Step(f"{self.space.name(body)}: {name}", {body: edit}))

    def _do(self, step: Step) -> None:
        if self._is_held():
            return
        session = self.space.session.did(step.name, step.edits)
        if session is not self.space.session:
            self.log.did(session)
            self.space.session, self.space.fit_index = session, 0
        self._adopt()

    def _step(self, verb: str) -> None:
        if self._is_held():
            return
        session = self.space.session
        stepped = session.undo() if verb == "undo" else session.redo()
        if stepped is session:
            self.display.note(f"Nothing to {verb}.")
            return
        self.log.add(verb)
        self.space.session = stepped
        self._adopt()

    def _is_held(self) -> bool:
        """Whether nothing can be moved; then everything is shown at its old pose, and the page says so."""
        if self.held:
            self.space.adopt(self.space.session)
            self.display.update()
            self.display.note(texts.HELD)
        return self.held

    def _adopt(self) -> None:
        """Save and show the session, and go on from it."""
        self.space.adopt(self.space.session)
        self._save()
        self._ask()
        self.display.update()

    def _save(self) -> None:
        """Write the confirmed parts."""
        space, header = self.space, self.log.header
        answered = answered_queries(space.scene.recorded.queries, header.sensor)
        folder, dataset = self.log.path.parent, space.scene.dataset
        write_predictions_of(folder, dataset, header, answered, space.session)
        if self._picks is not None:
            moves = moves_of(space.scene, space.session, space.pointing, self._picks)
            unseen = space.session.edits.keys() - space.scene.parts
            kept = [part for part in unseen if space.session.edits[part].confirmed]
            write_moves(folder, dataset.id, header.key(), moves, kept)

    def _ask(self) -> None:
        """Ask the method about the body in the hand, if it has not answered to its pose."""
        body, space = self.space.selected, self.space
        if body is not None and self.asker is not None and space.waits(body):
            self.asker.ask(body, space.current[body].goal_from_now)
