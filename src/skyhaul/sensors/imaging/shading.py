# SPDX-License-Identifier: Apache-2.0
"""How bright points of surfaces are: texture, a sun and light from all of the sky.

Everything is matt. Grey values are linear: 1 is a white surface in full light. Each function looks
at the first n rays of a bundle.
"""

import math

import numpy as np

from skyhaul.geometry.kernels import mat_t_vec
from skyhaul.geometry.shapes import BOX, SPHERE
from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import (
    CEILING,
    FIRST_PART,
    MIXED,
    Bundle,
    Hall,
    Parts,
    SceneArrays,
)
from skyhaul.sensors.imaging.atlas import Atlas, read_textures, sample
from skyhaul.types import Array, IntArray

# mypy: disable-error-code="no-any-return"

AMBIENT, SKYLIGHT, SUN = 0.42, 0.22, 0.46
"""Light from everywhere, more from above, and from the sun."""
GRAIN_TEXELS, GRAIN = 48.0, 0.5
"""Footprint at which the room's grain has faded out, and its contrast."""
STEEPEST = 0.12
"""Footprints of pixels on a surface seen from the side grow no more than 1 over this."""


@njit_ieee
def shade(
    scene: SceneArrays, parts: int, seen: IntArray, only: int, p: Array, rays: Bundle, n: int
) -> None:
    """Give the first n rays their grey.

    First every ray is told which place of which texture it reads and how brightly that is lit,
    surface by surface; then all of them read at once.

    Args:
        scene: Posed.
        parts: How many are in sight.
        seen: Which.
        only: `only_surface` of the rays.
        p: Where the rays begin, (3,) [m].
        rays: `hit` and `range` are known; `grey` is written.
        n: How many.
    """
    hit, faces, solid, nothing = rays.hit, 0, False, False
    for i in range(1 if only != MIXED else n):
        if hit[i] >= FIRST_PART:
            solid = True
        elif hit[i] >= 0:
            faces |= 1 << hit[i]
        else:
            nothing = True
    for face in range(FIRST_PART):
        if faces >> face & 1:
            _find_on_face(scene.hall, scene.atlas, face, p, rays, n)
    if solid:
        for i in range(parts):
            _find_on_part(scene.parts, scene.atlas, scene.sun, seen[i], p, rays, n)
    if solid or faces:
        read_textures(scene.atlas.texel, rays.patches, rays.spots, rays.work, n, rays.grey)
        grey, light = rays.grey, rays.light
        for i in range(n):
            grey[i] *= light[i]
    if faces:
        _add_grain(scene.atlas, rays, n)
    if nothing:
        _shade_sky(scene.hall, scene.atlas, rays, n)
    if faces >> CEILING & 1:
        _open_ceiling(scene.hall, scene.atlas, rays, n)


@njit_ieee
def only_surface(rays: Bundle, n: int) -> int:
    """Code of the surface that all of the first n rays met, or `MIXED`."""
    hit, other = rays.hit, 0
    first = hit[0]
    for i in range(n):
        other |= hit[i] ^ first
    return first if other == 0 else MIXED


@njit_ieee
def _find_on_face(hall: Hall, atlas: Atlas, face: int, p: Array, rays: Bundle, n: int) -> None:
    """Where on one of the six faces the rays lie that leave the room through it."""
    k, axis = hall.face[face], face >> 1
    across, upright, right = (1 if axis == 0 else 0), axis < 2, 1.0
    if face == 0 or face == 3 or axis == 2:  # seen from inside, u runs to the right, v down
        u0 = p[across] - hall.low[across]
    else:
        u0, right = hall.high[across] - p[across], -1.0
    v0, down = (-p[2], 2) if upright else (hall.low[1] - p[1], 1)
    ray, ranges, hit, pixel = rays.ray, rays.range, rays.hit, rays.pixel
    out_u, out_v, out_wide = rays.spots
    ray_u, ray_v, ray_n, steepest = ray[across], ray[down], ray[axis], np.float32(STEEPEST)
    for i in range(n):
        here = np.float32(u0 + right * ranges[i] * ray_u[i])
        out_u[i] = here if hit[i] == face else out_u[i]
    for i in range(n):
        here = np.float32(v0 - ranges[i] * ray_v[i])
        out_v[i] = here if hit[i] == face else out_v[i]
    for i in range(n):
        facing = max(np.float32(abs(ray_n[i])), steepest)
        here = np.float32(ranges[i] * pixel[i]) / np.sqrt(facing)
        out_wide[i] = here if hit[i] == face else out_wide[i]
    start, order = np.int32(atlas.start[k]), np.int32(atlas.order[k])
    per_m, lit = np.float32(1.0 / hall.period[face]), np.float32(hall.light[face])
    starts, orders, pers = rays.patches
    light = rays.light
    for i in range(n):
        starts[i] = start if hit[i] == face else starts[i]
    for i in range(n):
        orders[i] = order if hit[i] == face else orders[i]
    for i in range(n):
        pers[i] = per_m if hit[i] == face else pers[i]
    for i in range(n):
        light[i] = lit if hit[i] == face else light[i]


@njit_ieee
def _add_grain(atlas: Atlas, rays: Bundle, n: int) -> None:
    """Grain on the faces of the room; it fades out before its pyramid ends."""
    grey, grain, texels, hit = rays.grey, rays.fine, rays.work.texels, rays.hit
    read_textures(atlas.texel, rays.grain, rays.spots, rays.work, n, grain)
    one, two, contrast = np.float32(1.0), np.float32(2.0), np.float32(GRAIN)
    slope, zero, middle = np.float32(2.0 / GRAIN_TEXELS), np.float32(0.0), np.float32(0.5)
    for i in range(n):
        fade = max(min(one, two - slope * texels[i]), zero)
        fade = fade if 0 <= hit[i] < FIRST_PART else zero
        grey[i] *= one + contrast * fade * (grain[i] - middle)


@njit_ieee
def _open_ceiling(hall: Hall, atlas: Atlas, rays: Bundle, n: int) -> None:
    """Let the sky into the rays whose place of the ceiling is open."""
    share, hit, grey = rays.fine, rays.hit, rays.grey
    read_textures(atlas.texel, rays.opening, rays.spots, rays.work, n, share)
    for i in range(n):
        if hit[i] == CEILING and share[i] > 0.0:
            d0, d1, d2 = rays.ray[0, i], rays.ray[1, i], rays.ray[2, i]
            sky = _sky(hall, atlas, d0, d1, d2, rays.pixel[i])
            grey[i] += share[i] * (sky - grey[i])
            if share[i] > 0.5:
                hit[i], rays.range[i] = -1, np.inf


@njit_ieee
def _shade_sky(hall: Hall, atlas: Atlas, rays: Bundle, n: int) -> None:
    """Shade the rays that met nothing."""
    for i in range(n):
        if rays.hit[i] == -1:
            d0, d1, d2 = rays.ray[0, i], rays.ray[1, i], rays.ray[2, i]
            rays.grey[i] = _sky(hall, atlas, d0, d1, d2, rays.pixel[i])


@njit_ieee
def _sky(hall: Hall, atlas: Atlas, d0: float, d1: float, d2: float, pixel: float) -> float:
    """Grey of the sky in a direction: paler towards the horizon, with clouds."""
    if d2 < 0.0:
        return 0.62 + 0.5 * max(d2, -0.6)
    scale, k = 0.25 / (d2 + 0.12), hall.clouds
    order = atlas.order[k]
    wide = pixel * scale * scale * 4.0 * (1 << order)
    cloud = sample(atlas.texel, atlas.start[k], order, d0 * scale, d1 * scale, wide)
    return (1.0 - 0.28 * d2) * (0.72 + 0.4 * cloud)


@njit_ieee
def _find_on_part(
    parts: Parts, atlas: Atlas, sun: Array, k: int, p: Array, rays: Bundle, n: int
) -> None:
    """Where on part k the rays lie that met it, and how brightly it is lit there."""
    R, c, kind = parts.R_WP[k], parts.p_WP[k], parts.kind[k]
    s0, s1, s2 = parts.size[k, 0], parts.size[k, 1], parts.size[k, 2]
    q0, q1, q2 = mat_t_vec(R, (p[0] - c[0], p[1] - c[1], p[2] - c[2]))
    l0, l1, l2 = mat_t_vec(R, (sun[0], sun[1], sun[2]))
    up0, up1, up2 = R[2, 0], R[2, 1], R[2, 2]
    per_m, gain, faces = 1.0 / parts.period[k], parts.gain[k], parts.face[k]
    ray, ranges, hit, pixel = rays.ray, rays.range, rays.hit, rays.pixel
    spots, patches, light = rays.spots, rays.patches, rays.light
    for i in range(n):
        if hit[i] != FIRST_PART + k:
            continue
        far, stretch = ranges[i], 1.0
        d0, d1, d2 = mat_t_vec(R, (ray[0, i], ray[1, i], ray[2, i]))
        a, b, e = q0 + far * d0, q1 + far * d1, q2 + far * d2
        n0, n1, n2 = _normal(kind, s0, s1, s2, a, b, e)
        u0, u1, u2 = a + s0, b + s1, e + s2
        if kind == SPHERE:  # the six sides of the cube around it
            stretch = 1.0 / max(abs(n0), abs(n1), abs(n2))
            u0, u1, u2 = a * stretch + s0, b * stretch + s0, e * stretch + s0
        elif kind != BOX:
            u0, u1, u2 = a + s0, b + s0, e + s1 + s0
        if abs(n2) >= abs(n0) and abs(n2) >= abs(n1):
            face, u, v = (5, u0, -u1) if n2 > 0.0 else (4, u0, u1)
        elif abs(n0) >= abs(n1):
            face, u, v = (1, u1, -u2) if n0 > 0.0 else (0, -u1, -u2)
        else:
            face, u, v = (3, -u0, -u2) if n1 > 0.0 else (2, u0, -u2)
        facing = max(abs(n0 * d0 + n1 * d1 + n2 * d2), STEEPEST)
        wide = far * pixel[i] * stretch / math.sqrt(facing)
        lit = AMBIENT + SKYLIGHT * (0.5 + 0.5 * (n0 * up0 + n1 * up1 + n2 * up2))
        lit += SUN * max(n0 * l0 + n1 * l1 + n2 * l2, 0.0)
        t = faces[face]
        patches.start[i], patches.order[i], patches.per_m[i] = atlas.start[t], atlas.order[t], per_m
        spots.across[i], spots.down[i], spots.wide[i] = u, v, wide
        light[i] = gain * lit


@njit_ieee
def _normal(
    kind: int, s0: float, s1: float, s2: float, a: float, b: float, e: float
) -> tuple[float, float, float]:
    """Outward normal of a part at (a, b, e) on its surface, all in its own axes."""
    if kind == BOX:
        ea, eb, ee = s0 - abs(a), s1 - abs(b), s2 - abs(e)
        if ee <= ea and ee <= eb:
            return 0.0, 0.0, math.copysign(1.0, e)
        if ea <= eb:
            return math.copysign(1.0, a), 0.0, 0.0
        return 0.0, math.copysign(1.0, b), 0.0
    if kind == SPHERE:
        return a / s0, b / s0, e / s0
    return a / s0, b / s0, (e - min(max(e, -s1), s1)) / s0
