"""The kit generation of the paper's release, written again in plain numpy, for comparison with ours.

A pinhole 100 m below the part stands in for an orthographic camera; its depth image fills a voxel grid of
0.89 mm, in which everything above the part's lower surface is solid; copies of that, shifted by every
whole number of voxels from -11 to +12 along x and y, make the cavity; marching cubes cut it out of a block of
120 mm. Steps, constants and the cavity's offset are the release's. The depth image is rendered by our
renderer, which is faster than the one of the release; the comparison favours the release by that.
"""

from __future__ import annotations

import numpy as np
from skimage.measure import marching_cubes

from kit1000.camera import Camera
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.sim.render import render

VOXEL = 0.89e-3  # [m]
TRUNCATION = 5 * VOXEL
BOX = np.array([80e-3, 80e-3, 50e-3])  # [m] every part is stretched to fill it
MARGIN = 10e-3  # [m] nominal; whole voxels make it 9.8 to 10.7 mm
SHIFTS = range(-11, 13)
BLOCK = (135, 135, 25)
PASTED_AT = 12  # voxels; 11 would centre it
CAVITY_LAYERS = 23  # of 25: two remain as a floor
BLOCK_HEIGHT = 9e-3  # [m] z of the block's middle when the part stands on z = 0
DISTANCE, FAR = 100.0, 100.05  # [m] from the camera to the part's underside, and the far limit of depth
CAMERA = Camera(1280, 720, 63e4, 63e4, 640.0, 360.0)


def stretched(mesh: Mesh) -> Mesh:
    """The part as the release prepares it: non-uniformly scaled to the box, centred, standing on z = 0."""
    vertices = (mesh.vertices - mesh.bounds.mean(0)) * (BOX / mesh.extents)
    return Mesh(vertices + [0, 0, BOX[2] / 2], mesh.faces)


def release_kit(standing: Mesh) -> Mesh:
    """The kit of a stretched part, in the frame in which the part is seated where it stands."""
    grown = dilated(occupancy(standing))
    block = np.full(BLOCK, -1.0, np.float32)  # negative is solid
    nx, ny = min(grown.shape[0], BLOCK[0] - PASTED_AT), min(grown.shape[1], BLOCK[1] - PASTED_AT)
    pasted = block[PASTED_AT : PASTED_AT + nx, PASTED_AT : PASTED_AT + ny, -CAVITY_LAYERS:]
    pasted[:] = grown[:nx, :ny, :CAVITY_LAYERS]  # 1 in the cavity, 0 around it
    for axis in range(3):
        edge = np.moveaxis(block, axis, 0)
        edge[0] = edge[-1] = 1
    vertices, faces, _, _ = marching_cubes(block, 0.0)
    placed = (vertices - np.array(BLOCK) / 2) * VOXEL + [0, 0, BLOCK_HEIGHT]
    return Mesh(placed, faces.astype(np.int32))


def occupancy(standing: Mesh) -> np.ndarray:
    """(nx, ny, nz) bool: voxels above the part's lower surface, in its box grown by 10 mm along x and y."""
    low, high = standing.bounds
    low, high = low - [MARGIN, MARGIN, 0], high + [MARGIN, MARGIN, 0]
    x, y, z = (low[axis] + VOXEL * np.arange(np.ceil((high - low)[axis] / VOXEL)) for axis in range(3))
    ahead = (DISTANCE + z)[None, None]  # (1, 1, nz) along the line of sight
    # Looking up with +x upwards in the image: the camera's x runs along +y, its y along -x.
    u = np.rint(CAMERA.fx * y[None, :, None] / ahead + CAMERA.cx).astype(int)
    v = np.rint(-CAMERA.fy * x[:, None, None] / ahead + CAMERA.cy).astype(int)
    depth = depth_image(standing)[np.broadcast_to(v, np.broadcast_shapes(u.shape, v.shape)), u]
    signed = np.clip((depth - ahead) / TRUNCATION, -1, 1)
    return signed < 0


def depth_image(standing: Mesh) -> np.ndarray:
    """(720, 1280) [m] from 100 m below the part, looking up, +x upwards in the image."""
    rotation = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # columns: the camera's x, y, z in the world
    below = Pose.from_rotation_matrix(rotation, np.array([0, 0, -DISTANCE]))
    depth = render(CAMERA, below, [(standing, Pose.identity())]).depth
    return np.where(depth > 0, depth, FAR)


def dilated(occupied: np.ndarray) -> np.ndarray:
    """The union of all shifted copies: a square of 24 voxels, half a voxel off the middle."""
    reach = max(SHIFTS)
    padded = np.pad(occupied, ((reach, reach), (reach, reach), (0, 0)))
    nx, ny, _ = occupied.shape
    grown = np.zeros_like(occupied)
    for dx in SHIFTS:
        for dy in SHIFTS:
            grown |= padded[reach - dx : reach - dx + nx, reach - dy : reach - dy + ny]
    return grown
