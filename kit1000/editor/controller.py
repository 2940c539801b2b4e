"""Joins session, gestures, proposals and records: takes the events of a page, and tells the page what to show.

It knows no browser. Its methods may be called from any thread: they run one after another.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, Protocol, TypeVar, cast

import numpy as np

from kit1000.editor import gestures, texts
from kit1000.editor.display import Display
from kit1000.editor.dragging import NAMES, Drag, Modifier, screen_axes
from kit1000.editor.keys import FINE_TURN_DEG, STEP_MM, TURN_DEG
from kit1000.editor.pointing import Eye
from kit1000.editor.proposals import Proposal, same_motion, takes_by_letting_go
from kit1000.editor.records import EventLog, answered_queries, write_predictions_of
from kit1000.editor.scene import EditedScene
from kit1000.editor.session import LIKELY, UNTOUCHED, PartEdit, part_name
from kit1000.editor.stage import Stage
from kit1000.editor.worker import Result
from kit1000.editor.workspace import Workspace
from kit1000.pose import Pose

APART = 25e-3  # [m] between the pivots of two parts in different cavities
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

    def __init__(self, scene: EditedScene, stage: Stage, log: EventLog, asker: Asker | None) -> None:
        """Show the scene as the log has it. asker: who answers guesses; None: nothing snaps."""
        self.lock = threading.RLock()
        self.stage, self.log, self.asker = stage, log, asker
        self.space = Workspace(scene, log.restored(scene.parts), asker is not None)
        self.display = Display(stage, self.space)
        self.lets_go = True
        """Whether letting go near a fit takes it."""
        self._drag: Drag | None = None
        self.display.look("camera")
        self._adopt()
        stage.flush()

    # Events of the page.

    @exclusive
    def select(self, part: int | None) -> None:
        """Take a part into the hand, or none."""
        if part is not None and part not in self.space.current:
            return
        self.space.choose(part)
        if part is not None and self.asker is not None:
            self.asker.prefer(part)
        self.display.update()

    @exclusive
    def grab(
        self, part: int, eye: Eye, screen: tuple[float, float], point: np.ndarray, modifier: Modifier = None
    ) -> None:
        """A drag of a part begins.

        Args:
            part: its index.
            eye: the browser's camera.
            screen: where the pointer is, 0 to 1 from the left, and from the top.
            point: (3,) [m] world, of the part under the pointer.
            modifier: the key that is held.
        """
        space = self.space
        if part not in space.current:
            return
        space.choose(part)
        scene = space.scene
        before, plate = space.session.edits[part], space.plate_of(part)
        self._drag = Drag(part, before, scene.clouds[part], scene.pivot(part), eye, screen, point, plate, modifier)
        space.pointing.support(eye, screen)  # renders once, so that each step is a lookup

    @exclusive
    def drag(self, screen: tuple[float, float]) -> None:
        """The pointer moves."""
        drag = self._drag
        motion = drag and drag.motion(self.space.pointing, screen)
        if drag is not None and motion is not None:
            self.space.current[drag.part] = drag.before.moved(motion, drag.turns)
            self.display.moved(drag.part)

    @exclusive
    def release(self) -> None:
        """The pointer lets go: one operation. Near a fit it takes that."""
        drag, self._drag = self._drag, None
        if drag is None:
            return
        edit, name = self.space.current[drag.part], NAMES[drag.modifier]
        ghost = self.space.ghost(drag.part)
        if edit is not drag.before and self.lets_go and ghost and takes_by_letting_go(ghost, edit, drag.pivot):
            self._do(f"{name} and snap", {drag.part: edit.taken(ghost.goal_from_now, ghost.confidence)})
        else:
            self._do(name, {drag.part: edit})

    @exclusive
    def carry(self, gizmo: Pose, done: bool) -> None:
        """The gizmo at the selected part moves, world_from_gizmo; done: it was let go, which is one operation."""
        part = self.space.selected
        if part is None:
            return
        motion = gizmo @ Pose.from_translation(-self.space.scene.pivot(part))
        if done:
            self.place(part, motion)
        else:
            self.space.current[part] = self.space.session.edits[part].moved(motion, True)
            self.display.moved(part)

    @exclusive
    def take_by_letting_go(self, takes: bool) -> None:
        """Whether letting go near a fit takes it."""
        self.lets_go = takes

    @exclusive
    def place(self, part: int, motion: Pose, name: str = "gizmo") -> None:
        """A part put into any pose: by the gizmo, or by a script."""
        if part in self.space.current:
            self.space.choose(part)
            self._do(name, {part: self.space.session.edits[part].moved(motion, True)})

    @exclusive
    def command(self, verb: str, eye: Eye | None = None) -> None:
        """A key or a button. eye: the browser's camera, for what depends on it."""
        space = self.space
        if verb.startswith("select-"):
            self.select(int(verb.removeprefix("select-")) - 1)
        elif verb.startswith("view-"):
            self.display.look(verb.removeprefix("view-"))
        elif verb == "deselect":
            self.select(None)
        elif verb == "hide-kits":
            space.kits_hidden = not space.kits_hidden
            self.display.update()
        elif verb in ("undo", "redo"):
            self._step(verb)
        elif verb == "take-all":
            self._take_all()
        elif verb == "confirm-all":
            self._confirm([part for part, edit in space.session.edits.items() if edit.snapped])
        elif verb == "reset-all":
            self._do("put all back", dict.fromkeys(space.session.edits, UNTOUCHED))
        elif space.selected is None:
            self.display.note(texts.CHOOSE)
        else:
            self._part_command(verb, space.selected, eye)

    @exclusive
    def return_to(self, count: int) -> None:
        """Undo or redo until `count` operations are done."""
        self.space.session = self.space.session.returned(count)
        self.log.add("return", count=count)
        self._adopt()

    @exclusive
    def received(self, result: Result) -> None:
        """What the worker has found."""
        part, space = result.job.part, self.space
        proposals = space.proposals[part]
        proposals.failure = result.failure
        if result.job.guess is None:
            proposals.found = result.proposals
        elif same_motion(result.job.guess, space.session.edits[part].goal_from_now):
            proposals.answers, proposals.guess = result.proposals, result.job.guess
        if part == space.selected:
            space.fit_index = 0
        if self._drag is None:
            self.display.update()

    # What follows from them.

    def _part_command(self, verb: str, part: int, eye: Eye | None) -> None:
        if verb == "gizmo":
            self.space.shows_gizmo = not self.space.shows_gizmo
            self.display.update()
        elif verb == "confirm":
            self._confirm([part])
        elif verb == "reset":
            self._do("put back", {part: UNTOUCHED})
        elif verb == "next":
            self._next(part)
        elif verb == "take":
            self._take(part)
        else:
            self._do(*self._moved_by_key(verb, part, eye))

    def _moved_by_key(self, verb: str, part: int, eye: Eye | None) -> tuple[str, dict[int, PartEdit]]:
        """The operation of a key that moves a part."""
        scene, edit, plate = self.space.scene, self.space.session.edits[part], self.space.plate_of(part)
        motion, pivot, cloud = edit.goal_from_now, scene.pivot(part), scene.clouds[part]
        if verb in ("raise", "lower"):
            step = STEP_MM * 1e-3 * (1 if verb == "raise" else -1)
            return verb, {part: edit.moved(gestures.shifted(motion, step * plate.normal))}
        if verb.startswith("turn-"):
            angle = np.radians(FINE_TURN_DEG if verb.endswith("fine") else TURN_DEG)
            turned = gestures.rotated(motion, pivot, plate.normal, angle if "left" in verb else -angle)
            return "turn", {part: edit.moved(turned, True)}
        if verb == "level":
            return "stand level", {part: edit.moved(gestures.levelled(motion, cloud, pivot, plate), True)}
        axis = screen_axes(eye, plate)[0 if verb == "tip-away" else 1]
        tipped = gestures.rotated(motion, pivot, axis, -np.pi / 2)
        return "tip over", {part: edit.moved(gestures.stood(tipped, cloud, plate), True)}

    def _take(self, part: int) -> None:
        ghost = self.space.ghost(part)
        if ghost is None:
            self.display.note(self.display.no_fit(part))
            return
        name = f"snap {part_name(part)} ({100 * ghost.confidence:.0f} %)"
        edit = self.space.session.edits[part]
        self._do(name, {part: edit.taken(ghost.goal_from_now, ghost.confidence)})

    def _next(self, part: int) -> None:
        ghost = self.space.ghost(part)
        if ghost is None:
            self.display.note(self.display.no_fit(part))
            return
        self.log.add("refuse", part=part, confidence=ghost.confidence)
        self.space.fit_index += 1
        self.display.update()

    def _take_all(self) -> None:
        """Snap every part that has not: onto the fit near the hand, or the surest; no two into one cavity."""
        scene, edits = self.space.scene, self.space.session.edits
        taken = [edit.goal_from_now.apply(scene.pivot(part)) for part, edit in edits.items() if edit.snapped]
        likely = {part: fit for part in edits if (fit := self._likely(part)) is not None}
        changes: dict[int, PartEdit] = {}
        for part, fit in sorted(likely.items(), key=lambda item: -item[1].confidence):
            place = fit.goal_from_now.apply(scene.pivot(part))
            if all(float(np.abs(place - other).max()) > APART for other in taken):
                taken.append(place)
                changes[part] = edits[part].taken(fit.goal_from_now, fit.confidence)
        if changes:
            self._do("snap " + ", ".join(part_name(part) for part in sorted(changes)), changes)
        else:
            self.display.note(texts.NOTHING_TO_SNAP)

    def _likely(self, part: int) -> Proposal | None:
        """The fit that needs no second look: near the hand, or the surest; None below LIKELY, or of a snapped part."""
        edit = self.space.session.edits[part]
        fit = self.space.ghost(part) if self.space.over_kits(part) else self.space.proposals[part].best()
        return fit if fit is not None and not edit.snapped and fit.confidence >= LIKELY else None

    def _confirm(self, parts: Sequence[int]) -> None:
        ready = tuple(part for part in parts if self.space.over_kits(part))
        if not ready:
            self.display.note(texts.NOTHING_TO_CONFIRM)
            return
        session = self.space.session.confirmed(ready)
        if session is not self.space.session:
            self.space.session = session
            self.log.did(session)
        self._adopt()

    def _do(self, name: str, edits: Mapping[int, PartEdit]) -> None:
        session = self.space.session.did(name, edits)
        if session is not self.space.session:
            self.space.session, self.space.fit_index = session, 0
            self.log.did(session)
        self._adopt()

    def _step(self, verb: str) -> None:
        session = self.space.session
        stepped = session.undo() if verb == "undo" else session.redo()
        if stepped is not session:
            self.space.session = stepped
            self.log.add(verb)
            self._adopt()

    def _adopt(self) -> None:
        """Show and save the session; ask the method about the part in the hand."""
        space, header = self.space, self.log.header
        space.current = dict(space.session.edits)
        answered = answered_queries(space.scene.recorded.queries, header.sensor)
        write_predictions_of(self.log.path.parent, space.scene.dataset, header, answered, space.session)
        if space.selected is not None and self.asker is not None and space.waits(space.selected):
            self.asker.ask(space.selected, space.session.edits[space.selected].goal_from_now)
        self.display.update()
