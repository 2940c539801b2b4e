"""The distance of poses by surface: a metric up to symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold

from kit1000.labelling.scene_registration import ShapeDistance
from kit1000.mesh import mesh_from_solid
from kit1000.pose import Pose

BOX = ShapeDistance(mesh_from_solid(Manifold.cube((0.05, 0.03, 0.01), center=True)))
HERE = Pose.from_rotvec((0.3, -0.4, 1.0), (0.1, 0.2, 0.7))


@pytest.mark.parametrize("axis", np.eye(3))
def test_a_half_turn_of_a_box_is_no_distance(axis: np.ndarray) -> None:
    assert BOX.between(HERE, HERE @ Pose.from_rotvec(np.pi * axis)) < 0.3e-3


@settings(max_examples=20)
@given(st.floats(2e-3, 2e-2))
def test_a_shift_along_the_thin_side_is_its_distance(shift: float) -> None:
    moved = HERE @ Pose.from_translation((0.0, 0.0, shift))
    assert abs(BOX.between(HERE, moved) - shift) < 1e-3
    assert abs(BOX.between(moved, HERE) - shift) < 1e-3


def test_a_quarter_turn_is_a_distance() -> None:
    assert BOX.between(HERE, HERE @ Pose.from_rotvec((0.0, 0.0, np.pi / 2))) > 5e-3
