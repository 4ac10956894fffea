# SPDX-License-Identifier: Apache-2.0
"""Which parts a tile can see: those whose balls reach into the cone of its rays."""

import math

from skyhaul.geometry.kernels import mat_t_vec
from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import SceneArrays
from skyhaul.sensors.imaging.frame import Culling
from skyhaul.sensors.imaging.lens import Lens
from skyhaul.types import Array


@njit_ieee
def cull(scene: SceneArrays, p_WC: Array, R_WC: Array, own: int, culling: Culling) -> int:
    """Balls of objects that are there, in C axes; how many."""
    count, balls = 0, scene.balls
    for b in range(balls.part.shape[0]):
        k = balls.part[b]
        o = scene.parts.object[k]
        if o == own or not scene.objects.present[o]:
            continue
        p = balls.p_W[b]
        offset = mat_t_vec(R_WC, (p[0] - p_WC[0], p[1] - p_WC[1], p[2] - p_WC[2]))
        r = balls.radius[b]
        square = offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2 - r * r
        culling.part[count], culling.radius[count] = k, r
        culling.offset[count, 0], culling.offset[count, 1], culling.offset[count, 2] = offset
        culling.tangent[count] = math.sqrt(square) if square > 0.0 else -1.0
        count += 1
    return count


@njit_ieee
def seen_parts(lens: Lens, t: int, count: int, culling: Culling) -> int:
    """Parts whose balls reach into the cone of tile t; how many."""
    a0, a1, a2 = lens.axis[t, 0], lens.axis[t, 1], lens.axis[t, 2]
    cosine, sine = lens.cosine[t], lens.sine[t]
    found, last = 0, -1
    for b in range(count):
        along = a0 * culling.offset[b, 0] + a1 * culling.offset[b, 1] + a2 * culling.offset[b, 2]
        tangent = culling.tangent[b]
        if tangent < 0.0 or along >= tangent * cosine - culling.radius[b] * sine:
            k = culling.part[b]
            if k != last:
                culling.seen[found] = k
                found += 1
                last = k
    return found
