"""Layouts of scenes: stated shares and places, parts at rest, crowds that never intersect, independent draws."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import CrossSection, FillRule
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from kit1000.errors import Redraw
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim import layout as module
from kit1000.sim.crowding import GAPS, STOP, TOUCHING, draw_crowding, pushed_together
from kit1000.sim.footprints import centroid, footprint, footprint_distance
from kit1000.sim.layout import (
    DROP_BOUNDS,
    KITS_RADIUS,
    MAX_PART_RADIUS,
    MIN_GAP,
    PARTS_BOUNDS,
    TUMBLED,
    UPRIGHT,
    Layout,
    LayoutDraw,
    draw_layout,
    draw_rest_modes,
    simulate_layout,
    systematic_rest_modes,
)
from kit1000.sim.settle import POSE_GRID, RestPose
from kit1000.values import Assembly, Part, Slot
from tests.samples.kits import sample_kit, sample_part
from tests.samples.shapes import as_part, box

FAMILIES = ("bracket", "channel", "tee", "cover")


@cache
def sample_assembly(n: int = 3) -> Assembly:
    """The kits of the first n families, the base tilted, the others joined to it."""
    sides = tuple(SidePlate(k, 0.3 + 0.1 * k) for k in range(n - 1))
    return build_assembly("a", [sample_kit(family) for family in FAMILIES[:n]], AssemblyPlan(0.2, 0.7, sides))


def pairs(n: int = 3) -> list[tuple[Part, Slot]]:
    return [(sample_part(family), sample_kit(family).slot) for family in FAMILIES[:n]]


@cache
def first_layout(seed: int, n: int = 3) -> tuple[LayoutDraw, Layout]:
    """The first layout of a seed that is not redrawn."""
    for attempt in range(20):
        rng = stream(seed, attempt)
        draw = draw_layout(rng, draw_rest_modes(rng, n))
        try:
            return draw, simulate_layout(sample_assembly(n), pairs(n), draw)
        except Redraw:
            continue
    raise AssertionError("twenty layouts were rejected")


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_each_part_is_upright_with_a_share_of_exactly_six_tenths(n: int) -> None:
    """The mode changes at multiples of 0.2 of the offset, so the midpoints of fifths integrate over it exactly."""
    upright = np.array([[mode == UPRIGHT for mode in systematic_rest_modes((k + 0.5) / 5, n)] for k in range(5)])
    assert upright.mean(0) == pytest.approx(np.full(n, 0.6), abs=1e-12)
    assert (np.abs(upright.sum(1) - 0.6 * n) < 1).all()
    if n >= 2:
        assert upright.any(1).all()


@given(seed=st.integers(0, 2**32), n=st.integers(1, 5))
def test_drop_points_separate_parts_of_any_rotation(seed: int, n: int) -> None:
    points = draw_layout(stream(seed), (TUMBLED,) * n).drop_points
    assert ((points >= DROP_BOUNDS[0]) & (points <= DROP_BOUNDS[1])).all()
    assert pdist(points).min(initial=np.inf) >= 2 * MAX_PART_RADIUS + MIN_GAP
    assert points[:, 1].max() + MAX_PART_RADIUS < -MIN_GAP


def test_the_same_stream_draws_the_same_numbers_for_all_modes() -> None:
    once, again = draw_layout(stream(4), (UPRIGHT, TUMBLED)), draw_layout(stream(4), (TUMBLED, TUMBLED))
    assert once.drop_points.tobytes() == again.drop_points.tobytes()
    assert once.tumbled_rotations.tobytes() == again.tumbled_rotations.tobytes()
    assert once.assembly_yaw == again.assembly_yaw


def test_a_layout_of_another_scale_is_the_same_draw_with_other_lengths() -> None:
    one, other = (draw_layout(stream(4), (UPRIGHT, TUMBLED), scale=scale) for scale in (1.0, 1.4))
    assert other.drop_points == pytest.approx(1.4 * one.drop_points)
    assert other.yaws.tobytes() == one.yaws.tobytes()
    part = as_part(box(60, 60, 60))
    simulate_layout(sample_assembly(), [(part, pairs()[0][1])], draw_layout(stream(0), (UPRIGHT,), scale=1.4))


@given(seed=st.integers(0, 1000))
def test_all_bodies_are_on_their_halves_and_separate(seed: int) -> None:
    _, layout = first_layout(seed)
    outlines = [footprint(part.mesh, pose) for (part, _), pose in zip(pairs(), layout.world_from_parts, strict=True)]
    sections = [CrossSection([outline], FillRule.NonZero) for outline in outlines]
    for i, outline in enumerate(outlines):
        assert ((outline >= PARTS_BOUNDS[0]) & (outline <= PARTS_BOUNDS[1])).all()
        grown = sections[i].offset(MIN_GAP * (1 - 1e-3), circular_segments=256)
        assert not any((grown ^ other).area() > 1e-12 for other in sections[:i])
    kits = layout.world_from_assembly.apply(sample_assembly().mesh.vertices)
    assert kits[:, 1].min() >= MIN_GAP
    assert np.abs(kits[:, 0]).max() < KITS_RADIUS
    assert abs(kits[:, 2].min()) < 1e-12


@given(seed=st.integers(0, 1000))
def test_upright_parts_rest_as_they_are_inserted_at_the_drawn_yaw_and_point(seed: int) -> None:
    draw, layout = first_layout(seed)
    for i, (part, slot) in enumerate(pairs()):
        if draw.modes[i] == UPRIGHT:
            world_from_part = layout.world_from_parts[i]
            expected = Pose.from_rotvec([0, 0, draw.yaws[i]]) @ slot.kit_from_part
            assert np.degrees((world_from_part.inverse() @ expected).angle()) < 1
            assert world_from_part.apply(part.mesh.bounds.mean(0))[:2] == pytest.approx(draw.drop_points[i], abs=1.5e-3)


@given(seed=st.integers(0, 1000))
def test_parts_are_pushed_together_as_they_came_to_rest(seed: int) -> None:
    draw, apart = first_layout(seed)
    together = simulate_layout(sample_assembly(), pairs(), replace(draw, crowding=draw_crowding(stream(seed), 3)))
    outlines = []
    for (part, _), pose, before in zip(pairs(), together.world_from_parts, apart.world_from_parts, strict=True):
        assert pose.wxyz == pytest.approx(before.wxyz, abs=1.1 * POSE_GRID)
        assert pose.xyz[2] == pytest.approx(before.xyz[2], abs=1e-12)
        outlines.append(footprint(part.mesh, pose))
        assert ((outlines[-1] >= PARTS_BOUNDS[0] - 1e-6) & (outlines[-1] <= PARTS_BOUNDS[1] + 1e-6)).all()
    sections = [CrossSection([outline], FillRule.NonZero) for outline in outlines]
    for i, section in enumerate(sections):
        others = [other for k, other in enumerate(sections) if k != i]
        assert not any((section ^ other).area() > 0 for other in others)
        near = section.offset(GAPS[1] + 1e-4, circular_segments=256)
        assert any((near ^ other).area() > 0 for other in others)


def test_a_crowded_draw_is_the_uncrowded_one_and_more() -> None:
    one, other = (draw_layout(stream(4), (UPRIGHT, TUMBLED), crowded) for crowded in (False, True))
    assert one.crowding is None
    assert other.crowding is not None
    assert other.drop_points.tobytes() == one.drop_points.tobytes()
    assert other.assembly_yaw == one.assembly_yaw


@given(yaw=st.floats(0, 6.28), shift=st.tuples(st.floats(-1, 1), st.floats(-1, 1)), n=st.integers(1, 4))
def test_the_kits_are_on_their_half_for_every_draw(yaw: float, shift: tuple[float, float], n: int) -> None:
    draw = replace(draw_layout(stream(0), ()), assembly_yaw=yaw, assembly_shift=np.array(shift))
    layout = simulate_layout(sample_assembly(n), [], draw)
    vertices = layout.world_from_assembly.apply(sample_assembly(n).mesh.vertices)
    assert vertices[:, 1].min() >= MIN_GAP
    assert np.abs(vertices[:, 0]).max() < KITS_RADIUS + 1e-6
    up = layout.world_from_assembly.rotation_matrix()[2]
    assert up.tolist() == [0, 0, 1]


def replace_settling(monkeypatch: pytest.MonkeyPatch, moved: Pose, stable: bool = True) -> None:
    """Replace settling by one that moves every part by `moved` in the world."""

    def settle(releases: list) -> list[RestPose]:
        return [RestPose(moved @ release.world_from_part, stable) for release in releases]

    monkeypatch.setattr(module, "settle", settle)


@pytest.mark.parametrize(
    ("moved", "stable", "mode", "reason"),
    [
        (Pose.identity(), False, TUMBLED, "part not at rest"),
        (Pose.from_translation([1.2e-3, 0, 0]), True, UPRIGHT, "part unstable"),
        (Pose.from_rotvec([0, 0.02, 0]), True, UPRIGHT, "part unstable"),
        (Pose.from_translation([0, 0.3, 0]), True, TUMBLED, "part left its half"),
        (Pose.from_translation([0.3, 0, 0]), True, TUMBLED, "part left its half"),
    ],
)
def test_redraw_reasons(monkeypatch: pytest.MonkeyPatch, moved: Pose, stable: bool, mode: str, reason: str) -> None:
    replace_settling(monkeypatch, moved, stable)
    draw = draw_layout(stream(2), (mode,) * 3)
    with pytest.raises(Redraw, match=f"^{reason}$"):
        simulate_layout(sample_assembly(), pairs(), draw)


def test_parts_that_touch_are_redrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    replace_settling(monkeypatch, Pose.identity())
    draw = draw_layout(stream(2), (UPRIGHT,) * 3)
    close = replace(draw, drop_points=np.array([[0.0, -0.2], [0.1, -0.2], [0.02, -0.2]]))
    with pytest.raises(Redraw, match=r"^parts touch$"):
        simulate_layout(sample_assembly(), pairs(), close)


REGION = np.array([[-0.19, -0.345], [0.19, -0.005]])


def outlines(seed: int, n: int) -> list[np.ndarray]:
    """Footprints of parts of 10 to 60 mm anywhere: round and square ones, slim ones, triangles."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(n):
        points = rng.standard_normal((rng.integers(3, 40), 2)) * rng.uniform(3e-3, 12e-3, 2)
        found.append(points[ConvexHull(points).vertices] + rng.uniform(-0.3, 0.3, 2))
    return found


@given(seed=st.integers(0, 100_000), n=st.integers(2, 5))
def test_parts_come_close_and_never_into_each_other(seed: int, n: int) -> None:
    apart, crowding = outlines(seed, n), draw_crowding(stream(seed), n)
    together = [o + shift for o, shift in zip(apart, pushed_together(apart, crowding, REGION), strict=True)]
    gaps = np.full((n, n), np.inf)
    for i, j in combinations(range(n), 2):
        gaps[i, j] = gaps[j, i] = footprint_distance(together[i], together[j])
    assert gaps.min() >= TOUCHING - 1e-9
    assert (gaps.min(0) <= GAPS[1] + STOP).all()
    for outline in together:
        assert ((outline >= REGION[0] - 1e-12) & (outline <= REGION[1] + 1e-12)).all()


@given(seed=st.integers(0, 100_000))
def test_of_two_parts_the_second_lies_at_its_gap_in_its_direction(seed: int) -> None:
    apart, crowding = outlines(seed, 2), draw_crowding(stream(seed), 2)
    a, b = (o + shift for o, shift in zip(apart, pushed_together(apart, crowding, REGION), strict=True))
    assert crowding.gaps[1] <= footprint_distance(a, b) <= crowding.gaps[1] + STOP
    back = b - 1e-3 * np.array([np.cos(crowding.directions[1]), np.sin(crowding.directions[1])])
    assert footprint_distance(a, back) < footprint_distance(a, b)


def test_gaps_are_drawn_from_touching_to_the_largest() -> None:
    gaps = draw_crowding(stream(0), 20_000).gaps
    assert gaps.min() == TOUCHING
    assert gaps.max() == pytest.approx(GAPS[1], rel=1e-3)
    assert (gaps == TOUCHING).mean() == pytest.approx((TOUCHING - GAPS[0]) / (GAPS[1] - GAPS[0]), abs=0.01)


def test_a_group_larger_than_its_region_is_redrawn() -> None:
    with pytest.raises(Redraw, match=r"^no room for the parts together$"):
        pushed_together(outlines(0, 5), draw_crowding(stream(0), 5), REGION / 10)


def square(side: float, at: tuple[float, float], yaw: float = 0.0) -> np.ndarray:
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * side / 2
    rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return corners @ rotation.T + at


def test_distances_of_squares_are_those_in_closed_form() -> None:
    a = square(2, (0, 0))
    assert footprint_distance(a, square(2, (5, 0.5))) == pytest.approx(3)  # edge to edge
    assert footprint_distance(a, square(2, (5, 6))) == pytest.approx(5)  # corner to corner: 3, 4, 5
    assert footprint_distance(a, square(2, (4, 0), np.pi / 4)) == pytest.approx(3 - 2**0.5)  # corner to edge
    assert footprint_distance(a, square(2, (1.5, 1.5))) == 0
    assert footprint_distance(a, square(0.5, (0, 0))) == 0  # one within the other


@given(seed=st.integers(0, 1000), share=st.floats(0.01, 0.99))
def test_a_vertex_on_a_straight_edge_moves_no_centre(seed: int, share: float) -> None:
    points = np.random.default_rng(seed).uniform(-1, 1, (8, 2))
    outline = points[ConvexHull(points).vertices]
    for k in range(len(outline)):
        between = outline[k - 1] + share * (outline[k] - outline[k - 1])
        assert centroid(np.insert(outline, k, between, axis=0)) == pytest.approx(centroid(outline), abs=1e-9)
    assert (ConvexHull(outline).equations @ [*centroid(outline), 1] < 0).all()  # within
