# SPDX-License-Identifier: Apache-2.0
"""How bright a point of a surface is: texture and a sun with light from all of the sky.

Everything is matt. Grey values are linear: 1 is a white surface in full light.
"""

import math

from skyhaul.geometry.shapes import BOX, SPHERE
from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import SceneArrays
from skyhaul.sensors.imaging.atlas import sample
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"

AMBIENT, SKYLIGHT, SUN = 0.42, 0.22, 0.46
"""Light from everywhere, more from above, and from the sun."""
GRAIN_PER_M = 1.7
"""Periods of the grain per metre."""
STEEPEST = 0.12
"""Footprints of pixels on a surface seen from the side grow no more than 1 over this."""


@njit_ieee
def shade_room(scene: SceneArrays, face: int, p: Array, d: Array, spread: float) -> float:
    """Grey of a point on the room.

    Args:
        scene: The scene.
        face: Which of the six.
        p: The point, W axes, (3,) [m].
        d: Ray that comes there, W axes, (3,).
        spread: Size of the pixel across the ray at the point [m].
    """
    hall, atlas = scene.hall, scene.atlas
    axis, upper = face >> 1, face & 1
    if axis == 0:  # seen from inside, u runs to the right and v down
        a = hall.high[1] - p[1] if upper else p[1] - hall.low[1]
        b = -p[2]
    elif axis == 1:
        a = p[0] - hall.low[0] if upper else hall.high[0] - p[0]
        b = -p[2]
    else:
        a, b = p[0] - hall.low[0], hall.low[1] - p[1]
    wide = spread / math.sqrt(max(abs(d[axis]), STEEPEST))
    k, period = hall.face[face], hall.period[face]
    grey = hall.light[face] * _surface(scene, k, a, b, period, wide)
    if face == 5:
        scale = 1.0 / period
        width = wide * scale * atlas.size[hall.opening]
        share = sample(atlas, hall.opening, a * scale, b * scale, width)
        if share > 0.0:
            grey += share * (shade_sky(scene, d, spread / max(p[2], 1.0)) - grey)
    return grey


@njit_ieee
def is_open(scene: SceneArrays, p: Array) -> bool:
    """Whether the sky shows at a point of the ceiling."""
    hall = scene.hall
    scale = 1.0 / hall.period[5]
    u, v = (p[0] - hall.low[0]) * scale, (hall.low[1] - p[1]) * scale
    return sample(scene.atlas, hall.opening, u, v, 1.0) > 0.5


@njit_ieee
def shade_part(scene: SceneArrays, k: int, p: Array, d: Array, spread: float) -> float:
    """Grey of a point on part k; arguments as `shade_room`."""
    parts, sun = scene.parts, scene.sun
    R, c, size = parts.R_WP[k], parts.p_WP[k], parts.size[k]
    x, y, z = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    a = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
    b = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
    e = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
    period, stretch = parts.period[k], 1.0
    n0, n1, n2 = 0.0, 0.0, 0.0
    if parts.kind[k] == BOX:
        ea, eb, ee = size[0] - abs(a), size[1] - abs(b), size[2] - abs(e)
        u0, u1, u2 = a + size[0], b + size[1], e + size[2]
        if ee <= ea and ee <= eb:
            n2 = math.copysign(1.0, e)
        elif ea <= eb:
            n0 = math.copysign(1.0, a)
        else:
            n1 = math.copysign(1.0, b)
    elif parts.kind[k] == SPHERE:
        n0, n1, n2 = a / size[0], b / size[0], e / size[0]
        # project on the cube around it
        stretch = 1.0 / max(abs(n0), abs(n1), abs(n2))
        u0, u1, u2 = a * stretch + size[0], b * stretch + size[0], e * stretch + size[0]
    else:
        f = e - min(max(e, -size[1]), size[1])
        n0, n1, n2 = a / size[0], b / size[0], f / size[0]
        u0, u1, u2 = a + size[0], b + size[0], e + size[1] + size[0]
    if abs(n2) >= abs(n0) and abs(n2) >= abs(n1):
        face, u, v = (5, u0, -u1) if n2 > 0.0 else (4, u0, u1)
    elif abs(n0) >= abs(n1):
        face, u, v = (1, u1, -u2) if n0 > 0.0 else (0, -u1, -u2)
    else:
        face, u, v = (3, -u0, -u2) if n1 > 0.0 else (2, u0, -u2)
    g0 = R[0, 0] * n0 + R[0, 1] * n1 + R[0, 2] * n2
    g1 = R[1, 0] * n0 + R[1, 1] * n1 + R[1, 2] * n2
    g2 = R[2, 0] * n0 + R[2, 1] * n1 + R[2, 2] * n2
    facing = max(abs(g0 * d[0] + g1 * d[1] + g2 * d[2]), STEEPEST)
    wide = spread * stretch / math.sqrt(facing)
    lit = AMBIENT + SKYLIGHT * (0.5 + 0.5 * g2)
    lit += SUN * max(g0 * sun[0] + g1 * sun[1] + g2 * sun[2], 0.0)
    scale = 1.0 / period
    t = parts.face[k, face]
    grey = sample(scene.atlas, t, u * scale, v * scale, wide * scale * scene.atlas.size[t])
    return parts.gain[k] * lit * grey


@njit_ieee
def shade_sky(scene: SceneArrays, d: Array, pixel: float) -> float:
    """Grey of the sky along a ray d; `pixel` is the angle that a pixel spans [rad]."""
    up = max(d[2], 0.0)
    if d[2] < 0.0:
        return 0.62 + 0.5 * max(d[2], -0.6)
    grey = 1.0 - 0.28 * up
    scale = 0.25 / (up + 0.12)
    k = scene.hall.clouds
    wide = pixel * scale * scale * 4.0 * scene.atlas.size[k]
    cloud = sample(scene.atlas, k, d[0] * scale, d[1] * scale, wide)
    return grey * (0.72 + 0.4 * cloud)


@njit_ieee
def _surface(scene: SceneArrays, k: int, a: float, b: float, period: float, wide: float) -> float:
    """Texture k at (a, b) [m], with grain where a pixel is small enough to show it."""
    atlas, scale = scene.atlas, 1.0 / period
    grey = sample(atlas, k, a * scale, b * scale, wide * scale * atlas.size[k])
    g = scene.hall.detail
    texels = wide * GRAIN_PER_M * atlas.size[g]
    if texels < 48.0:
        grain = sample(atlas, g, a * GRAIN_PER_M, b * GRAIN_PER_M, texels)
        # the grain fades out before its pyramid ends, so that no edge shows where it stops
        weight = 0.5 * min(1.0, 2.0 * (1.0 - texels / 48.0))
        grey *= 1.0 + weight * (grain - 0.5)
    return grey
