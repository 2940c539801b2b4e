"""Rows of JSON: every record comes back to the bit, and a missing entry is named with its place."""

from __future__ import annotations

import json
import pickle
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kit1000.dataset.geometry import JsonObject
from kit1000.dataset.json_rows import (
    Row,
    assembly_of,
    assembly_row,
    kit_of,
    kit_row,
    part_of,
    part_row,
    pose_of,
    pose_row,
)
from kit1000.errors import InputError
from kit1000.files import json_bytes
from kit1000.pose import Pose
from kit1000.symmetry import Symmetry
from kit1000.values import Assembly, FreeAxis, Kit, Mount, Part, Slot
from tests.samples.mini import l_shape
from tests.samples.strategies import directions, pose_batches, poses, vectors

MESH = l_shape()
POSITIVE = st.floats(1e-6, 1e3)
SYMMETRIES = st.one_of(
    st.just(Symmetry.none()),
    st.builds(Symmetry.cyclic, st.integers(2, 9), directions()),
    st.builds(Symmetry.free, directions()),
    st.builds(Symmetry.free_flipped, directions()),
    st.just(Symmetry.cube()),
)


@st.composite
def kits(draw: st.DrawFn) -> Kit:
    axis = FreeAxis(draw(vectors()), draw(directions())) if draw(st.booleans()) else None
    goals = draw(pose_batches(draw(st.integers(1, 4))))
    slot = Slot("part", draw(poses()), draw(POSITIVE), draw(POSITIVE), goals, axis)
    return Kit("kit", MESH, slot, np.abs(draw(vectors())))


def through_json(row: Row) -> Row:
    return json.loads(json_bytes(row))


def assert_same(one: Any, other: Any) -> None:
    """Whether all fields are equal to the bit, recursively."""
    assert type(one) is type(other)
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        assert one.shape == other.shape
        assert one.tobytes() == other.tobytes()
    elif is_dataclass(one):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    else:
        assert one == other


@given(poses())
def test_a_pose_comes_back_to_the_bit(pose: Pose) -> None:
    assert_same(pose_of(through_json(pose_row(pose))), pose)


@example(
    Symmetry.free([0.58866186, 0.58866186, 0.55403469]), 1.0, {}
)  # once an axis that changed a bit at each reading
@given(SYMMETRIES, POSITIVE, st.dictionaries(st.text(), st.floats(allow_nan=False, allow_infinity=False)))
def test_a_part_comes_back_to_the_bit(symmetry: Symmetry, mass: float, dimensions: dict[str, float]) -> None:
    part = Part("part", "family", MESH, symmetry, dimensions, mass)
    assert_same(part_of("part", through_json(part_row(part)), MESH), part)


@given(kits())
def test_a_kit_comes_back_to_the_bit(kit: Kit) -> None:
    assert_same(kit_of("kit", through_json(kit_row(kit)), MESH), kit)


@given(kits(), poses(), poses())
def test_an_assembly_comes_back_to_the_bit(kit: Kit, first: Pose, second: Pose) -> None:
    assembly = Assembly("assembly", MESH, (Mount(kit, first), Mount(kit, second)))
    assert_same(assembly_of("assembly", through_json(assembly_row(assembly)), MESH, lambda _: kit), assembly)


def test_a_row_has_the_measures_of_its_mesh() -> None:
    row = part_row(Part("part", "family", MESH, Symmetry.cyclic(2), {}, 1.0))
    assert row["volume"] == MESH.volume
    assert row["extents"] == pytest.approx([0.04, 0.03, 0.024])
    assert row["symmetry"]["name"] == "C2"


texts = st.text(max_size=4)
values = st.recursive(
    st.none() | st.booleans() | st.integers() | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=12,
)


@given(value=st.dictionaries(texts, values, max_size=4))
def test_it_holds_what_the_file_holds(value: dict[str, Any]) -> None:
    made = JsonObject(value, "file", "mend it")
    assert made == value
    assert json.dumps(made, sort_keys=True) == json.dumps(value, sort_keys=True)
    again = pickle.loads(pickle.dumps(made))
    assert again == value
    with pytest.raises(InputError, match="mend it"):
        again["a longer name"]
    assert made.get("a longer name") is None
    assert "a longer name" not in made


def test_a_missing_entry_is_named_with_its_place_at_any_depth() -> None:
    made = JsonObject({"config": {"sides": {"left": 1}}}, "data/dataset.json", "add it")
    for read, says in (
        (lambda: made["seed"], "data/dataset.json: has no 'seed'; add it"),
        (lambda: made["config"]["scale"], "data/dataset.json: config: has no 'scale'; add it"),
        (lambda: made["config"]["sides"]["right"], "data/dataset.json: config: sides: has no 'right'; add it"),
    ):
        with pytest.raises(InputError) as refused:
            read()
        assert str(refused.value) == says
