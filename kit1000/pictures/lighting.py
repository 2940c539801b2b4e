"""Lighting of pictures: a soft key light and a sky, both sampled by lamps with hard shadows from shadow maps.

A shadow map is a depth image rendered from far away in the direction of its lamp. Averaged over enough lamps, shadows
become soft, corners and cavities darken as under a cloudy sky, and bodies have contact shadows on the ground. Colours
are linear, 1 = white.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kit1000.camera import Camera
from kit1000.mesh import Mesh
from kit1000.numerics.compiled import compiled
from kit1000.pose import Pose, quaternion_between, quaternion_multiply
from kit1000.sim.render import render

KEY_LAMPS, SKY_LAMPS = 24, 40  # samples of the key light and of the sky
MAP_SIZE = 384  # [px] side of a shadow map
LAMP_DISTANCE = 1000.0  # in radii of the scene: rays are parallel to a quarter of a texel
KEY_SPREAD = 0.16  # sine of the half angle of the key light: its shadows are soft but have a shape
KEY_COLOUR = (0.62, 0.60, 0.56)  # warm; with the sky, a level surface has its own colour, slightly lighter
SKY_COLOUR = (0.48, 0.50, 0.53)  # cool
BOUNCE_COLOUR = (0.21, 0.205, 0.20)  # light reflected by the ground from below
COLOURS = np.array((KEY_COLOUR, SKY_COLOUR, BOUNCE_COLOUR))
GLOSS = 0.07  # satin plastic
GROUND_SHADOW = 0.75  # darkening of a ground point that no light reaches
GROUND_STEP = 4  # [px] between the pixels at which the light on the ground is computed; it is interpolated between them
FADE_BORDER = 0.08  # fraction of the image along its border in which shadows on the ground fade out
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


class Lamps(NamedTuple):
    """L lamps with shadow maps: first `key_count` samples of the key light, then samples of the sky."""

    directions: np.ndarray
    """(L, 3) unit vectors from the scene to the lamps."""
    weights: np.ndarray
    """(L,): a level surface gets 1 in total from the key light, and 1 from the sky."""
    map_from_world: np.ndarray
    """(L, 3, 4): from a point (x, y, z, 1) to column, row [px] and depth [m] in a shadow map."""
    shadow_maps: np.ndarray
    """(L, MAP_SIZE, MAP_SIZE) float32 [m] depth of the nearest surface from the lamp, 0 for none."""
    texel: float
    """[m] width of a pixel of a shadow map at the scene."""
    key_count: int


class ShadingScene(NamedTuple):
    """The b bodies of a picture, with m faces in all, as the loop over pixels needs them."""

    first_face: np.ndarray  # (b,) index of the first face of each body
    corners: np.ndarray  # (m, 3, 3) [m], world
    normals: np.ndarray  # (m, 3, 3) shading normals at the corners, world
    face_normals: np.ndarray  # (m, 3) face normals, world
    albedo: np.ndarray  # (b, 3) linear colour of each body


def open_light(normals: np.ndarray, key: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(..., 3) the light on surfaces of some unit normals (..., 3) that nothing shades.

    key, up: (3,) unit vectors to the key light, and up. Only sums, products and quotients are computed: equal numbers
    on every processor.
    """
    x, y, z = normals[..., 0], normals[..., 1], normals[..., 2]
    towards_key, height = (x * a + y * b + z * c for a, b, c in (key.tolist(), up.tolist()))
    level = float(key[0] * up[0] + key[1] * up[1] + key[2] * up[2])
    key_light, below = np.maximum(towards_key, 0)[..., None] / level, (0.5 - 0.5 * height)[..., None]
    return key_light * COLOURS[0] + (1 - below) * COLOURS[1] + below * COLOURS[2]


def place_lamps(bodies: Sequence[tuple[Mesh, Pose]], centre: np.ndarray, radius: float, towards: np.ndarray) -> Lamps:
    """Lamps for bodies within a ball [m]; the key light is in the direction `towards` (3,).

    Each lamp has another roll, so that the pixel grids of their maps are not aligned.
    """
    texel, distance, middle = 2 * radius / (MAP_SIZE - 4), LAMP_DISTANCE * radius, (MAP_SIZE - 1) / 2
    camera = Camera(MAP_SIZE, MAP_SIZE, distance / texel, distance / texel, middle, middle)
    key, sky = _key_directions(towards), _sky_directions()
    directions = np.concatenate([key, sky])
    map_from_world, maps = np.empty((len(directions), 3, 4)), []
    for number, direction in enumerate(directions):
        roll = Pose.from_rotvec((0.0, 0.0, GOLDEN_ANGLE * number)).wxyz
        wxyz = quaternion_multiply(quaternion_between((0.0, 0.0, 1.0), -direction), roll)
        world_from_lamp = Pose(wxyz, centre + distance * direction)
        map_from_world[number] = world_from_lamp.inverse().matrix()[:3]
        maps.append(render(camera, world_from_lamp, bodies, threads=1).depth)
    map_from_world[:, :2] /= texel
    map_from_world[:, :2, 3] += middle
    weights = np.concatenate([np.full(len(key), 1 / key[:, 2].sum()), np.full(len(sky), 1 / sky[:, 2].sum())])
    return Lamps(directions, weights, map_from_world, np.stack(maps), texel, len(key))


def _key_directions(towards: np.ndarray) -> np.ndarray:
    """(KEY_LAMPS, 3) unit vectors distributed evenly over the round key light in the direction `towards` (3,)."""
    count = np.arange(KEY_LAMPS)
    radius, angle = KEY_SPREAD * np.sqrt((count + 0.5) / KEY_LAMPS), GOLDEN_ANGLE * count
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1)
    return Pose(quaternion_between(np.array((0.0, 0.0, 1.0)), towards), np.zeros(3)).rotate(disc)


def _sky_directions() -> np.ndarray:
    """(SKY_LAMPS, 3) unit vectors distributed evenly over the sky above 6 degrees (a Fibonacci spiral)."""
    count = np.arange(SKY_LAMPS)
    z, angle = 0.1 + 0.9 * (count + 0.5) / SKY_LAMPS, GOLDEN_ANGLE * count
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


@compiled
def illuminate(intrinsics, rotation, eye, image, scene, lamps, first, step, out):
    """Write the linear colour of each pixel of a body to `out` (H, W, 3).

    `rotation` (3, 3) and `eye` (3,) are world_from_camera; `image` is the depth, body ids and face ids; the light is
    that of every `step`-th lamp, from the lamp `first` on.
    """
    depth, ids, faces = image
    point, normal, face_normal, view = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            body = ids[v, u] - 1
            if body < 0:
                continue
            _set_view(intrinsics, rotation, u, v, view)
            for i in range(3):
                point[i] = eye[i] + depth[v, u] * view[i]
            _set_normals(scene, scene.first_face[body] + faces[v, u], view, point, normal, face_normal)
            key, sky, gloss, open_sky = _incident_light(lamps, first, step, point, normal, face_normal, view)
            below = (0.5 - 0.5 * normal[2]) * (0.4 + 0.6 * sky / max(open_sky, 0.05))
            for i in range(3):
                light = key * COLOURS[0, i] + sky * COLOURS[1, i] + below * COLOURS[2, i]
                out[v, u, i] = scene.albedo[body, i] * light + gloss * COLOURS[0, i]


@compiled
def draw_ground(intrinsics, rotation, eye, lamps, height, background, out):
    """Write the linear colour of the ground at a height [m] to `out` (H, W, 3), of a colour (3,) without shadows.

    `rotation` (3, 3) and `eye` (3,) are world_from_camera. A camera below the ground sees the colour alone.
    """
    point, normal, view = np.empty(3), np.array((0.0, 0.0, 1.0)), np.empty(3)
    grid = np.empty((out.shape[0] // GROUND_STEP + 2, out.shape[1] // GROUND_STEP + 2, 3))
    for v in range(grid.shape[0]):
        for u in range(grid.shape[1]):
            _set_view(intrinsics, rotation, u * GROUND_STEP, v * GROUND_STEP, view)
            grid[v, u] = background
            if not (view[2] < 0 and eye[2] > height):
                continue
            for i in range(3):
                point[i] = eye[i] + (height - eye[2]) / view[2] * view[i]
            key, sky, _, _ = _incident_light(lamps, 0, 1, point, normal, normal, view)
            shadow = GROUND_SHADOW * _fade(intrinsics, u * GROUND_STEP, v * GROUND_STEP)
            for i in range(3):
                lit = (key * COLOURS[0, i] + sky * COLOURS[1, i]) / (COLOURS[0, i] + COLOURS[1, i])
                grid[v, u, i] *= 1 - shadow * (1 - lit)
    for v in range(out.shape[0]):
        i, down = v // GROUND_STEP, v % GROUND_STEP / GROUND_STEP
        for u in range(out.shape[1]):
            j, along = u // GROUND_STEP, u % GROUND_STEP / GROUND_STEP
            for c in range(3):
                upper = grid[i, j, c] + along * (grid[i, j + 1, c] - grid[i, j, c])
                lower = grid[i + 1, j, c] + along * (grid[i + 1, j + 1, c] - grid[i + 1, j, c])
                out[v, u, c] = upper + down * (lower - upper)


@compiled
def _set_view(intrinsics, rotation, u, v, view):
    """Set the direction in which a pixel looks, of depth 1."""
    p, q = (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
    for i in range(3):
        view[i] = rotation[i, 0] * p + rotation[i, 1] * q + rotation[i, 2]


@compiled
def _fade(intrinsics, u, v):
    """0 at the border of the image, 1 well inside: shadows fade out towards the border."""
    width, height = intrinsics.width, intrinsics.height
    border = min(u, v, width - 1 - u, height - 1 - v) / (FADE_BORDER * min(width, height))
    border = min(max(border, 0.0), 1.0)
    return border * border * (3 - 2 * border)


@compiled
def _set_normals(scene, face, view, point, normal, face_normal):
    """Set the shading normal and the face normal at a point of a face, both facing the viewer."""
    corners, normals = scene.corners, scene.normals
    bb, cc, bc, pb, pc, facing = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        a = corners[face, 0, i]
        s, t, w = corners[face, 1, i] - a, corners[face, 2, i] - a, point[i] - a
        bb, cc, bc = bb + s * s, cc + t * t, bc + s * t
        pb, pc = pb + w * s, pc + w * t
        face_normal[i] = scene.face_normals[face, i]
        facing += face_normal[i] * view[i]
    area = max(bb * cc - bc * bc, 1e-300)
    second = min(max((cc * pb - bc * pc) / area, 0.0), 1.0)
    third = min(max((bb * pc - bc * pb) / area, 0.0), 1.0)
    sign, length = (-1.0 if facing > 0 else 1.0), 0.0
    for i in range(3):
        face_normal[i] *= sign
        mixed = (1 - second - third) * normals[face, 0, i] + second * normals[face, 1, i]
        normal[i] = sign * (mixed + third * normals[face, 2, i])
        length += normal[i] * normal[i]
    for i in range(3):
        normal[i] /= max(np.sqrt(length), 1e-12)


@compiled
def _incident_light(lamps, first, step, point, normal, face_normal, view):
    """Key light and sky light at a point, the reflection of the key light, and the light of the sky without shadows.

    All are of every `step`-th lamp, from the lamp `first` on, times `step`.
    """
    # all by single numbers: slices are counted references
    directions, weights, maps, shadow_maps, texel, key_count = lamps
    key, open_key, sky, open_sky = 0.0, 0.0, 0.0, 0.0
    nx, ny, nz = normal[0], normal[1], normal[2]
    # An offset from the surface prevents self-shadowing at the resolution of the shadow maps.
    x, y, z = (
        point[0] + 1.5 * texel * face_normal[0],
        point[1] + 1.5 * texel * face_normal[1],
        point[2] + 1.5 * texel * face_normal[2],
    )
    for k in range(first, directions.shape[0], step):
        share = step * weights[k] * (nx * directions[k, 0] + ny * directions[k, 1] + nz * directions[k, 2])
        if share <= 0:
            continue
        u = maps[k, 0, 0] * x + maps[k, 0, 1] * y + maps[k, 0, 2] * z + maps[k, 0, 3] + 0.5
        v = maps[k, 1, 0] * x + maps[k, 1, 1] * y + maps[k, 1, 2] * z + maps[k, 1, 3] + 0.5
        lit = share
        if 0 <= u < shadow_maps.shape[2] and 0 <= v < shadow_maps.shape[1]:
            depth = maps[k, 2, 0] * x + maps[k, 2, 1] * y + maps[k, 2, 2] * z + maps[k, 2, 3]
            nearest = shadow_maps[k, int(v), int(u)]
            if nearest != 0 and nearest <= depth - 0.5 * texel:
                lit = 0.0
        if k < key_count:
            open_key, key = open_key + share, key + lit
        else:
            open_sky, sky = open_sky + share, sky + lit
    gloss = 0.0
    if key > 0:
        gloss = key / open_key * _gloss(directions[0], normal, view)
    return key, sky, gloss, open_sky


@compiled
def _gloss(towards, normal, view):
    """Fraction of the light from direction `towards` that a satin surface reflects to the viewer (Blinn 1977)."""
    length = np.sqrt(view[0] ** 2 + view[1] ** 2 + view[2] ** 2)
    square, cosine = 0.0, 0.0
    for i in range(3):
        half = towards[i] - view[i] / length
        square += half * half
        cosine += half * normal[i]
    cube = max(cosine / np.sqrt(square), 0.0) ** 3
    return GLOSS * (cube * cube) ** 4  # the shininess is 24
