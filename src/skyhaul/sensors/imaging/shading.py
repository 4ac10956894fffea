# SPDX-License-Identifier: Apache-2.0
"""How bright points of surfaces are: texture, a sun and light from all of the sky.

Everything is matt. Grey values are linear: 1 is a white surface in full light. Each function
shades those rays of a bundle that met one surface.
"""

import math

import numpy as np

from skyhaul.geometry.kernels import mat_t_vec
from skyhaul.geometry.shapes import BOX, SPHERE
from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import Bundle, Hall, Parts
from skyhaul.sensors.imaging.atlas import Atlas, sample
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"

AMBIENT, SKYLIGHT, SUN = 0.42, 0.22, 0.46
"""Light from everywhere, more from above, and from the sun."""
GRAIN_PER_M, GRAIN_TEXELS, GRAIN = 1.7, 48.0, 0.5
"""Periods of the grain per metre, footprint at which it has faded out, and its contrast."""
STEEPEST = 0.12
"""Footprints of pixels on a surface seen from the side grow no more than 1 over this."""


@njit_ieee
def shade_face(hall: Hall, atlas: Atlas, face: int, p: Array, rays: Bundle) -> None:
    """Shade the rays that leave the room through one of its six faces."""
    texel, k, g, axis = atlas.texel, hall.face[face], hall.detail, face >> 1
    start, n, scale = atlas.start[k], atlas.size[k], 1.0 / hall.period[face]
    grain_start, grain_n, grain_scale = atlas.start[g], atlas.size[g], GRAIN_PER_M * atlas.size[g]
    light, ceiling = hall.light[face], face == 5
    across, upright, right = (1 if axis == 0 else 0), axis < 2, 1.0
    if face == 0 or face == 3 or axis == 2:  # seen from inside, u runs to the right, v down
        u0 = p[across] - hall.low[across]
    else:
        u0, right = hall.high[across] - p[across], -1.0
    v0, down = (-p[2], 2) if upright else (hall.low[1] - p[1], 1)
    for i in range(rays.hit.shape[0]):
        if rays.hit[i] != face:
            continue
        far = rays.range[i]
        a, b = u0 + right * far * rays.ray[across, i], v0 - far * rays.ray[down, i]
        wide = far * rays.pixel[i] / math.sqrt(max(abs(rays.ray[axis, i]), STEEPEST))
        grey = light * sample(texel, start, n, a * scale, b * scale, wide * scale * n)
        texels = wide * grain_scale
        if texels < GRAIN_TEXELS:
            grain = sample(texel, grain_start, grain_n, a * GRAIN_PER_M, b * GRAIN_PER_M, texels)
            # it fades out before its pyramid ends, so that no edge shows where it stops
            fade = min(1.0, 2.0 - 2.0 * texels / GRAIN_TEXELS)
            grey *= 1.0 + GRAIN * fade * (grain - 0.5)
        rays.grey[i] = grey
        if ceiling:
            _open_ceiling(hall, atlas, a * scale, b * scale, wide * scale, i, rays)


@njit_ieee
def _open_ceiling(
    hall: Hall, atlas: Atlas, u: float, v: float, wide: float, i: int, rays: Bundle
) -> None:
    """Let the sky into ray i where the ceiling is open."""
    k = hall.opening
    share = sample(atlas.texel, atlas.start[k], atlas.size[k], u, v, wide * atlas.size[k])
    if share > 0.0:
        d0, d1, d2 = rays.ray[0, i], rays.ray[1, i], rays.ray[2, i]
        sky = _sky(hall, atlas, d0, d1, d2, rays.pixel[i])
        rays.grey[i] += share * (sky - rays.grey[i])
        if share > 0.5:
            rays.hit[i], rays.range[i] = -1, np.inf


@njit_ieee
def shade_sky(hall: Hall, atlas: Atlas, rays: Bundle) -> None:
    """Shade the rays that met nothing."""
    for i in range(rays.hit.shape[0]):
        if rays.hit[i] == -1:
            d0, d1, d2 = rays.ray[0, i], rays.ray[1, i], rays.ray[2, i]
            rays.grey[i] = _sky(hall, atlas, d0, d1, d2, rays.pixel[i])


@njit_ieee
def _sky(hall: Hall, atlas: Atlas, d0: float, d1: float, d2: float, pixel: float) -> float:
    """Grey of the sky in a direction: paler towards the horizon, with clouds."""
    if d2 < 0.0:
        return 0.62 + 0.5 * max(d2, -0.6)
    scale, k = 0.25 / (d2 + 0.12), hall.clouds
    n = atlas.size[k]
    wide = pixel * scale * scale * 4.0 * n
    cloud = sample(atlas.texel, atlas.start[k], n, d0 * scale, d1 * scale, wide)
    return (1.0 - 0.28 * d2) * (0.72 + 0.4 * cloud)


@njit_ieee
def shade_part(
    parts: Parts, atlas: Atlas, sun: Array, k: int, code: int, p: Array, rays: Bundle
) -> None:
    """Shade the rays that met part k, marked with a code."""
    R, c, kind = parts.R_WP[k], parts.p_WP[k], parts.kind[k]
    s0, s1, s2 = parts.size[k, 0], parts.size[k, 1], parts.size[k, 2]
    q0, q1, q2 = mat_t_vec(R, (p[0] - c[0], p[1] - c[1], p[2] - c[2]))
    l0, l1, l2 = mat_t_vec(R, (sun[0], sun[1], sun[2]))
    up0, up1, up2 = R[2, 0], R[2, 1], R[2, 2]
    scale, gain, faces = 1.0 / parts.period[k], parts.gain[k], parts.face[k]
    for i in range(rays.hit.shape[0]):
        if rays.hit[i] != code:
            continue
        far, stretch = rays.range[i], 1.0
        d0, d1, d2 = mat_t_vec(R, (rays.ray[0, i], rays.ray[1, i], rays.ray[2, i]))
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
        wide = far * rays.pixel[i] * stretch / math.sqrt(facing)
        lit = AMBIENT + SKYLIGHT * (0.5 + 0.5 * (n0 * up0 + n1 * up1 + n2 * up2))
        lit += SUN * max(n0 * l0 + n1 * l1 + n2 * l2, 0.0)
        t = faces[face]
        start, n = atlas.start[t], atlas.size[t]
        grey = sample(atlas.texel, start, n, u * scale, v * scale, wide * scale * n)
        rays.grey[i] = gain * lit * grey


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
