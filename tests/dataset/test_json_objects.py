"""JSON objects: all that a dict does, and a missing entry is one line."""

from __future__ import annotations

import json
import pickle
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.dataset.geometry import JsonObject
from kit1000.errors import InputError

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
