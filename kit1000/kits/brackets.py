"""Supports for the plates of an assembly: wedge brackets between neighbours, ribs and webs down to the ground.

Every piece is the convex hull of a few points and overlaps its plates by PLATE_OVERLAP, so the union of plates and
pieces is one body. Ribs run under each plate along its slope, close enough to print without support material.
Assembly frame: z up, ground at z = 0. All lengths are metres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from manifold3d import Manifold

from kit1000.mesh import Mesh, convex_hull, mesh_from_solid
from kit1000.numerics.linear_algebra import matmul
from kit1000.values import Mount

PLATE_OVERLAP = 1e-3  # [m] by which a piece reaches into a plate; the floor under a cavity is 2 mm
EDGE_SETBACK = 2e-3  # [m] from pieces to the edges of the plates, so that no two faces are coplanar
RIB_WIDTH = 6e-3  # [m] along the plate; on a plate tilted by 45 degrees the wall is 4.2 mm thick
RIB_PITCH = 24e-3  # [m] at most from rib to rib: bridges of 18 mm print without support material
WEB_STRIP = 6e-3  # [m] width of the strip of a plate's underside that rests on a web
OUTWARD = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])  # (4, 2) the sides of a plate, by direction 0..3


def support_meshes(mounts: Sequence[Mount]) -> list[Mesh]:
    """Meshes of the convex pieces that support the plates, in the assembly frame."""
    return [mesh_from_solid(piece) for piece in support_pieces(mounts)]


def support_pieces(mounts: Sequence[Mount]) -> list[Manifold]:
    """The convex pieces that support the plates, the first of which is the base, in the assembly frame."""
    pieces = [rib for mount in mounts for rib in _ribs(mount)]
    for side in mounts[1:]:
        direction = side_direction(mounts[0], side)
        pieces += [_bracket(mounts[0], side, direction), _web(mounts[0], side, direction)]
    return pieces


def side_direction(base: Mount, side: Mount) -> int:
    """The side of the base on which a plate is: 0..3 for +x, +y, -x, -y of the base."""
    offset = (base.assembly_from_kit.inverse() @ side.assembly_from_kit).xyz[:2]
    return int(np.argmax(matmul(OUTWARD, offset)))


def _bracket(base: Mount, side: Mount, direction: int) -> Manifold:
    """The wedge between two plates: the hull of a strip inside each of the facing sides."""
    strips = [_facing_strip(base, direction), _facing_strip(side, direction + 2)]
    return convex_hull(np.concatenate(strips))


def _facing_strip(mount: Mount, direction: int) -> np.ndarray:
    """(4, 3) [m] a strip PLATE_OVERLAP inside one side of a plate, clear of its edges; it reaches into the web."""
    x, y, thickness = mount.kit.extent
    depth, half = (x / 2, y / 2) if direction % 2 == 0 else (y / 2, x / 2)
    heights = (PLATE_OVERLAP / 2 - thickness, -EDGE_SETBACK)
    corners = [(depth - PLATE_OVERLAP, v, z) for v in (EDGE_SETBACK - half, half - EDGE_SETBACK) for z in heights]
    return mount.assembly_from_kit.apply(_rotated_to_side(np.array(corners), direction))


def _web(base: Mount, side: Mount, direction: int) -> Manifold:
    """The wall under a bracket, as wide as the plates."""
    return _extended_to_ground(np.concatenate([_web_strip(base, direction), _web_strip(side, direction + 2)]))


def _web_strip(mount: Mount, direction: int) -> np.ndarray:
    """(4, 3) [m] the strip of the underside along one side of a plate."""
    x, y, _ = mount.kit.extent
    depth, half = (x / 2, y / 2) if direction % 2 == 0 else (y / 2, x / 2)
    corners = [
        (u, v, 0.0)
        for u in (depth - WEB_STRIP, depth - PLATE_OVERLAP)
        for v in (EDGE_SETBACK - half, half - EDGE_SETBACK)
    ]
    return _underside(mount, _rotated_to_side(np.array(corners), direction)[:, :2])


def _ribs(mount: Mount) -> list[Manifold]:
    """Ribs under a plate along its steeper axis, and one across their middle."""
    reach = mount.kit.extent[:2] / 2 - EDGE_SETBACK
    slopes = np.abs(mount.assembly_from_kit.rotation_matrix()[2, :2])
    along = int(slopes[1] > slopes[0] + 1e-9)
    count = int(np.ceil((2 * reach[1 - along] - RIB_WIDTH) / RIB_PITCH)) + 1
    strips = []
    for middle in np.linspace(RIB_WIDTH / 2 - reach[1 - along], reach[1 - along] - RIB_WIDTH / 2, count):
        strips.append((reach[along], middle, along))
    strips.append((reach[1 - along], 0.0, 1 - along))
    return [_extended_to_ground(_underside(mount, _strip(*strip))) for strip in strips]


def _strip(reach: float, middle: float, along: int) -> np.ndarray:
    """(4, 2) [m] a strip of width RIB_WIDTH along one axis of a plate."""
    corners = np.array([(u, middle + v) for u in (-reach, reach) for v in (-RIB_WIDTH / 2, RIB_WIDTH / 2)])
    return corners[:, ::-1] if along else corners


def _underside(mount: Mount, points: np.ndarray) -> np.ndarray:
    """(n, 3) [m] points (n, 2) of a plate, PLATE_OVERLAP above its underside, in the assembly frame."""
    level = np.full(len(points), PLATE_OVERLAP - mount.kit.extent[2])
    return mount.assembly_from_kit.apply(np.column_stack([points, level]))


def _extended_to_ground(points: np.ndarray) -> Manifold:
    """The hull of points (n, 3) [m] and of their projection onto the ground."""
    return convex_hull(np.concatenate([points, points * (1, 1, 0)]))


def _rotated_to_side(points: np.ndarray, direction: int) -> np.ndarray:
    """Points (n, 3) of the side +x of a plate rotated to the side `direction`."""
    (c, s), z = OUTWARD[direction % 4], points[:, 2]
    return np.column_stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1], z])
