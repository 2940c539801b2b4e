"""Light for pictures: a soft key lamp and a sky, both sampled by lamps that cast exact hard shadows.

Each lamp is a depth image taken from far away in its direction. Averaged over enough lamps, hard shadows
become soft ones, corners and cavities darken as they do under a cloudy sky, and bodies touch the ground
visibly. Colours are linear light, 1 = white.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kit1000.camera import Camera, look_at
from kit1000.compiled import compiled
from kit1000.mesh import Mesh
from kit1000.pose import Pose, quaternion_between
from kit1000.sim.render import render

MAP_SIZE = 512  # [px] side of a lamp's depth image
LAMP_DISTANCE = 1000.0  # distance of the lamps, in radii of the scene: rays are parallel to a quarter of a texel
KEY_SPREAD = 0.16  # sine of the half angle under which the key lamp is seen: soft, but a shadow with a shape
KEY_COLOUR = (0.62, 0.60, 0.56)  # warm; with the sky, a level surface shows its own colour, a little lighter
SKY_COLOUR = (0.48, 0.50, 0.53)  # cool
BOUNCE_COLOUR = (0.21, 0.205, 0.20)  # what the ground throws back from below
GLOSS, SHININESS = 0.07, 24.0  # a satin plastic
FADE_BORDER = 0.08  # share of the image along its border where the ground turns into the plain background
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


class Lamps(NamedTuple):
    """L lamps and the shadows they cast: first `keys` parts of the key lamp, then parts of the sky."""

    directions: np.ndarray
    """(L, 3) unit vectors from the scene to the lamps."""
    weights: np.ndarray
    """(L,): a level surface gets 1 from all key lamps together, and 1 from all of the sky."""
    map_from_world: np.ndarray
    """(L, 3, 4): column, row [px] and depth [m] of a point (x, y, z, 1) in the image of a lamp."""
    shadow_maps: np.ndarray
    """(L, MAP, MAP) float32 [m] depth from the lamp, 0 where nothing stands."""
    texel: float
    """[m] width of a pixel of a depth image at the scene."""
    key_count: int


class ShadingScene(NamedTuple):
    """What the loop over pixels has to know of the bodies; m faces of all bodies, b bodies."""

    first_face: np.ndarray
    """(b,) number of the first face of each body."""
    corners: np.ndarray
    """(m, 3, 3) [m], world."""
    normals: np.ndarray
    """(m, 3, 3) shading normals at the corners, world."""
    face_normals: np.ndarray
    """(m, 3) face normals, world."""
    albedo: np.ndarray
    """(b, 3) linear colour of each body."""


def key_directions(n: int, towards: np.ndarray) -> np.ndarray:
    """(n, 3) unit vectors spread evenly over the round key lamp in the direction `towards` (3,)."""
    count = np.arange(n)
    radius, angle = KEY_SPREAD * np.sqrt((count + 0.5) / n), GOLDEN_ANGLE * count
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1)
    return Pose(quaternion_between(np.array((0.0, 0.0, 1.0)), towards), np.zeros(3)).rotate(disc)


def sky_directions(n: int) -> np.ndarray:
    """(n, 3) unit vectors spread evenly over the sky above 6 degrees (a Fibonacci spiral)."""
    count = np.arange(n)
    z, angle = 0.1 + 0.9 * (count + 0.5) / n, GOLDEN_ANGLE * count
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def place_lamps(
    bodies: Sequence[tuple[Mesh, Pose]], ball: tuple[np.ndarray, float], key: np.ndarray, sky: np.ndarray
) -> Lamps:
    """Lamps in directions key (k, 3) and sky (s, 3) for bodies within `ball`: centre (3,), radius [m]."""
    centre, radius = ball
    texel = 2 * radius / (MAP_SIZE - 4)
    focal, middle = LAMP_DISTANCE * radius / texel, (MAP_SIZE - 1) / 2
    camera = Camera(width=MAP_SIZE, height=MAP_SIZE, fx=focal, fy=focal, cx=middle, cy=middle)
    towards = np.concatenate([key, sky])
    affine, maps = np.zeros((len(towards), 3, 4)), np.empty((len(towards), MAP_SIZE, MAP_SIZE), np.float32)
    for k, direction in enumerate(towards):
        # Each image is rolled differently, so that the steps of their pixels do not fall in line.
        roll = Pose.from_rotvec((0, 0, GOLDEN_ANGLE * k))
        world_from_lamp = _lamp_pose(centre, centre + LAMP_DISTANCE * radius * direction) @ roll
        maps[k] = render(camera, world_from_lamp, bodies, threads=1).depth
        affine[k] = world_from_lamp.inverse().matrix()[:3]
        affine[k, :2] /= texel
        affine[k, :2, 3] += middle
    weights = np.concatenate([np.full(len(key), 1 / key[:, 2].sum()), np.full(len(sky), 1 / sky[:, 2].sum())])
    return Lamps(towards, weights, affine, maps, texel, len(key))


def _lamp_pose(target: np.ndarray, eye: np.ndarray) -> Pose:
    upright = abs((eye - target)[2]) < 0.9 * np.linalg.norm(eye - target)
    return look_at(eye, target, up=(0, 0, 1) if upright else (0, 1, 0))


@compiled
def illuminate(lens, rotation, eye, frame, scene, lamps, ground, paper, shadow, colours, out):
    """Colour of each pixel into `out` (H, W, 3), linear.

    `rotation` (3, 3) and `eye` (3,) are world_from_camera; `frame` the depth, ids and faces seen; `ground`
    the height [m] of a floor of the colour `paper` that darkens by up to `shadow`; NaN for none.
    `colours` (3, 3): key, sky and bounce.
    """
    depth, ids, faces = frame
    point, normal, flat, view = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            p, q = (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy
            for i in range(3):
                view[i] = rotation[i, 0] * p + rotation[i, 1] * q + rotation[i, 2]
                out[v, u, i] = paper[i]
            body = ids[v, u] - 1
            if body >= 0:
                for i in range(3):
                    point[i] = eye[i] + depth[v, u] * view[i]
                _set_normals(scene, scene.first_face[body] + faces[v, u], view, point, normal, flat)
                key, sky, gloss, _, open_sky = _incident_light(lamps, point, normal, flat, view)
                below = (0.5 - 0.5 * normal[2]) * (0.4 + 0.6 * sky / max(open_sky, 0.05))
                for i in range(3):
                    light = key * colours[0, i] + sky * colours[1, i] + below * colours[2, i]
                    out[v, u, i] = scene.albedo[body, i] * light + gloss * colours[0, i]
            elif view[2] < 0 and eye[2] > ground:
                for i in range(3):
                    point[i] = eye[i] + (ground - eye[2]) / view[2] * view[i]
                    normal[i] = flat[i] = 0.0
                normal[2] = flat[2] = 1.0
                key, sky, _, open_key, open_sky = _incident_light(lamps, point, normal, flat, view)
                for i in range(3):
                    share = (key * colours[0, i] + sky * colours[1, i]) / (
                        open_key * colours[0, i] + open_sky * colours[1, i]
                    )
                    out[v, u, i] = paper[i] * (1 - shadow * (1 - share) * _fade(lens, u, v))


@compiled
def _fade(lens, u, v):
    """0 at the border of the image, 1 well inside: shadows end softly where the picture does."""
    border = min(u, v, lens.width - 1 - u, lens.height - 1 - v) / (FADE_BORDER * min(lens.width, lens.height))
    border = min(max(border, 0.0), 1.0)
    return border * border * (3 - 2 * border)


@compiled
def _set_normals(scene, face, view, point, normal, flat):
    """Set the shading normal and the face normal at a point of a face, both turned towards the viewer."""
    corners, normals = scene.corners, scene.normals
    bb, cc, bc, pb, pc, facing = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        a = corners[face, 0, i]
        s, t, w = corners[face, 1, i] - a, corners[face, 2, i] - a, point[i] - a
        bb, cc, bc = bb + s * s, cc + t * t, bc + s * t
        pb, pc = pb + w * s, pc + w * t
        flat[i] = scene.face_normals[face, i]
        facing += flat[i] * view[i]
    area = max(bb * cc - bc * bc, 1e-300)
    second = min(max((cc * pb - bc * pc) / area, 0.0), 1.0)
    third = min(max((bb * pc - bc * pb) / area, 0.0), 1.0)
    sign, length = (-1.0 if facing > 0 else 1.0), 0.0
    for i in range(3):
        flat[i] *= sign
        mixed = (1 - second - third) * normals[face, 0, i] + second * normals[face, 1, i]
        normal[i] = sign * (mixed + third * normals[face, 2, i])
        length += normal[i] * normal[i]
    for i in range(3):
        normal[i] /= max(np.sqrt(length), 1e-12)


@compiled
def _incident_light(lamps, point, normal, flat, view):
    """Light from the key lamp and the sky, the key's reflection, and both lights without any shadow."""
    towards, weights, affine, maps, texel, keys = lamps
    key, sky, open_key, open_sky = 0.0, 0.0, 0.0, 0.0
    nx, ny, nz = normal[0], normal[1], normal[2]
    # A step off the surface keeps a body from shading itself where a depth image is coarse.
    x, y, z = (
        point[0] + 1.5 * texel * flat[0],
        point[1] + 1.5 * texel * flat[1],
        point[2] + 1.5 * texel * flat[2],
    )
    for k in range(towards.shape[0]):
        share = weights[k] * (nx * towards[k, 0] + ny * towards[k, 1] + nz * towards[k, 2])
        if share <= 0:
            continue
        u = affine[k, 0, 0] * x + affine[k, 0, 1] * y + affine[k, 0, 2] * z + affine[k, 0, 3] + 0.5
        v = affine[k, 1, 0] * x + affine[k, 1, 1] * y + affine[k, 1, 2] * z + affine[k, 1, 3] + 0.5
        lit = True
        if 0 <= u < MAP_SIZE and 0 <= v < MAP_SIZE:
            depth = affine[k, 2, 0] * x + affine[k, 2, 1] * y + affine[k, 2, 2] * z + affine[k, 2, 3]
            nearest = maps[k, int(v), int(u)]
            lit = nearest == 0 or nearest > depth - 0.5 * texel
        if k < keys:
            open_key += share
            if lit:
                key += share
        else:
            open_sky += share
            if lit:
                sky += share
    gloss = 0.0
    if key > 0:
        gloss = key / open_key * _gloss(towards[0], normal, view)
    return key, sky, gloss, open_key, open_sky


@compiled
def _gloss(towards, normal, view):
    """Share of the light from `towards` that a satin surface throws to the viewer (Blinn 1977)."""
    length = np.sqrt(view[0] ** 2 + view[1] ** 2 + view[2] ** 2)
    square, cosine = 0.0, 0.0
    for i in range(3):
        half = towards[i] - view[i] / length
        square += half * half
        cosine += half * normal[i]
    return GLOSS * max(cosine / np.sqrt(square), 0.0) ** SHININESS
