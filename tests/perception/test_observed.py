"""Observed parts and kits: true shapes lie between what is sure and what is possible; filled shares of cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import distance_transform_edt

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.perception.image_kinds import IDEAL
from kit1000.perception.observed.columns import MaskedView, ObservedColumns
from kit1000.perception.observed.kits import HALF_HEIGHT, ObservedKits
from kit1000.perception.observed.kits import HALF_WIDTH as KIT_HALF_WIDTH
from kit1000.perception.observed.occupancy import filled_share
from kit1000.perception.observed.parts import HALF_WIDTH, TABLE_MARGIN, ObservedPart
from kit1000.perception.observed.pixels import cropped, subpixel_points
from kit1000.pose import Pose, random_quaternions
from kit1000.sim.render import render
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, View
from kit1000.voxels import Grid, signed_distance, tsdf
from kit1000.voxels.grid import DEFAULT_TRUNCATION
from tests.samples.shapes import MM, ell, ring_plate
from tests.samples.shapes import box as drawn_box

CAMERA = Camera(width=400, height=300, fx=500.0, fy=500.0, cx=199.5, cy=149.5)
EYE = look_at((0.3, 0.2, 0.6), (0, 0, 0))
FROM_ABOVE = look_at((0, 0, 0.7), (0, 0, 0), up=(0.0, 1.0, 0.0))
PART = 2
VOXEL = 1e-3


def box(*size: float, at: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    """A box with the centre of its lower face at a point [m]."""
    body = trimesh.creation.box(size)
    return Mesh(body.vertices + np.array(at) + (0, 0, size[2] / 2), body.faces)


def observed_part(*bodies: Mesh, world_from_camera: Pose = EYE, lift: float = 0.0) -> ObservedPart:
    """Bodies that are one part, on a table at a height [m], observed by a camera."""
    table = box(2, 2, 0.1, at=(0, 0, -0.1))
    up = Pose.from_translation((0, 0, lift))
    image = render(CAMERA, world_from_camera, [(table, up), *((body, up) for body in bodies)], 1)
    labels = np.where(image.body_ids > 1, PART, 0).astype(np.uint8)
    return ObservedPart(
        LabelledDepth(View(CAMERA, world_from_camera, image.depth), labels), PART, np.array([0, 0, 0.01 + lift])
    )


def overlap(part: ObservedPart, *bodies: Mesh) -> float:
    """Intersection over union of the solid voxels."""
    volume = part.volume(VOXEL)
    truth = signed_distance(volume.grid, [(body, Pose.identity()) for body in bodies], threads=1).values < 0
    return float(((volume.values < 0) & truth).sum() / ((volume.values < 0) | truth).sum())


@pytest.mark.parametrize("world_from_camera", [EYE, FROM_ABOVE], ids=["oblique", "from above"])
def test_a_box_is_completed_to_itself(world_from_camera: Pose) -> None:
    body = box(0.03, 0.02, 0.025)
    part = observed_part(body, world_from_camera=world_from_camera)
    assert overlap(part, body) > 0.9
    volume = part.volume(VOXEL)
    assert volume.grid.shape == (84, 84, 84)
    assert 84 * VOXEL == 2 * HALF_WIDTH
    exact = signed_distance(volume.grid, [(body, Pose.identity())], threads=1).values
    near = np.abs(exact) < 0.9
    assert np.abs(volume.values - exact)[near].mean() < 0.15  # of five voxels
    np.testing.assert_allclose(part.middle[:2], 0, atol=1.5e-3)


def test_hidden_space_under_a_roof_is_solid() -> None:
    post, roof = box(0.008, 0.008, 0.02), box(0.03, 0.03, 0.005, at=(0, 0, 0.02))
    block = box(0.03, 0.03, 0.025)
    from_above = observed_part(post, roof, world_from_camera=FROM_ABOVE)
    assert overlap(from_above, block) > 0.9
    oblique = observed_part(post, roof)
    assert overlap(oblique, post, roof) < overlap(oblique, block) < 0.95  # the near side is observed to be free
    truth = signed_distance(oblique.volume(VOXEL).grid, [(post, Pose.identity()), (roof, Pose.identity())], threads=1)
    missed = (truth.values < -0.2) & (oblique.volume(VOXEL).values > 0)
    assert missed.mean() < 1e-4


ROOF = (box(0.02, 0.02, 0.03), box(0.045, 0.03, 0.006, at=(0.01, 0, 0.03)))


@pytest.mark.parametrize("bodies", [(box(0.03, 0.02, 0.025),), ROOF], ids=["a box", "a roof"])
@pytest.mark.parametrize("world_from_camera", [EYE, FROM_ABOVE], ids=["oblique", "from above"])
def test_the_true_part_lies_between_what_is_certain_and_what_is_possible(
    bodies: tuple[Mesh, ...], world_from_camera: Pose
) -> None:
    part = observed_part(*bodies, world_from_camera=world_from_camera)
    filled, sure, possible = part.bounds(VOXEL)
    np.testing.assert_array_equal(filled.values, part.volume(VOXEL).values)
    truth = signed_distance(filled.grid, [(body, Pose.identity()) for body in bodies], threads=1).values
    edge = VOXEL / (DEFAULT_TRUNCATION * VOXEL)  # pixels and voxels are decided by their centres
    assert (truth[sure.values < 0] < edge).all()
    assert (possible.values[truth < -edge] < 0).all()
    assert ((sure.values < 0) <= (possible.values < 0)).all()
    assert ((filled.values < 0) <= (possible.values < 0)).all()
    assert (sure.values < 0).sum() > 300


def test_free_space_is_measured_to_the_nearest_possible_voxel() -> None:
    """Up to the truncation, also beside the silhouette, where the image shows only that a ray passes."""
    part = observed_part(box(0.03, 0.02, 0.025), world_from_camera=FROM_ABOVE)
    possible = part.bounds(VOXEL).possible
    exact = np.asarray(distance_transform_edt(possible.values >= 0)) * VOXEL
    within = (possible.values > 0) & (exact < 4e-3)
    found = possible.values[within] * DEFAULT_TRUNCATION * VOXEL
    np.testing.assert_allclose(found, exact[within], atol=1.2 * VOXEL)


@pytest.mark.parametrize("lift", [0.0, 0.004, -0.003])
def test_the_height_of_the_table_is_read_from_the_image(lift: float) -> None:
    part = observed_part(box(0.03, 0.02, 0.025), lift=lift)
    assert part.table_height() == pytest.approx(lift, abs=1e-4)
    solid = part.volume(VOXEL).values < 0
    heights = part.volume(VOXEL).grid.centres()[solid][:, 2]
    assert heights.min() == pytest.approx(lift, abs=2 * VOXEL)


def test_a_cropped_image_gives_the_same_volume() -> None:
    part = observed_part(box(0.03, 0.02, 0.025))
    more = int(TABLE_MARGIN * CAMERA.fx / 0.5)
    rows, columns = (slice(max(index.min() - more, 0), index.max() + more) for index in np.nonzero(part.image.labels))
    smaller = replace(part, image=cropped(part.image, (rows, columns)))
    assert smaller.image.labels.size < part.image.labels.size
    np.testing.assert_allclose(smaller.volume(VOXEL).values, part.volume(VOXEL).values, atol=1e-5)


def test_distances_to_columns_are_those_of_an_exact_distance_transform() -> None:
    view = View(CAMERA, EYE, np.zeros((300, 400), np.float32))
    world_from_middle = look_at((0.1, 0, 0.2), (0, 0.05, 0))
    rng, half = np.random.default_rng(0), VOXEL / 2
    points = rng.uniform(-0.012, 0.012, (4000, 3))
    dense = points[:, 0] > 0  # and columns here and there on the other side
    points = points[dense | (np.arange(4000) < 60)]
    points_in_world = world_from_middle.apply(points)
    columns = ObservedColumns.of(
        [MaskedView(view, view.depth > 0)], points_in_world, world_from_middle, (0.01, 0.008), -5e-3, VOXEL
    )
    volume = columns.filled(largest_only=False)
    solid = np.zeros((40, 40, 16), bool)
    heights = (np.arange(16) + 0.25) * VOXEL - 8e-3  # every second of the half voxels
    for x, y, z in points:
        i, j = (int(np.floor(at / half)) + 20 for at in (x, y))
        if 0 <= i < 40 and 0 <= j < 40:
            solid[i, j] |= (heights > -5e-3) & (heights <= z)
    distances = [np.asarray(distance_transform_edt(cells, (0.5, 0.5, 1))) for cells in (~solid, solid)]
    wanted = (
        np.where(solid, -1, 1) * np.maximum(np.where(solid, distances[1], distances[0]) - 0.25, 0) / DEFAULT_TRUNCATION
    )
    np.testing.assert_array_equal(volume.values, wanted[::2, ::2].clip(-1, 1).astype(np.float32))
    assert 0.05 < (volume.values < 0).mean() < 0.5


def test_subpixel_points_lie_evenly_on_the_plane_of_each_pixel() -> None:
    floor = box(2, 2, 0.1, at=(0, 0, -0.1))
    view = View(CAMERA, EYE, render(CAMERA, EYE, [(floor, Pose.identity())], 1).depth)
    mask = np.zeros((300, 400), bool)
    mask[100:103, 200:205] = True
    points = subpixel_points(view, mask)
    assert points.shape == (3 * 5 * 16, 3)
    assert np.abs(points[:, 2]).max() < 2e-5  # slopes are those between pixels
    uv = CAMERA.project(EYE.inverse().apply(points))
    steps = (np.arange(4) + 0.5) / 4 - 0.5
    wanted = [(u + a, v + b) for v in (100, 101, 102) for u in range(200, 205) for b in steps for a in steps]
    np.testing.assert_allclose(uv, wanted, atol=1e-9)


def test_a_part_without_a_return_gives_an_empty_volume() -> None:
    part = observed_part(box(0.03, 0.02, 0.025))
    view = part.image.view
    without_return = View(view.camera, view.world_from_camera, np.where(part.image.labels == PART, 0, view.depth))
    empty = replace(part, image=replace(part.image, view=without_return))
    np.testing.assert_array_equal(empty.middle, part.pivot)
    assert np.all(empty.volume(VOXEL).values == 1)


# kits


def tray(deep: float, wide: float = 0.03) -> trimesh.Trimesh:
    """A plate with a square cavity, its top at z = 0."""
    plate = trimesh.creation.box((0.11, 0.11, 0.03)).apply_translation((0, 0, -0.015))
    hole = trimesh.creation.box((wide, wide, 2 * deep))
    return trimesh.boolean.difference([plate, hole], engine="manifold")


def observed_kits(body: trimesh.Trimesh, world_from_kit: Pose, world_from_camera: Pose) -> ObservedKits:
    bodies = [(box(2, 2, 0.1, at=(0, 0, -0.2)), Pose.identity()), (Mesh(body.vertices, body.faces), world_from_kit)]
    image = render(CAMERA, world_from_camera, bodies, 1)
    labels = np.where(image.body_ids == 2, ASSEMBLY_LABEL, 0).astype(np.uint8)
    return ObservedKits(LabelledDepth(View(CAMERA, world_from_camera, image.depth), labels), IDEAL.noise, "tray")


TILTED = Pose.from_rotvec((0.35, 0.2, 0.4), (0.01, -0.02, 0.03))


def test_a_cavity_has_walls_along_the_normal_and_its_observed_floor() -> None:
    deep, body = 0.012, tray(0.012)
    kits = observed_kits(body, TILTED, look_at((0.1, 0.05, 0.6), (0, 0, 0)))
    middle = TILTED.apply((0, 0, 0))
    volume = kits.volume(middle, VOXEL)
    assert volume.grid.shape == tuple(2 * round(r / VOXEL) for r in (KIT_HALF_WIDTH, KIT_HALF_WIDTH, HALF_HEIGHT))
    exact = signed_distance(volume.grid, [(Mesh(body.vertices, body.faces), TILTED)], threads=1).values
    places = TILTED.inverse().apply(volume.grid.centres())
    inside = (
        (np.abs(places[..., :2]) < 0.015 - VOXEL).all(-1) & (places[..., 2] < -VOXEL) & (places[..., 2] > VOXEL - deep)
    )
    around = (np.abs(places[..., :2]).max(-1) > 0.015 + VOXEL) & (np.abs(places[..., :2]).max(-1) < 0.03)
    around &= (places[..., 2] < -VOXEL) & (places[..., 2] > VOXEL - deep)
    assert (volume.values[inside] > 0).mean() > 0.98
    assert (volume.values[around] < 0).mean() > 0.98
    near = (np.abs(exact) < 0.6) & (inside | around)
    assert np.abs(volume.values - exact)[near].mean() < 0.1  # of five voxels


def test_a_hidden_wall_is_as_steep_as_a_visible_one() -> None:
    """Space behind the rim, unknown to the image alone, is solid under the plate and free over the cavity."""
    body, oblique = tray(0.012), look_at((0.45, 0.0, 0.45), (0, 0, 0))
    kits = observed_kits(body, Pose.identity(), oblique)
    volume = kits.volume(np.zeros(3), VOXEL)
    x, y, z = np.moveaxis(volume.grid.centres(), -1, 0)
    level = (np.abs(y) < 0.01) & (np.abs(z + 0.004) < 0.003)
    assert (volume.values[level & (x > 0.016) & (x < 0.03)] < 0).all()  # the near wall, which is hidden
    assert (volume.values[level & (x < 0.014) & (x > -0.014)] > 0).mean() > 0.98
    hidden = tsdf(volume.grid, kits.view, kits.mask, threads=1).values
    assert (np.isnan(hidden) | (hidden < 0))[level & (x > 0.011) & (x < 0.014)].any()


def test_without_a_plate_columns_are_vertical() -> None:
    kits = observed_kits(trimesh.creation.icosphere(radius=0.012), Pose.identity(), EYE)
    assert kits.plates == []
    volume = kits.volume(np.zeros(3), VOXEL)
    assert volume.grid.world_from_grid.rotate((0, 0, 1)) == pytest.approx((0, 0, 1))
    assert (volume.values < 0).any()


def test_far_from_all_kits_the_volume_is_empty() -> None:
    kits = observed_kits(tray(0.012), TILTED, EYE)
    assert (kits.volume(np.array([0.5, 0.5, 0.0]), VOXEL).values == 1).all()


CELL = 1e-3
GRID = Grid.centred(Pose.from_translation((0.001, -0.002, 0.012)), (56, 52, 40), CELL)


def mesh_of(solid) -> Mesh:
    return mesh_from_solid(solid).scaled(MM)


@pytest.mark.parametrize("solid", [ell(), ring_plate(20)], ids=["ell", "ring"])
def test_a_turned_solid_fills_its_volume_and_agrees_with_points_counted_inside(solid) -> None:
    body = mesh_of(solid)
    pose = Pose(random_quaternions(np.random.default_rng(3), 1)[0], np.array([0.001, 0.0, 0.012]))
    body = Mesh((body.vertices - body.centroid) * 0.7, body.faces)
    share = filled_share(body, pose, GRID)
    assert share.sum() * CELL**3 == pytest.approx(body.volume, rel=2e-3)
    moved = body.moved(pose)
    inside = trimesh.Trimesh(moved.vertices, moved.faces)
    rng = np.random.default_rng(0)
    cells = rng.choice(np.flatnonzero((share > 0.1) & (share < 0.9)), 40, replace=False)
    full = rng.choice(np.flatnonzero(share > 0.999), 10, replace=False)
    for cell in np.concatenate([cells, full]):
        place = GRID.world(np.array(np.unravel_index(cell, share.shape)))
        points = place + CELL * (rng.random((1000, 3)) - 0.5)
        assert share.flat[cell] == pytest.approx(inside.contains(points).mean(), abs=0.2)
    assert share[0].max() == 0


def test_a_solid_that_leaves_the_grid_fills_it_up_to_its_border() -> None:
    share = filled_share(mesh_of(drawn_box(100, 100, 100)), Pose.from_translation((0, 0, -0.05)), GRID)
    np.testing.assert_array_equal(share, 1)


def test_lines_through_vertices_and_along_edges_are_counted_once() -> None:
    """A box of whole cells whose edges lie on lines: at each of them one of two faces counts."""
    grid = Grid((20, 20, 20), CELL, Pose.from_translation((-0.0095, -0.0095, 0.0005)))
    low = 2.25  # [mm] on a line of columns=2
    share = filled_share(mesh_of(drawn_box(2 * low, 2 * low, 6)), Pose.identity(), grid)
    assert set(np.unique(share)) <= {0.0, 0.25, 0.5, 1.0}
    assert share.sum() == pytest.approx(6 * (2 * low) ** 2, rel=0.15)
