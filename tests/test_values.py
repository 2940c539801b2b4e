"""Values are frozen, hold read-only copies, and reject invalid fields with the expected and the actual value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest

from kit1000.camera import Camera
from kit1000.errors import ShapeError
from kit1000.mesh import mesh_from_solid
from kit1000.pose import Pose
from kit1000.symmetry import Symmetry
from kit1000.values import (
    ASSEMBLY_LABEL,
    FIRST_PART_LABEL,
    Body,
    FreeAxis,
    Kit,
    LabelledDepth,
    Part,
    Prediction,
    Query,
    Scene,
    Slot,
    Truth,
    View,
)
from tests.samples.shapes import box, standing

MESH = mesh_from_solid(standing(box(30, 20, 10)))
POSE = Pose.identity()
CAMERA = Camera(8, 6, 10.0, 10.0, 3.5, 2.5)


def part(**changes: Any) -> Part:
    return Part(**{"id": "p", "family": "f", "mesh": MESH, "symmetry": Symmetry.none(), "dimensions": {"d": 3.0},
                   "mass": 0.01, **changes})  # fmt: skip


def slot(**changes: Any) -> Slot:
    return Slot(**{"part_id": "p", "kit_from_part": POSE, "clearance": 2.5e-3, "depth": 6e-3,
                   "goals": Pose.stack([POSE]), **changes})  # fmt: skip


def kit(**changes: Any) -> Kit:
    return Kit(**{"id": "k", "mesh": MESH, "slot": slot(), "extent": np.array([0.099, 0.099, 0.022]), **changes})


def view(**changes: Any) -> View:
    return View(**{"camera": CAMERA, "world_from_camera": POSE, "depth": np.ones((6, 8), np.float32), **changes})


def image(**changes: Any) -> LabelledDepth:
    return LabelledDepth(**{"view": view(), "labels": np.zeros((6, 8), np.uint8), **changes})


def query(**changes: Any) -> Query:
    return Query(**{"id": "q", "scene_id": "s", "track": "snap", "sensor": "ideal", "part": 1, "drawn": True,
                    "pivot": np.zeros(3), "guess": POSE, "read_image": image, **changes})  # fmt: skip


def prediction(**changes: Any) -> Prediction:
    return Prediction(**{"query_id": "q", "goal_from_now": POSE, "confidence": 0.5, "seconds": 1.0, **changes})


def truth(**changes: Any) -> Truth:
    return Truth(**{"query_id": "q", "assembly_id": "a", "part_id": "p", "family": "f", "rest_mode": "upright",
                    "kits": 3, "visible": 0.9, "anchor": np.zeros(3), "world_from_part": POSE, "world_from_kit": POSE,
                    "slot": slot(), "goal_drawn": POSE, **changes})  # fmt: skip


def free_axis(**changes: Any) -> FreeAxis:
    return FreeAxis(**{"point": np.zeros(3), "direction": np.array([0.0, 0.0, 1.0]), **changes})


def scene(**changes: Any) -> Scene:
    return Scene(**{"id": "s", "bodies": (Body("p", POSE),), **changes})


MAKERS: list[Callable[..., Any]] = [part, slot, kit, view, image, query, prediction, truth, free_axis, scene]


@pytest.mark.parametrize("make", MAKERS)
def test_values_are_frozen(make: Callable[..., Any]) -> None:
    value = make()
    for name in value.__dataclass_fields__:
        with pytest.raises(FrozenInstanceError):
            setattr(value, name, None)


@pytest.mark.parametrize(
    ("make", "name", "array"),
    [
        (kit, "extent", np.array([0.1, 0.1, 0.022])),
        (view, "depth", np.ones((6, 8), np.float32)),
        (image, "labels", np.zeros((6, 8), np.uint8)),
        (query, "pivot", np.zeros(3)),
        (truth, "anchor", np.zeros(3)),
        (free_axis, "point", np.zeros(3)),
        (free_axis, "direction", np.array([1.0, 0.0, 0.0])),
    ],
)
def test_arrays_are_read_only_copies(make: Callable[..., Any], name: str, array: np.ndarray) -> None:
    before = array.copy()
    held = getattr(make(**{name: array}), name)
    array[...] = 1 - array
    assert np.array_equal(held, before)
    with pytest.raises(ValueError, match="read-only"):
        held[...] = 0


@pytest.mark.parametrize(
    ("make", "changes", "message"),
    [
        (kit, {"extent": np.zeros(2)}, r"extent: expected .*\(3,\), got shape \(2,\)"),
        (kit, {"extent": np.array([0.1, np.inf, 0.1])}, "extent"),
        (view, {"depth": np.ones((8, 6))}, r"depth: expected .*\(6, 8\), got shape \(8, 6\)"),
        (image, {"labels": np.zeros((6, 7), np.uint8)}, r"labels: expected .*\(6, 8\), got shape \(6, 7\)"),
        (image, {"labels": np.full((6, 8), 0.5)}, r"labels: expected uint8 .*, which is no uint8"),
        (query, {"pivot": np.zeros((1, 3))}, r"pivot: expected .*\(3,\), got shape \(1, 3\)"),
        (truth, {"anchor": np.zeros(4)}, r"anchor: expected .*\(3,\), got shape \(4,\)"),
        (free_axis, {"direction": np.array([0, 0, 2.0])}, "direction: expected a unit vector, got length 2"),
        (free_axis, {"point": np.array([0, np.nan, 0])}, "point"),
        (slot, {"goals": POSE}, r"goals: expected a batch of shape \(n,\), n >= 1, got \(\)"),
        (slot, {"clearance": 0.0}, "clearance: expected a finite number above 0, got 0.0"),
        (slot, {"depth": float("nan")}, "depth: expected a finite number above 0, got nan"),
        (part, {"mass": -1.0}, "mass: expected a finite number above 0, got -1.0"),
        (prediction, {"confidence": 1.5}, "confidence of q: expected 0 to 1, got 1.5"),
        (prediction, {"confidence": float("nan")}, "confidence of q: expected 0 to 1, got nan"),
    ],
)
def test_errors_state_the_expected_and_the_actual_value(
    make: Callable[..., Any], changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ShapeError, match=message):
        make(**changes)


def test_dimensions_are_a_read_only_copy() -> None:
    dimensions = {"d": 3.0}
    made = part(dimensions=dimensions)
    dimensions["d"] = 4.0
    assert made.dimensions["d"] == 3.0
    with pytest.raises(TypeError):
        made.dimensions["d"] = 5.0  # pyright: ignore[reportIndexIssue]


def test_a_query_reads_its_images_once_and_on_first_use() -> None:
    looks = []
    labels = np.zeros((6, 8), np.uint8)
    labels[1:3], labels[4, 2:5] = ASSEMBLY_LABEL, FIRST_PART_LABEL + 1

    def read() -> LabelledDepth:
        looks.append(image(labels=labels))
        return looks[-1]

    asked = query(part=1, read_image=read)
    assert not looks
    assert asked.view is asked.view is looks[0].view
    assert np.argwhere(asked.part_mask).tolist() == [[4, 2], [4, 3], [4, 4]]
    assert asked.kit_region.sum() == 16
    assert asked.kit_region[1:3].all()
    assert not query(part=0, read_image=read).part_mask.any()
    assert len(looks) == 2
