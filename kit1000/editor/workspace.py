"""What the editor knows at a moment: the session, the part in the hand, and where it may snap."""

from __future__ import annotations

from dataclasses import dataclass, field

from kit1000.editor import gestures
from kit1000.editor.plates import TABLE, Plate
from kit1000.editor.pointing import Pointing
from kit1000.editor.proposals import PartProposals, Proposal, same_motion
from kit1000.editor.scene import EditedScene
from kit1000.editor.session import PartEdit, Session


@dataclass
class Workspace:
    """The state of an editor; only the controller changes it."""

    scene: EditedScene
    session: Session
    snaps: bool
    """Whether a method proposes fits."""
    pointing: Pointing = field(init=False)
    proposals: dict[int, PartProposals] = field(init=False)
    current: dict[int, PartEdit] = field(init=False)
    """The edits, with the part in a drag where it is now."""
    selected: int | None = None
    fit_index: int = 0
    """Of the fit that is shown, among those near the hand."""
    shows_gizmo: bool = False
    kits_hidden: bool = False

    def __post_init__(self) -> None:
        self.pointing = Pointing(self.scene.kits, self.scene.plates)
        self.proposals = {part: PartProposals(self.scene.pivot(part)) for part in self.scene.parts}
        self.current = dict(self.session.edits)

    def choose(self, part: int | None) -> None:
        """Take a part into the hand, or none."""
        if part != self.selected:
            self.selected, self.fit_index = part, 0

    def plate_of(self, part: int) -> Plate:
        """The plate that a part is on; the table where it is on none."""
        return self.pointing.below(self.current[part].goal_from_now.apply(self.scene.pivot(part)))

    def over_kits(self, part: int) -> bool:
        """Whether a part is over a plate."""
        return self.plate_of(part) is not TABLE

    def fits(self, part: int) -> list[Proposal]:
        """The fits within reach of a part that is over a plate, the best first; none of one that has snapped."""
        if self.current[part].snapped or not self.over_kits(part):
            return []
        return self.proposals[part].near(self.current[part])

    def ghost(self, part: int) -> Proposal | None:
        """The fit that is shown."""
        fits = self.fits(part)
        return fits[self.fit_index % len(fits)] if fits else None

    def shift_to_ghost(self, part: int) -> tuple[float, float] | None:
        """[m], [rad] from the hand to the fit that is shown."""
        ghost, pivot = self.ghost(part), self.scene.pivot(part)
        return ghost and gestures.distance(ghost.goal_from_now, self.current[part].goal_from_now, pivot)

    def waits(self, part: int) -> bool:
        """Whether the method's answer to where a part is is still to come."""
        edit, guess = self.session.edits[part], self.proposals[part].guess
        if not self.snaps or edit.snapped or not self.over_kits(part):
            return False
        return guess is None or not same_motion(guess, edit.goal_from_now)

    def known_share(self) -> float:
        """Share of the parts whose fits are known without a guess."""
        known = [proposals.found is not None for proposals in self.proposals.values()]
        return sum(known) / max(len(known), 1) if self.snaps else 1.0
