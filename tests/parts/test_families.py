"""Every part family passes the conformance check, and the check catches faulty families."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np
import pytest
from manifold3d import Manifold

from kit1000.errors import Redraw
from kit1000.mesh import mesh_from_solid
from kit1000.parts.cad import at, box, cylinder, join, tube
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.parts.mixtures import MIXTURES, choose_family
from kit1000.symmetry import Symmetry
from kit1000.testing import check_family, check_symmetry, families, surface_distances
from kit1000.values import Part

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


def test_one_more_weight_changes_only_the_parts_that_its_family_wins() -> None:
    fewer = {name: weight for name, weight in WEIGHTS.items() if name != "bracket"}
    before = [choose_family(3, index, weights=fewer) for index in range(150)]
    after = [choose_family(3, index, weights=WEIGHTS) for index in range(150)]
    assert {new for old, new in zip(before, after, strict=True) if old != new} == {"bracket"}


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


def test_distance_from_a_ball_is_that_from_its_centre() -> None:
    ball = mesh_from_solid(Manifold.sphere(10, 64)).scaled(1e-3)
    points = np.random.default_rng(0).normal(size=(50, 3)) * 0.02
    expected = np.abs(np.linalg.norm(points, axis=1) - 0.01)
    assert np.abs(surface_distances(points, ball) - expected).max() < 0.08e-3  # facets
