"""What the editor knows at a moment: the session, what is in the hand, and where it may snap.

A *body* is what the hand moves: here each part, by its index; under hand control (`hand`) two suction cups.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kit1000.editor import texts
from kit1000.editor.keys import Interface
from kit1000.editor.pointing import Pointing, Surface
from kit1000.editor.proposals import PartProposals, Proposal
from kit1000.editor.scene import EditedScene
from kit1000.editor.seen_plates import Plate
from kit1000.editor.session import LIKELY, UNTOUCHED, PartEdit, Session, distance, part_name, same_motion

if TYPE_CHECKING:
    from kit1000.known_shapes.predictor import FoundShapes

APART = 25e-3  # [m] between the pivots of two parts in different cavities


class Step(NamedTuple):
    """An operation that is proposed: its name for the history, and the edits that it makes."""

    name: str
    edits: Mapping[int, PartEdit]


class Workspace:
    """The state of an editor in which the hand moves the parts themselves; only the controller changes it."""

    interface: Interface = "scene"
    assists = True  # whether the page helps the hand: drags slide over surfaces, keys align, a number picks a part

    def __init__(self, scene: EditedScene, snaps: bool) -> None:
        """Nothing has moved. snaps: whether a method proposes fits."""
        self.scene, self.snaps = scene, snaps
        self.session = Session.begin(self.edited)
        self.current = dict(self.session.edits)
        """The edits of what is shown, with the body in a drag where it is now."""
        self.pointing = Pointing(scene.kits, scene.plates)
        self.proposals = {part: PartProposals(scene.pivot(part)) for part in scene.parts}
        self.not_found = ""
        """What is said of known shapes that were not found."""
        self.selected: int | None = None
        """The body in the hand."""
        self.fit_index = 0
        """Index of the fit that is shown, among those near the hand."""
        self.shows_gizmo = False

    @property
    def bodies(self) -> tuple[int, ...]:
        """What the hand moves."""
        return self.scene.parts

    @property
    def edited(self) -> tuple[int, ...]:
        """What the session has edits of."""
        return self.scene.parts

    def name(self, body: int) -> str:
        """What the page calls a body."""
        return part_name(body)

    def pivot(self, body: int) -> np.ndarray:
        """(3,) [m] world: about which a body turns, at its recorded pose."""
        return self.scene.pivot(body)

    def cloud(self, body: int) -> np.ndarray:
        """(n, 3) [m] world: bounds what must stand on a surface, at the recorded pose of the body."""
        return self.scene.clouds[body]

    def surface(self, body: int) -> Surface:
        """On which a body is put down."""
        del body
        return self.pointing

    def carried(self, body: int) -> int | None:
        """The part that moves with a body; None if there is none."""
        return body

    def part_edit(self, body: int) -> PartEdit:
        """What the body, where it is now, does to its part."""
        return self.current[body]

    @property
    def part_edits(self) -> dict[int, PartEdit]:
        """The edit of each part that is shown."""
        return {part: self.session.edits[part] for part in self.scene.parts}

    def know(self, shapes: FoundShapes) -> None:
        """Show known shapes where they were found."""
        self.scene = scene = self.scene.knowing(shapes)
        self.pointing = Pointing(scene.kits, scene.plates)
        further = [part for part in scene.parts if part not in self.proposals]
        self.proposals |= {part: PartProposals(scene.pivot(part)) for part in further}
        self.session = replace(self.session, edits={**Session.begin(scene.parts).edits, **self.session.edits})
        self.current = {**self.part_edits, **self.current}
        self.not_found = texts.not_found(shapes.missing)

    def adopt(self, session: Session) -> None:
        """Take over a session."""
        self.session, self.current = session, {body: session.edits[body] for body in self.edited}

    def choose(self, body: int | None) -> None:
        """Take a body into the hand, or none."""
        if body != self.selected:
            self.selected, self.fit_index = body, 0

    def plate_of(self, body: int) -> Plate:
        """The plate that a body is on; the table if it is on none."""
        return self.surface(body).below(self.current[body].goal_from_now.apply(self.pivot(body)))

    def over_kits(self, body: int) -> bool:
        """Whether a body is over a plate."""
        return self.plate_of(body) in self.scene.plates

    # Where the hand may snap to.

    def fits(self, body: int) -> list[Proposal]:
        """The fits within reach of a body over a plate, the best first; none of a body that has snapped."""
        return self.proposals[body].near(self.current[body]) if self._may_snap(body) else []

    def ghost(self, body: int) -> Proposal | None:
        """The fit that is shown."""
        fits = self.fits(body)
        return fits[self.fit_index % len(fits)] if fits else None

    def shift_to(self, body: int, fit: Proposal) -> tuple[float, float]:
        """[m], [rad] from the hand to a fit."""
        return distance(fit.goal_from_now, self.current[body].goal_from_now, self.pivot(body))

    def waits(self, body: int) -> bool:
        """Whether the method has not answered yet to the present pose of a body."""
        guess = self.proposals[body].guess if self._may_snap(body) else None
        return self._may_snap(body) and (guess is None or not same_motion(guess, self.current[body].goal_from_now))

    def _may_snap(self, body: int) -> bool:
        return self.snaps and not self.current[body].snapped and self.over_kits(body)

    def sought(self) -> list[int]:
        """The parts for which the method still looks for fits."""
        return [part for part, each in self.proposals.items() if self.snaps and each.found is None]

    # What keys and buttons would do.

    def pointed_at(self, part: int) -> tuple[int, Step]:
        """The body that a part's number takes into the hand, and what that changes."""
        return part, Step("", {})

    def snapped_all(self) -> Step | None:
        """Every part that has not snapped: onto the fit near the hand, or the surest; no two into one cavity."""
        scene, edits = self.scene, self.part_edits
        taken = [edit.goal_from_now.apply(scene.pivot(part)) for part, edit in edits.items() if edit.snapped]
        likely = {part: fit for part in edits if (fit := self._likely(part)) is not None}
        changes: dict[int, PartEdit] = {}
        for part, fit in sorted(likely.items(), key=lambda item: -item[1].confidence):
            place = fit.goal_from_now.apply(scene.pivot(part))
            if all(float(np.abs(place - other).max()) > APART for other in taken):
                taken.append(place)
                changes[part] = edits[part].taken(fit.goal_from_now, fit.confidence)
        return Step("snap " + ", ".join(part_name(part) for part in sorted(changes)), changes) if changes else None

    def confirmed(self, bodies: Sequence[int]) -> Step | None:
        """The step that confirms the bodies over a plate; None if none is."""
        ready = [body for body in bodies if self.over_kits(body)]
        edits = {part: self.session.edits[part].confirm() for part in ready}
        return Step("confirm " + ", ".join(map(part_name, ready)), edits) if ready else None

    def put_back(self, bodies: Sequence[int]) -> dict[int, PartEdit]:
        """The bodies where they were at first."""
        return dict.fromkeys(bodies, UNTOUCHED)

    def _likely(self, part: int) -> Proposal | None:
        """The fit that needs no second look: near the hand, or the surest; None below LIKELY, or of a snapped part."""
        edit = self.session.edits[part]
        fit = self.ghost(part) if self.over_kits(part) else self.proposals[part].best()
        return fit if fit is not None and not edit.snapped and fit.confidence >= LIKELY else None
