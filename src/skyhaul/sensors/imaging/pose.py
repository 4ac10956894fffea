# SPDX-License-Identifier: Apache-2.0
"""Kernels that move the scene: objects from states, parts from objects."""

import math

from skyhaul.geometry.kernels import cross, mat_mul, mat_vec, quat_to_R
from skyhaul.geometry.shapes import BOX, SPHERE
from skyhaul.jit import njit
from skyhaul.sensors.imaging.arrays import Balls, Objects, Parts
from skyhaul.types import Array


@njit
def pose_object(objects: Objects, row: int, p: Array, q: Array, v: Array, w_O: Array) -> None:
    """Put an object at p, attitude q, with velocity v and angular velocity w_O, its own axes."""
    quat_to_R(q, objects.R_WO[row])
    w = mat_vec(objects.R_WO[row], w_O)
    for c in range(3):
        objects.p_WO[row, c], objects.v_WO[row, c], objects.w_WO[row, c] = p[c], v[c], w[c]


@njit
def pose_cables(objects: Objects, parts: Parts, load: int, hooks_L: Array) -> None:
    """Span every cable from its hook on the load to the centre of its vehicle.

    Its origin is in the middle, its z axis points to the vehicle. It moves as a rigid rod whose
    ends move with hook and vehicle.
    """
    n = hooks_L.shape[0]
    first = parts.kind.shape[0] - n
    for i in range(n):
        vehicle, row = load + 1 + i, load + 1 + n + i
        arm = mat_vec(objects.R_WO[load], hooks_L[i])
        w = objects.w_WO[load]
        turn = cross(w, arm)
        square = 0.0
        axis = objects.R_WO[row]
        for c in range(3):
            hook, centre = objects.p_WO[load, c] + arm[c], objects.p_WO[vehicle, c]
            hook_v, centre_v = objects.v_WO[load, c] + turn[c], objects.v_WO[vehicle, c]
            objects.p_WO[row, c] = 0.5 * (hook + centre)
            objects.v_WO[row, c] = 0.5 * (hook_v + centre_v)
            axis[c, 2], objects.w_WO[row, c] = centre - hook, centre_v - hook_v
            square += axis[c, 2] * axis[c, 2]
        length = max(math.sqrt(square), 1e-9)
        for c in range(3):
            axis[c, 2] /= length
        _complete(axis)
        swing = cross(axis[:, 2], objects.w_WO[row])
        for c in range(3):
            objects.w_WO[row, c] = swing[c] / length
        parts.size[first + i, 1] = 0.5 * length


@njit
def _complete(R: Array) -> None:
    """Give a rotation whose z axis is set its other two axes."""
    x, y, z = R[0, 2], R[1, 2], R[2, 2]
    if abs(x) < 0.6:
        side = math.sqrt(y * y + z * z)
        R[0, 0], R[1, 0], R[2, 0] = 0.0, z / side, -y / side
    else:
        side = math.sqrt(x * x + y * y)
        R[0, 0], R[1, 0], R[2, 0] = y / side, -x / side, 0.0
    R[0, 1], R[1, 1], R[2, 1] = cross(R[:, 2], R[:, 0])


@njit
def pose_parts(parts: Parts, objects: Objects, balls: Balls) -> None:
    """Move parts and their balls to where their objects are."""
    for k in range(parts.kind.shape[0]):
        o = parts.object[k]
        mat_mul(objects.R_WO[o], parts.R_OP[k], parts.R_WP[k])
        p = mat_vec(objects.R_WO[o], parts.p_OP[k])
        for c in range(3):
            parts.p_WP[k, c] = objects.p_WO[o, c] + p[c]
    for b in range(balls.part.shape[0]):
        k = balls.part[b]
        s = parts.size[k]
        if parts.kind[k] == BOX:
            balls.radius[b], reach = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2]), 0.0
        elif parts.kind[k] == SPHERE:
            balls.radius[b], reach = s[0], 0.0
        else:
            balls.radius[b], reach = s[0] + balls.share[b] * s[1], balls.along[b] * s[1]
        for c in range(3):
            balls.p_W[b, c] = parts.p_WP[k, c] + reach * parts.R_WP[k, c, 2]
