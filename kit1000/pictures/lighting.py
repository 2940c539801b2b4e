"""Lighting of pictures: a soft key light and a sky, both sampled by lamps with hard shadows from shadow maps.

A shadow map is a depth image from far away in the direction of its lamp. Averaged over enough lamps, shadows become
soft, corners and cavities darken as under a cloudy sky, and bodies have contact shadows on the ground. Colours are
linear, 1 = white.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kit1000.numerics.compiled import compiled
from kit1000.pictures.shadow_maps import shadow_maps
from kit1000.pose import Pose, quaternion_between

MAP_SIZE = 512  # [px] side of a shadow map, unless another is asked for
LAMP_DISTANCE = 1000.0  # in radii of the scene: rays are parallel to a quarter of a texel
KEY_SPREAD = 0.16  # sine of the half angle of the key light: its shadows are soft but have a shape
KEY_COLOUR = (0.62, 0.60, 0.56)  # warm; with the sky, a level surface has its own colour, slightly lighter
SKY_COLOUR = (0.48, 0.50, 0.53)  # cool
BOUNCE_COLOUR = (0.21, 0.205, 0.20)  # light reflected by the ground from below
GLOSS = 0.07  # satin plastic
FADE_BORDER = 0.08  # fraction of the image along its border in which shadows on the ground fade out
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
HEIGHTS, AZIMUTHS = 65, 8  # normals at which the light of the sky without shadows is tabled, and averaged over


class Lamps(NamedTuple):
    """L lamps with shadow maps: first `key_count` samples of the key light, then samples of the sky."""

    directions: np.ndarray
    """(L, 3) unit vectors from the scene to the lamps."""
    weights: np.ndarray
    """(L,): a level surface gets 1 in total from the key light, and 1 from the sky."""
    map_from_world: np.ndarray
    """(L, 3, 4): from a point (x, y, z, 1) to column, row [px] and depth [m] in a shadow map."""
    shadow_maps: np.ndarray
    """(L, S, S) float32 [m] depth from the lamp, 0 for no surface."""
    texel: float
    """[m] width of a pixel of a shadow map at the scene."""
    key_count: int
    open_key: np.ndarray
    """(3,) whose product with a normal is the key light there without shadows."""
    open_sky: np.ndarray
    """(h,) light of the sky without shadows, at normals of heights -1 .. 1."""


class ShadingScene(NamedTuple):
    """The b bodies of a picture, with m faces in all, as the loop over pixels needs them."""

    first_face: np.ndarray
    """(b,) index of the first face of each body."""
    corners: np.ndarray
    """(m, 3, 3) [m], world."""
    normals: np.ndarray
    """(m, 3, 3) shading normals at the corners, world."""
    face_normals: np.ndarray
    """(m, 3) face normals, world."""
    albedo: np.ndarray
    """(b, 3) linear colour of each body."""


def key_directions(n: int, towards: np.ndarray) -> np.ndarray:
    """(n, 3) unit vectors distributed evenly over the round key light in the direction `towards` (3,)."""
    count = np.arange(n)
    radius, angle = KEY_SPREAD * np.sqrt((count + 0.5) / n), GOLDEN_ANGLE * count
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1)
    return Pose(quaternion_between(np.array((0.0, 0.0, 1.0)), towards), np.zeros(3)).rotate(disc)


def sky_directions(n: int) -> np.ndarray:
    """(n, 3) unit vectors distributed evenly over the sky above 6 degrees (a Fibonacci spiral)."""
    count = np.arange(n)
    z, angle = 0.1 + 0.9 * (count + 0.5) / n, GOLDEN_ANGLE * count
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def place_lamps(
    corners: np.ndarray, ball: tuple[np.ndarray, float], key: np.ndarray, sky: np.ndarray, map_size: int = MAP_SIZE
) -> Lamps:
    """Lamps in directions key (k, 3) and sky (s, 3) for triangles (m, 3, 3) within `ball`: centre (3,), radius [m].

    map_size: [px] side of a shadow map.
    """
    centre, radius = ball
    texel = 2 * radius / (map_size - 4)
    directions = np.concatenate([key, sky])
    map_from_world = _parallel_projections(directions, centre, LAMP_DISTANCE * radius)
    map_from_world[:, :2] /= texel
    map_from_world[:, :2, 3] += (map_size - 1) / 2
    weights = np.concatenate([np.full(len(key), 1 / key[:, 2].sum()), np.full(len(sky), 1 / sky[:, 2].sum())])
    maps = shadow_maps(corners, map_from_world, map_size)
    return Lamps(directions, weights, map_from_world, maps, texel, len(key), key.sum(0) / key[:, 2].sum(), _open(sky))


def _open(sky: np.ndarray) -> np.ndarray:
    """(HEIGHTS,) light of a sky (s, 3) without shadows, at normals of heights -1 .. 1, a mean over their azimuths."""
    height, azimuth = np.linspace(-1, 1, HEIGHTS)[:, None], np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    level = np.sqrt(1 - height**2)
    normals = np.stack(np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), height), axis=-1)
    return np.maximum(normals @ sky.T, 0).sum(2).mean(1) / sky[:, 2].sum()


def _parallel_projections(directions: np.ndarray, centre: np.ndarray, distance: float) -> np.ndarray:
    """(L, 3, 4) [m] from a point (x, y, z, 1) to its place across rays from directions (L, 3), and along them.

    The centre (3,) [m] is in the middle, at a distance [m]. Each lamp has another roll, so that the pixel grids of
    their maps are not aligned.
    """
    aside = np.cross(directions, np.eye(3)[np.abs(directions).argmin(1)])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    above, roll = np.cross(directions, aside), GOLDEN_ANGLE * np.arange(len(directions))[:, None]
    c, s = np.cos(roll), np.sin(roll)
    axes = np.stack([c * aside + s * above, c * above - s * aside, -directions], axis=1)
    ends = -np.einsum("kij,j->ki", axes, centre)
    ends[:, 2] += distance
    return np.concatenate([axes, ends[..., None]], axis=2)


@compiled
def illuminate(intrinsics, rotation, eye, image, scene, lamps, turn, ground, background, shadow, drawn, colours, out):
    """Write the linear colour of each pixel to `out` (H, W, 3).

    `rotation` (3, 3) and `eye` (3,) are world_from_camera; `image` is the depth, body ids and face ids; `turn` is which
    of how many groups of lamps casts the shadows of the first pixel, its neighbours take the next groups in turn;
    `ground` is the height [m] of a floor of the colour `background`, which shadows darken by up to `shadow`; NaN for no
    floor. `drawn` is whether `out` holds the floor already. `colours` (3, 3): of the key light, the sky and the light
    from below.
    """
    depth, ids, faces = image
    start, groups = turn
    point, normal, face_normal, view = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for group in range(groups):  # outermost, so that its shadow maps stay in the cache
        for v in range(depth.shape[0]):
            for u in range((group - start - 2 * v) % groups, depth.shape[1], groups):
                body = ids[v, u] - 1
                if body < 0 and drawn:
                    continue
                _set_view(intrinsics, rotation, u, v, view)
                if body < 0:
                    fade = shadow * _fade(intrinsics, u, v)
                    _set_floor(eye, view, lamps, ground, background, fade, colours, point, normal, out, v, u)
                    continue
                for i in range(3):
                    point[i] = eye[i] + depth[v, u] * view[i]
                _set_normals(scene, scene.first_face[body] + faces[v, u], view, point, normal, face_normal)
                key, sky, gloss, open_sky = _incident_light(lamps, group, groups, point, normal, face_normal, view)
                below = (0.5 - 0.5 * normal[2]) * (0.4 + 0.6 * sky / max(open_sky, 0.05))
                for i in range(3):
                    light = key * colours[0, i] + sky * colours[1, i] + below * colours[2, i]
                    out[v, u, i] = scene.albedo[body, i] * light + gloss * colours[0, i]


@compiled
def draw_floor(intrinsics, rotation, eye, lamps, ground, background, shadow, colours, step, out):
    """Write the linear colour of the floor to `out` (H, W, 3), interpolated between every step-th pixel.

    Arguments as of `illuminate`.
    """
    point, normal, view = np.empty(3), np.empty(3), np.empty(3)
    floor = np.empty((out.shape[0] // step + 2, out.shape[1] // step + 2, 3), np.float32)
    for v in range(floor.shape[0]):
        for u in range(floor.shape[1]):
            _set_view(intrinsics, rotation, u * step, v * step, view)
            fade = shadow * _fade(intrinsics, u * step, v * step)
            _set_floor(eye, view, lamps, ground, background, fade, colours, point, normal, floor, v, u)
    for v in range(out.shape[0]):
        i = v // step
        down = v / step - i
        for u in range(out.shape[1]):
            j = u // step
            along = u / step - j
            for c in range(3):
                upper = floor[i, j, c] + along * (floor[i, j + 1, c] - floor[i, j, c])
                lower = floor[i + 1, j, c] + along * (floor[i + 1, j + 1, c] - floor[i + 1, j, c])
                out[v, u, c] = upper + down * (lower - upper)


@compiled
def _set_view(intrinsics, rotation, u, v, view):
    """Set the direction in which a pixel looks, of depth 1."""
    p, q = (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
    for i in range(3):
        view[i] = rotation[i, 0] * p + rotation[i, 1] * q + rotation[i, 2]


@compiled
def _set_floor(eye, view, lamps, ground, background, shadow, colours, point, normal, out, v, u):
    """Write the colour of the floor in a direction to a pixel; the background's where there is none."""
    for i in range(3):
        out[v, u, i] = background[i]
    if not (view[2] < 0 and eye[2] > ground):
        return
    for i in range(3):
        point[i] = eye[i] + (ground - eye[2]) / view[2] * view[i]
        normal[i] = 0.0
    normal[2] = 1.0
    key, sky, _, _ = _incident_light(lamps, 0, 1, point, normal, normal, view)
    for i in range(3):
        share = (key * colours[0, i] + sky * colours[1, i]) / (colours[0, i] + colours[1, i])
        out[v, u, i] = background[i] * (1 - shadow * (1 - share))


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
def _incident_light(lamps, group, groups, point, normal, face_normal, view):
    """Key light and sky light at a point, the reflection of the key light, and the light of the sky without shadows.

    Shadows are looked up for every lamp of one of the groups, in turns; they stand for those of all lamps.
    """
    # all by single numbers: slices are counted references
    directions, weights, maps, shadow_maps, texel, key_count, key_sum, sky_table = lamps
    lit_key, lit_sky, asked_key, asked_sky = 0.0, 0.0, 0.0, 0.0
    nx, ny, nz = normal[0], normal[1], normal[2]
    # An offset from the surface prevents self-shadowing at the resolution of the shadow maps.
    x, y, z = (
        point[0] + 1.5 * texel * face_normal[0],
        point[1] + 1.5 * texel * face_normal[1],
        point[2] + 1.5 * texel * face_normal[2],
    )
    for k in range(group, directions.shape[0], groups):
        share = weights[k] * (nx * directions[k, 0] + ny * directions[k, 1] + nz * directions[k, 2])
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
            asked_key, lit_key = asked_key + share, lit_key + lit
        else:
            asked_sky, lit_sky = asked_sky + share, lit_sky + lit
    open_key, open_sky = asked_key, asked_sky
    if groups > 1:
        open_key = max(nx * key_sum[0] + ny * key_sum[1] + nz * key_sum[2], 0.0)
        place = (nz + 1) / 2 * (HEIGHTS - 1)
        below = min(max(int(place), 0), HEIGHTS - 2)
        open_sky = sky_table[below] + (place - below) * (sky_table[below + 1] - sky_table[below])
    key = open_key * lit_key / asked_key if asked_key > 0 else 0.0
    sky = open_sky * lit_sky / asked_sky if asked_sky > 0 else 0.0
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
