"""Families of parts: each keeps the rules, symmetries are declared exactly, and near-duplicates are found."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import Manifold

from kit1000.errors import Redraw
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.parts.cad import at, box, cylinder, join, tube
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.parts.mixtures import MIXTURES, choose_family
from kit1000.parts.near_duplicates import MIN_DIFFERENCE, near_duplicate_of, power, shape_measures
from kit1000.symmetry import Symmetry
from kit1000.testing import check_family, check_symmetry, families
from kit1000.values import Part
from tests.samples.mini import l_shape
from tests.samples.strategies import vectors

SEEDS = range(3)
WEIGHTS = MIXTURES["2026"]


@pytest.mark.parametrize("name", FAMILIES)
def test_family_conforms(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(families, "SURFACE_SAMPLES", 60)
    check_family(FAMILIES[name], SEEDS, name)


@pytest.mark.parametrize("name", FAMILIES)
def test_two_draws_differ(name: str) -> None:
    one, other = (FAMILIES[name].draw(np.random.default_rng(seed)).solid() for seed in (10, 11))
    assert abs(one.volume() - other.volume()) > 1.0


@pytest.mark.parametrize("name", FAMILIES)
def test_part_sits_at_its_centroid_on_the_float32_grid(name: str) -> None:
    part = make_part("p0", name, FAMILIES[name].draw(np.random.default_rng(5)), 0.04)
    assert np.abs(part.mesh.centroid).max() < 1e-7
    assert part.mesh.extents.max() == pytest.approx(0.04, abs=1e-8)
    assert np.array_equal(part.mesh.vertices, part.mesh.vertices.astype(np.float32))
    assert part.mass == pytest.approx(1240 * part.mesh.volume)


@pytest.mark.parametrize("mixture", MIXTURES)
def test_a_mixture_weighs_families_of_the_catalog(mixture: str) -> None:
    assert set(MIXTURES[mixture]) <= set(FAMILIES)
    assert min(MIXTURES[mixture].values()) > 0


def test_choice_follows_the_weights() -> None:
    drawn = [choose_family(7, "part", index, weights=WEIGHTS) for index in range(700)]
    total = sum(WEIGHTS.values())
    for name, weight in WEIGHTS.items():
        share = weight / total
        assert abs(drawn.count(name) / len(drawn) - share) < 5 * np.sqrt(share / len(drawn))


@dataclass(frozen=True)
class Given:
    """A family of one part: the solid and symmetry of a test."""

    body: Manifold
    declared: Symmetry

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Given:
        return cls(cylinder(10, 10), Symmetry.none())

    def solid(self) -> Manifold:
        return self.body

    def symmetry(self) -> Symmetry:
        return self.declared


def _part(solid: Manifold, symmetry: Symmetry) -> Part:
    return make_part("p", "given", Given(solid, symmetry))


PINNED = join(box(20, 20, 10), at(cylinder(2, 2), 5, 0, 10))
GABLE = join(box(20, 10, 30), at(box(10, 4, 5), 5, 3, 0), at(box(10, 4, 5), 5, -3, 0), at(box(4, 6, 4), 10, 0, 20))


@pytest.mark.parametrize(
    ("solid", "declared", "fault"),
    [
        (box(10, 20, 30), Symmetry.dihedral(2), None),
        (tube(20, 10, 30), Symmetry.free_flipped(), None),
        (GABLE, Symmetry.none(), None),  # a mirror image needs no declaration
        (box(10, 10.2, 30), Symmetry.cyclic(4), "is declared but moves the surface by 0"),
        (PINNED, Symmetry.cyclic(2), "is declared but"),
        (box(10, 10, 30), Symmetry.free(), "is declared but"),
        (box(10, 20, 30), Symmetry.none(), "not declared"),
    ],
)
def test_a_symmetry_must_be_declared_exactly(solid: Manifold, declared: Symmetry, fault: str | None) -> None:
    with nullcontext() if fault is None else pytest.raises(AssertionError, match=fault):
        check_symmetry(_part(solid, declared))


@pytest.mark.parametrize(
    ("drawn", "reason"),
    [
        (Manifold, "no solid"),
        (lambda: join(box(5, 5, 5), at(box(5, 5, 5), 20)), "several bodies"),
        (lambda: box(40, 40, 0.5), "too thin"),
    ],
)
def test_drawing_that_is_no_part_is_redrawn(drawn: Callable[[], Manifold], reason: str) -> None:
    with pytest.raises(Redraw) as caught:
        _part(drawn(), Symmetry.none())
    assert caught.value.reason == reason


SIDES = st.floats(0.2, 5)


def block(x: float, y: float, z: float) -> Mesh:
    return mesh_from_solid(Manifold.cube((x, y, z)))


@given(SIDES, SIDES, SIDES)
def test_the_measures_of_a_box_are_known(a: float, b: float, c: float) -> None:
    short, middle, long = sorted((a, b, c))
    area = 2 * (a * b + b * c + c * a) / (a * b * c) ** (2 / 3)
    assert shape_measures(block(a, b, c)) == pytest.approx([1, 1, middle / long, short / long, area], rel=1e-9)


@given(st.floats(1e-3, 1e3), vectors(5.0), st.permutations([0, 1, 2]))
def test_measures_do_not_depend_on_size_position_and_order_of_axes(
    size: float, shift: np.ndarray, axes: list[int]
) -> None:
    mesh = l_shape()
    turned = mesh.vertices[:, axes] * size + shift * size
    even = np.linalg.det(np.eye(3)[axes]) > 0
    moved = Mesh(turned, mesh.faces if even else mesh.faces[:, ::-1])
    assert shape_measures(moved) == pytest.approx(shape_measures(mesh), rel=1e-7)
    assert near_duplicate_of(shape_measures(moved), shape_measures(mesh)[None]) == 0


def test_the_first_part_that_agrees_in_all_measures_is_returned() -> None:
    measures = np.array([0.5, 0.6, 0.7, 0.8, 9.0])
    others = measures * (1 + MIN_DIFFERENCE * np.array([[1.2, 0, 0, 0, 0], [0.9] * 5, [0] * 5]))
    assert near_duplicate_of(measures, others) == 1
    assert near_duplicate_of(measures, others[:1]) is None
    assert near_duplicate_of(measures, np.zeros((0, 5))) is None


@given(st.floats(1e-8, 1e3), st.sampled_from([2 / 3, 1 / 3, 0.5, 2.0]))
def test_powers_are_correctly_rounded(base: float, exponent: float) -> None:
    with localcontext() as context:
        context.prec = 60
        exact = (Decimal(exponent) * Decimal(base).ln()).exp()
        rounded = power(base, exponent)
        beside = [float(np.nextafter(rounded, to)) for to in (0.0, np.inf)]
        assert all(abs(Decimal(rounded) - exact) <= abs(Decimal(other) - exact) for other in beside)


def test_powers_of_squares_and_cubes_are_exact() -> None:
    assert [power(49.0, 0.5), power(3.0, 4.0), power(1.0, 2 / 3)] == [7.0, 81.0, 1.0]
