"""The turns that the rotation network tells apart: counts, reach, spacing, and which one is nearest."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.snapnet.candidates import candidates, distances, floor, nearest, super_fibonacci
from kit1000.errors import InputError
from kit1000.guesses import MAX_ANGLE
from kit1000.pose import Pose, quaternion_angle, quaternion_from_rotvec, unit_vector
from kit1000.rng import stream

COUNTS = {"ball": 391, "tilt": 391, "place": 600, "place-paper": 286}


def drawn(count: int, seed: int = 0) -> Pose:
    rng = stream(seed, "turns")
    return Pose(rng.standard_normal((count, 4)), np.zeros(3))


def apart(turns: Pose) -> float:
    """[rad] between the two nearest."""
    cosines = np.abs(turns.wxyz @ turns.wxyz.T)
    np.fill_diagonal(cosines, 0)
    return float(2 * np.arccos(cosines.max()))


@pytest.mark.parametrize("kind", COUNTS)
def test_counts_are_as_stated_and_all_differ(kind):
    turns = candidates(kind)
    assert len(turns) == COUNTS[kind]
    assert apart(turns) > np.radians(0.4)


@pytest.mark.parametrize("kind", ["ball", "tilt"])
def test_turns_about_a_guess_lie_in_its_ball_with_nothing_among_them(kind):
    angles = candidates(kind).angle()
    assert angles.max() <= MAX_ANGLE + 1e-4  # the release says 0.48 rad
    assert (angles == 0).sum() == 1


@pytest.mark.parametrize("kind", ["ball", "tilt"])
def test_with_each_turn_goes_its_inverse(kind):
    turns = candidates(kind)
    assert distances(turns, turns.inverse()).min(1).max() < 1e-7


def test_ball_is_a_body_centred_lattice():
    vectors = candidates("ball").rotvec()
    edge = np.sort(np.linalg.norm(vectors, axis=1))[1] * 2 / np.sqrt(3)
    halves = vectors * 2 / edge
    whole = np.round(halves)
    np.testing.assert_allclose(halves, whole, atol=1e-6)
    odd = whole.astype(int) % 2
    assert np.all(odd == odd[:, :1])
    assert apart(candidates("ball")) == pytest.approx(edge * np.sqrt(3) / 2, rel=0.02)


def test_tilts_turn_the_vertical_the_shortest_way_in_rings():
    vectors = candidates("tilt").rotvec()
    np.testing.assert_allclose(vectors[:, 2], 0, atol=1e-12)
    rings, sizes = np.unique(np.round(np.linalg.norm(vectors, axis=1), 9), return_counts=True)
    np.testing.assert_allclose(rings, np.linspace(0, 0.48, 6), atol=1e-8)
    assert sizes.tolist() == [1, 78, 78, 78, 78, 78]


def test_places_cover_every_yaw_and_tilt_by_45_degrees_at_most():
    turns = candidates("place")
    tilts = np.arccos(turns.rotation_matrix()[:, 2, 2])
    assert tilts.max() <= np.radians(45) + 1e-9
    yaws = 2 * np.arctan2(turns.wxyz[:, 3], turns.wxyz[:, 0])
    assert np.histogram(np.mod(yaws, 2 * np.pi), 12, (0, 2 * np.pi))[0].min() > 30


def test_the_papers_places_are_ten_degrees_apart():
    turns = candidates("place-paper")
    matrix = turns.rotation_matrix()
    assert apart(turns) >= np.radians(10) - 1e-9
    assert np.abs(np.arctan2(matrix[:, 2, 1], matrix[:, 2, 2])).max() <= np.radians(15) + 1e-9
    assert np.abs(np.arcsin(matrix[:, 2, 0])).max() <= np.radians(15) + 1e-9


def test_spiral_is_even():
    """A cap of any rotation holds its share: (a - sin a) / pi of all within an angle a."""
    spiral = super_fibonacci(4096)
    reach = 1.0
    share = (reach - np.sin(reach)) / np.pi
    for middle in drawn(20).wxyz:
        inside = (2 * np.arccos(np.minimum(np.abs(spiral @ middle), 1)) <= reach).mean()
        assert inside == pytest.approx(share, rel=0.1)


def test_floors_are_as_the_reference_has_them():
    assert np.degrees(floor("tilt", 4000).mean) == pytest.approx(1.45, abs=0.05)
    assert np.degrees(floor("tilt", 4000).most) == pytest.approx(2.9, abs=0.1)
    ball = floor("ball", 4000)
    assert np.degrees(ball.mean) < 2.75
    assert np.degrees(ball.most) < 7.2
    assert floor("tilt", 4000, errors="ball").mean > 2 * ball.mean  # no twist among them
    assert np.degrees(floor("place", 4000).mean) < 8


def test_nearest_is_what_brute_force_finds():
    turns, right = candidates("tilt"), drawn(3)
    index, found = nearest(turns, right)
    brute = quaternion_angle(turns.wxyz[:, None], right.wxyz[None]).min(1)
    np.testing.assert_allclose(found, brute, atol=1e-9)
    assert index == brute.argmin()


def test_nearest_about_a_free_axis_is_the_least_of_a_dense_sweep():
    turns, right = drawn(20, 1), drawn(2, 2)
    axis = unit_vector(np.array([0.3, -0.5, 0.9]))
    sweep = quaternion_from_rotvec(np.linspace(0, 2 * np.pi, 3601)[:, None] * axis)
    turned = Pose(sweep, np.zeros(3))[:, None] @ right
    brute = quaternion_angle(turns.wxyz[:, None], turned.wxyz.reshape(-1, 4)[None]).min(1)
    found = nearest(turns, right, axis)[1]
    assert np.all(found <= brute + 1e-9)
    np.testing.assert_allclose(found, brute, atol=2e-3)


def test_a_right_turn_is_found_at_no_distance():
    turns = candidates("ball")
    index, found = nearest(turns, turns[[7, 300]])
    assert index in (7, 300)
    assert found[[7, 300]].max() < 1e-7
    spun = Pose.from_rotvec([0, 0, 1.2]) @ turns[[7]]
    assert nearest(turns, spun, np.array([0.0, 0, 1]))[1][7] < 1e-7


def test_an_unknown_kind_is_refused():
    with pytest.raises(InputError, match=r"candidates: .*ball"):
        candidates("bal")  # type: ignore[arg-type]
