"""Smooth surface patches of a mesh, their shading normals, and the crease and outline lines of a picture.

CAD meshes approximate cylinders, fillets and planes by triangles. Adjacent faces at less than the crease angle belong
to one patch; lines are drawn where two patches meet and around each body.
"""

from __future__ import annotations

import numpy as np

from kit1000.mesh import Mesh, component_labels
from kit1000.numerics.compiled import compiled

CREASE_DEG = 32.0  # cylinders have 12 sides or more (30 degrees), chamfers have 45 degrees
PLANE_DEG = 0.5  # largest angle between faces of one plane, after rounding to float32
LINE_SHADE = 0.15  # colour of lines, as a fraction of the colour of the body
CREASE_OPACITY, OUTLINE_OPACITY = 0.55, 0.9  # opacity of lines within a body and around it


def smooth_patches(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Patches and shading normals of m faces.

    Returns:
        patches: (m,) int32, equal for faces of one smooth surface.
        normals: (m, 3, 3) unit normal at each corner of each face, averaged over its patch. Large planes have more
            weight than the narrow faces of a fillet, so that planes look flat.
    """
    corner = np.unique(mesh.vertices, axis=0, return_inverse=True)[1].ravel()[mesh.faces]
    pairs = _adjacent_faces(corner)
    cosine = np.einsum("ij,ij->i", mesh.normals[pairs[0]], mesh.normals[pairs[1]])
    patches = component_labels(len(corner), *pairs[:, cosine > np.cos(np.deg2rad(CREASE_DEG))]).astype(np.int32)
    planes = component_labels(len(corner), *pairs[:, cosine > np.cos(np.deg2rad(PLANE_DEG))])
    return patches, _corner_normals(mesh, corner, patches, planes)


def _adjacent_faces(corner: np.ndarray) -> np.ndarray:
    """(2, e) faces that share an edge, from the vertex indices of the faces (m, 3)."""
    start, end = corner.ravel().astype(np.int64), corner[:, [1, 2, 0]].ravel().astype(np.int64)
    key = np.minimum(start, end) * (corner.max(initial=0) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    same = key[order[1:]] == key[order[:-1]]
    return np.stack([order[:-1][same], order[1:][same]]) // 3


def _corner_normals(mesh: Mesh, corner: np.ndarray, patches: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """(m, 3, 3): mean normal per vertex and patch; weights are the area of a face's plane and its corner angle."""
    cross = np.cross(mesh.triangles[:, 1] - mesh.triangles[:, 0], mesh.triangles[:, 2] - mesh.triangles[:, 0])
    area = np.bincount(planes, np.linalg.norm(cross, axis=1))[planes]
    weighed = (area[:, None] * corner_angles(mesh.triangles))[..., None] * mesh.normals[:, None]
    key = corner.astype(np.int64) * (patches.max(initial=0) + 1) + patches[:, None]
    place = np.unique(key, return_inverse=True)[1].reshape(-1)
    sums = np.stack([np.bincount(place, weighed[..., i].ravel()) for i in range(3)], axis=1)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    unit = np.divide(sums, length, out=np.zeros_like(sums), where=length > 0)[place].reshape(-1, 3, 3)
    return np.where((unit == 0).all(axis=2, keepdims=True), mesh.normals[:, None], unit)


def corner_angles(triangles: np.ndarray) -> np.ndarray:
    """(m, 3) [rad]: the angle of each triangle at each of its corners."""
    forward = np.roll(triangles, -1, axis=1) - triangles
    backward = np.roll(triangles, 1, axis=1) - triangles
    sine = np.linalg.norm(np.cross(forward, backward), axis=2)
    return np.arctan2(sine, np.einsum("ijk,ijk->ij", forward, backward))


@compiled
def draw_lines(depth, body_ids, face_ids, first_face, patches, albedo, step, image):
    """Darken the outlines and creases of a linear `image` (H, W, 3) in place.

    A pixel is on an outline when a neighbouring pixel shows another body or a depth step of more than `step` [m]. It is
    on a crease when the pixel above or to the left is of another patch of the same body. `depth`, `body_ids`,
    `face_ids` are those of a rendered image; `first_face` (b,), `patches` (m,), `albedo` (b, 3) of the bodies.
    """
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            strength, here = 0.0, body_ids[v, u] - 1
            owner = here
            for dv, du in ((-1, 0), (0, -1), (1, 0), (0, 1)):
                y, x = v + dv, u + du
                if y < 0 or x < 0 or y >= height or x >= width:
                    continue
                there = body_ids[y, x] - 1
                if here != there:
                    strength = OUTLINE_OPACITY
                    if there >= 0 and (here < 0 or depth[y, x] < depth[v, u]):
                        owner = there
                elif here >= 0 and _depth_step(depth, v, u, dv, du) > step:
                    strength = OUTLINE_OPACITY
                elif here >= 0 and dv + du < 0:
                    first = first_face[here]
                    if patches[first + face_ids[v, u]] != patches[first + face_ids[y, x]]:
                        strength = max(strength, CREASE_OPACITY)
            if strength > 0:
                for i in range(3):
                    image[v, u, i] += strength * (LINE_SHADE * albedo[owner, i] - image[v, u, i])


@compiled
def _depth_step(depth, v, u, dv, du):
    """Distance [m] between the depth of the neighbour of (v, u) and the plane through (v, u) and the opposite one."""
    height, width = depth.shape
    y, x = v - dv, u - du
    expected = 1 / depth[v, u]
    if 0 <= y < height and 0 <= x < width and depth[y, x] > 0:
        expected += expected - 1 / depth[y, x]  # inverse depth is linear over a plane
    return abs(depth[v + dv, u + du] - 1 / max(expected, 1e-6))
