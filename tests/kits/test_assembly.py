"""Assemblies: plans keep their bounds, plates never intersect, and the checks find every fault that they name."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, reduce
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import Manifold
from numpy.typing import ArrayLike

from kit1000.errors import Redraw
from kit1000.kits.assembly import (
    GROUND_GAP,
    AssemblyPlan,
    SidePlate,
    build_assembly,
    cavity_box,
    check_assembly,
    draw_assembly,
    place_kits,
    world_tilts,
)
from kit1000.kits.brackets import PLATE_OVERLAP, RIB_WIDTH, support_pieces
from kit1000.kits.kit import PLATE_GAP
from kit1000.mesh import Mesh, body_count, defect_float32, mesh_from_solid, solid_from_mesh
from kit1000.pose import Pose
from kit1000.values import Assembly, Mount, Part
from tests.samples.exact_offset import swept_solid
from tests.samples.kits import QUICK, sample_kit, sample_part

DEGREE = np.pi / 180
ROUNDING = 60e-9  # [m] rounding of the union's vertices moves a surface by no more


def parts() -> dict[str, Part]:
    return {family: sample_part(family) for family in QUICK}


@cache
def drawn(seed: int, kits: int = 5) -> Assembly:
    """An assembly of quick kits in the order of the seed."""
    rng = np.random.default_rng(seed)
    chosen = [sample_kit(family) for family in rng.permutation(QUICK)[:kits]]
    return build_assembly(f"a{seed}", chosen, draw_assembly(rng, kits))


def block(mount: Mount, shrunk: float = 0.0) -> Manifold:
    """The full plate of a mount, its sides moved inwards [m]."""
    extent = mount.kit.extent
    cube = Manifold.cube(tuple(extent - 2 * shrunk), center=True).translate((0, 0, -extent[2] / 2))
    return cube.transform(mount.assembly_from_kit.matrix()[:3])


def plans(tilts: st.SearchStrategy[float]) -> st.SearchStrategy[AssemblyPlan]:
    """Any base tilt and any sides, also ones that no draw would keep."""
    sides = st.lists(st.integers(0, 3), unique=True, min_size=1, max_size=4).flatmap(
        lambda directions: st.tuples(*[tilts.map(lambda tilt, d=d: SidePlate(d, tilt)) for d in directions])
    )
    return st.builds(AssemblyPlan, st.floats(0, 20 * DEGREE), st.floats(0, 2 * np.pi), sides)


@given(st.integers(0, 2**32), st.integers(1, 5), st.booleans())
def test_draws_keep_their_bounds(seed: int, kits: int, level: bool) -> None:
    plan = draw_assembly(np.random.default_rng(seed), kits, level_base=level)
    assert plan == draw_assembly(np.random.default_rng(seed), kits, level_base=level)
    assert len(plan.sides) == kits - 1
    assert len({side.direction for side in plan.sides} & {0, 1, 2, 3}) == kits - 1
    assert plan.base_tilt == 0 if level else 0 <= plan.base_tilt <= 20 * DEGREE
    assert all(10 * DEGREE <= side.tilt <= 45 * DEGREE for side in plan.sides)
    assert world_tilts(plan).max() <= 45 * DEGREE


def test_draws_use_the_whole_range() -> None:
    drawn_plans = [draw_assembly(np.random.default_rng(seed), 2) for seed in range(400)]
    tilts = np.array([plan.sides[0].tilt for plan in drawn_plans])
    assert tilts.min() < 11 * DEGREE
    assert tilts.max() > 44 * DEGREE
    assert {plan.sides[0].direction for plan in drawn_plans} == {0, 1, 2, 3}


@given(plans(st.floats(0, 45 * DEGREE)))
def test_world_tilts_are_those_of_the_mounts(plan: AssemblyPlan) -> None:
    mounts = place_kits([sample_kit("foot")] * (1 + len(plan.sides)), plan)
    up = np.array([mount.assembly_from_kit.rotate((0, 0, 1))[2] for mount in mounts])
    np.testing.assert_allclose(np.cos(world_tilts(plan)), up, atol=1e-12)
    assert np.abs(mounts[0].assembly_from_kit.xyz[:2]).max() < 1e-15


@given(plans(st.one_of(st.just(45 * DEGREE), st.floats(10 * DEGREE, 45 * DEGREE))))
def test_plates_never_intersect(plan: AssemblyPlan) -> None:
    mounts = place_kits([sample_kit("foot")] * (1 + len(plan.sides)), plan)
    blocks = [block(mount) for mount in mounts]
    assert all((a ^ b).is_empty() for a, b in combinations(blocks, 2))
    for side in blocks[1:]:  # the lower edges are the nearest
        assert abs(blocks[0].min_gap(side, 0.01) - PLATE_GAP) < 1e-9
    assert abs(min(solid.bounding_box()[2] for solid in blocks) - GROUND_GAP) < 1e-12


@given(plans(st.floats(10 * DEGREE, 45 * DEGREE)).filter(lambda plan: world_tilts(plan).max() <= 45 * DEGREE))
def test_supports_are_convex_overlap_the_plates_and_no_cavity(plan: AssemblyPlan) -> None:
    mounts = place_kits([sample_kit("foot")] * (1 + len(plan.sides)), plan)
    pieces = support_pieces(mounts)
    cores = [block(mount, PLATE_OVERLAP * (1 + 1e-6)) for mount in mounts]
    for piece in pieces:
        assert abs(piece.hull().volume() - piece.volume()) < 1e-6 * piece.volume()
        assert all((piece ^ core).volume() < 1e-15 for core in cores)
        assert piece.bounding_box()[2] >= 0
    blocks = [block(mount) for mount in mounts]
    brackets = pieces[-2 * len(plan.sides) :: 2]
    for bracket, side in zip(brackets, blocks[1:], strict=True):
        assert (bracket ^ blocks[0]).volume() > 1e-7
        assert (bracket ^ side).volume() > 1e-7


@given(plans(st.floats(10 * DEGREE, 45 * DEGREE)).filter(lambda plan: world_tilts(plan).max() <= 45 * DEGREE))
def test_no_wall_is_thinner_than_three_millimetres(plan: AssemblyPlan) -> None:
    mounts = place_kits([sample_kit("foot")] * (1 + len(plan.sides)), plan)
    for piece in support_pieces(mounts):
        if piece.bounding_box()[2] > 0:
            continue  # a bracket hangs between plates
        outline = piece.slice(1e-3).to_polygons()[0]
        along = np.roll(outline, -1, axis=0) - outline
        normals = np.stack([-along[:, 1], along[:, 0]], 1) / np.linalg.norm(along, axis=1, keepdims=True)
        thinnest = np.ptp(outline @ normals.T, axis=0).min()
        assert thinnest > RIB_WIDTH * np.cos(45 * DEGREE) - 1e-8 > 3e-3  # sections are rounded


@pytest.mark.parametrize(("seed", "kits"), [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 5)])
def test_built_assemblies_pass_their_checks_and_are_the_union(seed: int, kits: int) -> None:
    assembly = drawn(seed, kits)
    check_assembly(assembly, parts())
    assert defect_float32(assembly.mesh) is None
    assert body_count(assembly.mesh) == 1
    np.testing.assert_array_equal(assembly.mesh.vertices, assembly.mesh.rounded_float32().vertices)
    assert assembly.mesh.bounds[0, 2] == 0
    whole = solid_from_mesh(assembly.mesh)
    plates = [solid_from_mesh(mount.kit.mesh.moved(mount.assembly_from_kit)) for mount in assembly.mounts]
    assert all((plate - whole).volume() < ROUNDING * plate.surface_area() for plate in plates)
    # one by one, because this union is the one thing that the builder trusts
    union = reduce(lambda a, b: a + b, [*plates, *support_pieces(assembly.mounts)])
    assert abs(union.volume() - whole.volume()) < ROUNDING * whole.surface_area()


@pytest.mark.parametrize("seed", [4])
def test_swept_parts_meet_nothing_on_their_way_out(seed: int) -> None:
    """The checks use closed-form contact; the exact solids of what the parts sweep must agree."""
    assembly = drawn(seed)
    seats = {m.kit.id: m.assembly_from_kit @ m.kit.slot.kit_from_part for m in assembly.mounts}
    standing = {i: solid_from_mesh(sample_part(i).mesh.moved(pose)) for i, pose in seats.items()}
    for mount in assembly.mounts:
        own = mount.kit.id
        axis = mount.kit.slot.kit_from_part.inverse().rotate((0, 0, 1))
        swept = swept_solid(sample_part(own).mesh, axis).transform(seats[own].matrix()[:3])
        others = [solid for i, solid in standing.items() if i != own]
        assert all(
            (swept ^ solid).volume() < ROUNDING * swept.surface_area()
            for solid in [solid_from_mesh(assembly.mesh), *others]
        )


def with_solid(assembly: Assembly, change: Manifold) -> Assembly:
    """The assembly with something added to its mesh."""
    return replace(assembly, mesh=mesh_from_solid(solid_from_mesh(assembly.mesh) + change).rounded_float32())


def cube_at(centre: ArrayLike, size: tuple[float, float, float]) -> Manifold:
    return Manifold.cube(size, center=True).translate(np.asarray(centre))


def floor_of(mount: Mount) -> np.ndarray:
    """(3,) a point of a cavity's floor, in the assembly frame."""
    slot = mount.kit.slot
    return mount.assembly_from_kit.apply(slot.kit_from_part.xyz * (1, 1, 0) - (0, 0, slot.depth))


def test_a_pin_in_a_cavity_is_caught() -> None:
    assembly = drawn(3, 4)
    with pytest.raises(Redraw, match="cavity touched"):
        check_assembly(with_solid(assembly, cube_at(floor_of(assembly.mounts[2]), (3e-3, 3e-3, 8e-3))), parts())


def test_a_hole_in_a_plate_is_caught() -> None:
    assembly = drawn(3, 4)
    hole = solid_from_mesh(assembly.mesh) - cavity_box(assembly.mounts[0])  # all that stands beside its cavity
    with pytest.raises(Redraw, match="plate not whole"):
        check_assembly(replace(assembly, mesh=mesh_from_solid(hole).rounded_float32()), parts())


def test_a_bar_over_a_slot_is_caught() -> None:
    assembly = drawn(1, 2)
    posts = [cube_at((0, y, 0.04), (6e-3, 6e-3, 0.1)) for y in (-0.045, 0.045)]
    bar = posts[0] + posts[1] + cube_at((0, 0, 0.085), (6e-3, 0.1, 6e-3))
    over_base = bar.transform(assembly.mounts[0].assembly_from_kit.matrix()[:3])
    with pytest.raises(Redraw, match=r"insertion path blocked$"):
        check_assembly(with_solid(assembly, over_base), parts())


def test_a_seated_part_in_the_way_is_caught() -> None:
    assembly = drawn(1, 2)
    base, side = assembly.mounts
    above = base.assembly_from_kit.apply((0, 0, 0.07))
    assembly_from_part = side.assembly_from_kit @ side.kit.slot.kit_from_part
    far = mesh_from_solid(cube_at(above, (0.01, 0.01, 0.01))).moved(assembly_from_part.inverse())
    long = replace(sample_part(side.kit.id), mesh=far)
    with pytest.raises(Redraw, match="insertion path blocked by a seated part"):
        check_assembly(assembly, {**parts(), side.kit.id: long})


def test_an_unstable_assembly_is_caught() -> None:
    assembly = drawn(1, 2)
    direction = np.array([*np.sign(assembly.mounts[1].assembly_from_kit.xyz[:2]), 0])
    corner = -direction * 0.2 + (0, 0, assembly.mounts[0].assembly_from_kit.xyz[2] - 0.015)
    with pytest.raises(Redraw, match="does not stand on its own"):
        check_assembly(with_solid(assembly, cube_at(corner, (0.35, 0.35, 0.01))), parts())


def test_a_lifted_or_open_mesh_is_caught() -> None:
    assembly = drawn(1, 2)
    lifted = assembly.mesh.moved(Pose.from_translation((0, 0, 1e-3)))
    with pytest.raises(Redraw, match="underside not at z = 0"):
        check_assembly(replace(assembly, mesh=lifted), parts())
    with pytest.raises(Redraw, match="not closed: 3 open edges"):
        check_assembly(replace(assembly, mesh=Mesh(assembly.mesh.vertices, assembly.mesh.faces[1:])), parts())


def test_cavities_side_by_side_are_caught() -> None:
    assembly = drawn(1, 2)
    base = assembly.mounts[0]
    shifted = Mount(base.kit, base.assembly_from_kit @ Pose.from_translation((0.02, 0, 0)))
    with pytest.raises(Redraw, match="cavities too close"):
        check_assembly(replace(assembly, mounts=(base, shifted)), parts())
