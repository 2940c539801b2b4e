"""Edits and their history: any operations, undone, give the first state back bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from kit1000.editor.session import LIKELY, UNTOUCHED, PartEdit, Session
from kit1000.errors import InputError
from kit1000.pose import Pose

PARTS = (0, 2, 5)
numbers = st.floats(-1, 1, allow_subnormal=False)
motions = st.builds(
    lambda rotvec, xyz: Pose.from_rotvec(np.array(rotvec), np.array(xyz)),
    st.tuples(numbers, numbers, numbers),
    st.tuples(numbers, numbers, numbers),
)
shares = st.floats(0, 1)


def same(one: Session, other: Session) -> bool:
    return one.edits.keys() == other.edits.keys() and all(
        edit.same_as(other.edits[part]) for part, edit in one.edits.items()
    )


class History(RuleBasedStateMachine):
    """Against a model that keeps every state."""

    def __init__(self) -> None:
        super().__init__()
        self.session = Session.begin(PARTS)
        self.states = [self.session]
        self.at = 0

    def adopt(self, session: Session) -> None:
        if session is not self.session:
            self.states = [*self.states[: self.at + 1], session]
            self.at += 1
            self.session = session

    @rule(part=st.sampled_from(PARTS), motion=motions, turned=st.booleans())
    def move(self, part: int, motion: Pose, turned: bool) -> None:
        self.adopt(self.session.did("move", {part: self.session.edits[part].moved(motion, turned)}))

    @rule(motion=motions, confidence=shares)
    def snap_all(self, motion: Pose, confidence: float) -> None:
        edits = {part: edit.taken(motion, confidence) for part, edit in self.session.edits.items()}
        self.adopt(self.session.did("snap", edits))

    @rule(parts=st.sets(st.sampled_from(PARTS)))
    def confirm(self, parts: set[int]) -> None:
        self.adopt(self.session.did("confirm", {part: self.session.edits[part].confirm() for part in parts}))

    @rule()
    def undo(self) -> None:
        self.session, self.at = self.session.undo(), max(self.at - 1, 0)

    @rule()
    def redo(self) -> None:
        self.session, self.at = self.session.redo(), min(self.at + 1, len(self.states) - 1)

    @invariant()
    def is_where_the_model_is(self) -> None:
        assert same(self.session, self.states[self.at])
        assert len(self.session.done) == self.at
        assert len(self.session.undone) == len(self.states) - 1 - self.at

    @invariant()
    def all_undone_is_the_beginning(self) -> None:
        session = self.session
        while session.done:
            session = session.undo()
        assert same(session, Session.begin(PARTS))


History.TestCase.settings = settings(max_examples=25, stateful_step_count=20, deadline=None)
TestHistory = History.TestCase


def test_moving_by_hand_takes_back_snap_and_confirmation() -> None:
    snapped = UNTOUCHED.taken(Pose.from_translation((0.1, 0, 0)), 0.9)
    confirmed = snapped.confirm()
    assert confirmed.state == "confirmed"
    moved = confirmed.moved(Pose.identity())
    assert (moved.state, moved.confidence) == ("free", 0.0)


def test_a_fit_below_likely_is_snapped_but_unsure() -> None:
    assert UNTOUCHED.taken(Pose.identity(), LIKELY).state == "snapped"
    assert UNTOUCHED.taken(Pose.identity(), np.nextafter(LIKELY, 0)).state == "unsure"


def test_an_operation_without_effect_leaves_no_trace() -> None:
    session = Session.begin(PARTS)
    assert session.did("move", {0: UNTOUCHED.moved(Pose.identity())}) is session
    assert session.undo() is session.redo() is session


def test_edits_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="part 1: expected one of 0, 2, 5"):
        Session.begin(PARTS).did("move", {1: UNTOUCHED})
    for confidence in (-0.1, 1.1, np.nan):
        with pytest.raises(InputError, match="confidence"):
            PartEdit(Pose.identity(), confidence=confidence)
