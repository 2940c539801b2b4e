"""Joins session, gestures, proposals and records: takes the events of a page, and tells the page what to show.

It knows no browser. Its methods may be called from any thread: they run one after another.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, Protocol, TypeVar, cast

import numpy as np

from kit1000.editor import gestures, texts
from kit1000.editor.display import Display
from kit1000.editor.dragging import NAMES, Drag, Modifier, screen_axes
from kit1000.editor.hand import BareHandWorkspace, HandWorkspace
from kit1000.editor.keys import FINE_TURN_DEG, STEP_MM, TURN_DEG, Interface, verbs_of
from kit1000.editor.moves import write_moves
from kit1000.editor.picks import Pick, moves_of
from kit1000.editor.pointing import Eye
from kit1000.editor.proposals import takes_by_letting_go
from kit1000.editor.records import EventLog, write_predictions_of
from kit1000.editor.scene import EditedScene, answered_queries
from kit1000.editor.session import PartEdit
from kit1000.editor.stage import Stage
from kit1000.editor.worker import Completion, Result
from kit1000.editor.workspace import Step, Workspace
from kit1000.pose import Pose

INTERFACES: Mapping[Interface, type[Workspace]] = {
    each.interface: each for each in (Workspace, HandWorkspace, BareHandWorkspace)
}
Method = TypeVar("Method", bound=Callable[..., Any])


class Asker(Protocol):
    """Who answers guesses: the worker."""

    def ask(self, part: int, guess: Pose) -> None:
        """Ask for the answer to a guess."""
        ...

    def prefer(self, part: int) -> None:
        """The part in the hand."""
        ...


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
        self, scene: EditedScene, stage: Stage, log: EventLog, asker: Asker | None, moves: bool = False
    ) -> None:
        """Show the scene as the log has it, by the log's interface.

        asker: who answers guesses; None: nothing snaps. moves: whether moves.json is written beside the predictions.
        """
        self.lock = threading.RLock()
        self.stage, self.log, self.asker = stage, log, asker
        self.space = INTERFACES[log.header.interface](scene, asker is not None)
        self.space.adopt(log.restored(self.space.edited))
        self.display = Display(stage, self.space)
        self.lets_go = True
        """Whether letting go near a fit takes it."""
        self.held = False
        """Whether nothing can be moved, as while a robot carries parts out."""
        self._drag: Drag | None = None
        self._picks: dict[int, Pick] | None = {} if moves else None
        self.display.look("camera")
        self._adopt()
        stage.flush()

    # Events of the page.

    @exclusive
    def select(self, body: int | None) -> None:
        """Take a part or a cup into the hand, or none."""
        if body is not None and body not in self.space.bodies:
            return
        self.space.choose(body)
        part = None if body is None else self.space.carried(body)
        if part is not None and self.asker is not None:
            self.asker.prefer(part)
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
        if edit is not drag.before and self.lets_go and ghost and takes_by_letting_go(ghost, edit, drag.pivot):
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
    def take_by_letting_go(self, takes: bool) -> None:
        """Whether letting go near a fit takes it."""
        self.lets_go = takes

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
        elif verb in ("view-camera", "view-top"):
            self.display.look(verb.removeprefix("view-"), *(() if eye is None else (eye.aspect,)))
        elif verb == "deselect":
            self.select(None)
        elif verb == "hide-kits":
            space.kits_hidden = not space.kits_hidden
            self.display.update()
        elif verb in ("undo", "redo"):
            self._step(verb)
        elif verb == "take-all":
            self._do_or_say(space.snapped_all(), texts.NOTHING_TO_SNAP_YET if space.sought() else texts.NOTHING_TO_SNAP)
        elif verb == "confirm-all":
            self._confirm(*(part for part, edit in space.session.edits.items() if edit.snapped))
        elif verb == "reset-all":
            self._do(Step("put all back", space.put_back(space.edited)))
        elif space.selected is None:
            self.display.note(texts.CHOOSE[space.interface])
        else:
            self._body_command(verb, space.selected, eye)

    @exclusive
    def return_to(self, count: int) -> None:
        """Undo or redo until `count` operations are done."""
        if self._is_held():
            return
        self.log.add("return", count=count)
        self.space.session = self.space.session.returned(count)
        self._adopt()

    @exclusive
    def received(self, result: Result) -> None:
        """What the worker has found."""
        (part, guess), space = result.job, self.space
        proposals, carrier = space.proposals[part], space.carrier(part)
        if guess is None:
            proposals.found = result.proposals
        elif carrier is not None and gestures.same_motion(guess, space.part_edit(carrier).goal_from_now):
            proposals.answers, proposals.guess = result.proposals, guess
        else:
            return  # the hand has moved on
        proposals.failure = result.failure
        if carrier is not None and carrier == space.selected:
            space.fit_index = 0
        self.display.update()

    @exclusive
    def completed(self, completion: Completion) -> None:
        """What the worker has completed of the kits."""
        if completion.kits is not None:
            self.display.complete_kits(completion.kits)
        elif completion.failure:
            self.display.note(texts.not_completed(completion.failure))

    # What follows from them.

    def _number(self, part: int) -> None:
        if part not in self.space.scene.parts:
            self.display.note(texts.no_part(part))
            return
        body, step = self.space.pointed_at(part)
        if step.edits:
            self._do(step)
        self.select(body)

    def _body_command(self, verb: str, body: int, eye: Eye | None) -> None:
        space = self.space
        if verb == "view-slot":
            self.display.look("slot")
        elif verb == "gizmo":
            space.shows_gizmo = not space.shows_gizmo
            self.display.update()
        elif verb == "confirm":
            self._confirm(body)
        elif verb == "reset":
            self._do(Step(f"{space.name(body)}: put back", space.put_back([body])))
        elif verb == "next":
            self._next(body)
        elif verb == "take":
            self._take(body)
        else:
            name, edit = self._moved_by_key(verb, body, eye)
            self._move(name, body, edit)

    def _moved_by_key(self, verb: str, body: int, eye: Eye | None) -> tuple[str, PartEdit]:
        """The name of what a key does that moves a body, and the body's edit."""
        space, plate = self.space, self.space.plate_of(body)
        edit, pivot, cloud = space.session.edits[body], space.pivot(body), space.cloud(body)
        motion = edit.goal_from_now
        if verb in ("raise", "lower"):
            step = STEP_MM * 1e-3 * (1 if verb == "raise" else -1)
            return verb, edit.moved(gestures.shifted(motion, step * plate.normal))
        if verb.startswith("turn-"):
            angle = np.radians(FINE_TURN_DEG if verb.endswith("fine") else TURN_DEG)
            turned = gestures.rotated(motion, pivot, plate.normal, angle if "left" in verb else -angle)
            return "turn", edit.moved(turned, True)
        if verb == "level":
            return "stand level", edit.moved(gestures.levelled(motion, cloud, pivot, plate), True)
        axis = screen_axes(eye, plate)[0 if verb == "tip-away" else 1]
        tipped = gestures.rotated(motion, pivot, axis, -np.pi / 2)
        return "tip over", edit.moved(gestures.stood(tipped, cloud, plate), True)

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
        self.log.add("refuse", part=self.space.carried(body), confidence=ghost.confidence)
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
        self._do(self.space.moved(f"{self.space.name(body)}: {name}", body, edit))

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
        """Whether nothing can be moved; then all is shown where it was, and the page says so."""
        if self.held:
            self.space.adopt(self.space.session)
            self.display.update()
            self.display.note(texts.HELD)
        return self.held

    def _adopt(self) -> None:
        """Save and show the session, and go on from it."""
        space, header = self.space, self.log.header
        space.adopt(space.session)
        answered = answered_queries(space.scene.recorded.queries, header.sensor)
        folder, dataset = self.log.path.parent, space.scene.dataset
        write_predictions_of(folder, dataset, header, answered, space.session)
        if self._picks is not None:
            moves = moves_of(space.scene, space.session, space.pointing, self._picks)
            write_moves(folder, dataset.id, header.key(), moves)
        self._ask()
        self.display.update()

    def _ask(self) -> None:
        """Ask the method about the body in the hand, where its answer is still to come."""
        body, space = self.space.selected, self.space
        part = None if body is None else space.carried(body)
        if body is not None and part is not None and self.asker is not None and space.waits(body):
            self.asker.ask(part, space.part_edit(body).goal_from_now)
