# SPDX-License-Identifier: Apache-2.0
"""Where rays meet the room and the parts. Each function looks at the first n rays of a bundle."""

import math

import numpy as np

from skyhaul.geometry.kernels import Vec3Out, mat_t_vec
from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import FIRST_PART, Bundle, Hall, Parts
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"


@njit_ieee
def _not_0(d: float) -> float:
    """The component of a ray; 1e-300 for one along a slab, which meets its faces far off."""
    return d if d != 0.0 else 1e-300


@njit_ieee
def meet_room(hall: Hall, p: Array, rays: Bundle, n: int) -> None:
    """Where rays leave the room; a camera outside looks through the near walls."""
    l0, l1, l2 = hall.low[0] - p[0], hall.low[1] - p[1], hall.low[2] - p[2]
    h0, h1, h2 = hall.high[0] - p[0], hall.high[1] - p[1], hall.high[2] - p[2]
    inside = max(l0, l1, l2) <= 0.0 and min(h0, h1, h2) >= 0.0
    ray, far, hit = rays.ray, rays.range, rays.hit
    for i in range(n):
        d0, d1, d2 = ray[0, i], ray[1, i], ray[2, i]
        # a ray along a slab never leaves it
        t0 = (h0 if d0 > 0.0 else l0) / d0 if d0 != 0.0 else np.inf
        t1 = (h1 if d1 > 0.0 else l1) / d1 if d1 != 0.0 else np.inf
        t2 = (h2 if d2 > 0.0 else l2) / d2 if d2 != 0.0 else np.inf
        leave = min(t0, min(t1, t2))
        far[i] = leave
        face = 4 + (d2 > 0.0)
        if t2 > leave:
            face = 0 + (d0 > 0.0) if t0 == leave else 2 + (d1 > 0.0)
        hit[i] = face
    if inside:
        return
    for i in range(n):
        d0, d1, d2 = _not_0(ray[0, i]), _not_0(ray[1, i]), _not_0(ray[2, i])
        enter = max((l0 if d0 > 0.0 else h0) / d0, (l1 if d1 > 0.0 else h1) / d1)
        enter = max(enter, (l2 if d2 > 0.0 else h2) / d2)
        if enter > far[i] or far[i] <= 0.0:
            far[i], hit[i] = np.inf, -1


@njit_ieee
def meet_sphere(parts: Parts, k: int, p: Array, rays: Bundle, n: int) -> None:
    """Where rays meet part k, a sphere, from outside."""
    c, r = parts.p_WP[k], parts.size[k, 0]
    x, y, z = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    power = x * x + y * y + z * z - r * r
    ray, far, hit = rays.ray, rays.range, rays.hit
    for i in range(n):
        b = x * ray[0, i] + y * ray[1, i] + z * ray[2, i]
        square = b * b - power
        if square < 0.0:
            continue
        t = b - math.sqrt(square)
        if 0.0 < t < far[i]:
            far[i], hit[i] = t, FIRST_PART + k


@njit_ieee
def meet_box(parts: Parts, k: int, p: Array, rays: Bundle, n: int) -> None:
    """Where rays meet part k, a box, from outside."""
    R, c, s = parts.R_WP[k], parts.p_WP[k], parts.size[k]
    x, y, z = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    q0, q1, q2 = mat_t_vec(R, (x, y, z))
    R00, R01, R02 = R[0, 0], R[0, 1], R[0, 2]
    R10, R11, R12 = R[1, 0], R[1, 1], R[1, 2]
    R20, R21, R22 = R[2, 0], R[2, 1], R[2, 2]
    s0, s1, s2 = s[0], s[1], s[2]
    ray, far, hit = rays.ray, rays.range, rays.hit
    for i in range(n):
        d0, d1, d2 = ray[0, i], ray[1, i], ray[2, i]
        # slabs: with m = 1 / d, the ray is inside for t in -m q -+ |m| s
        m = 1.0 / _not_0(R00 * d0 + R10 * d1 + R20 * d2)
        o, w = -m * q0, abs(m) * s0
        near, end = o - w, o + w
        m = 1.0 / _not_0(R01 * d0 + R11 * d1 + R21 * d2)
        o, w = -m * q1, abs(m) * s1
        near, end = max(near, o - w), min(end, o + w)
        m = 1.0 / _not_0(R02 * d0 + R12 * d1 + R22 * d2)
        o, w = -m * q2, abs(m) * s2
        near, end = max(near, o - w), min(end, o + w)
        if 0.0 < near <= end and near < far[i]:
            far[i], hit[i] = near, FIRST_PART + k


@njit_ieee
def meet_capsule(parts: Parts, k: int, p: Array, rays: Bundle, n: int) -> None:
    """Where rays meet part k, a capsule, from outside."""
    q, a, r, half = capsule_axis(parts, k, p)
    ray, far, hit = rays.ray, rays.range, rays.hit
    for i in range(n):
        t = capsule_range(q, a, r, half, ray[0, i], ray[1, i], ray[2, i])
        if t < far[i]:
            far[i], hit[i] = t, FIRST_PART + k


@njit_ieee
def capsule_axis(parts: Parts, k: int, p: Array) -> tuple[Vec3Out, Vec3Out, float, float]:
    """Of capsule k: the camera from its centre, its axis, radius and half length."""
    R, c = parts.R_WP[k], parts.p_WP[k]
    q = (p[0] - c[0], p[1] - c[1], p[2] - c[2])
    return q, (R[0, 2], R[1, 2], R[2, 2]), parts.size[k, 0], parts.size[k, 1]


@njit_ieee
def capsule_range(
    q: Vec3Out, a: Vec3Out, r: float, half: float, d0: float, d1: float, d2: float
) -> float:
    """Distance along a ray d from q to a capsule around the origin [m]; inf: it misses."""
    (a0, a1, a2), (x, y, z) = a, q
    da = d0 * a0 + d1 * a1 + d2 * a2
    oa = x * a0 + y * a1 + z * a2
    od = x * d0 + y * d1 + z * d2
    A, B = 1.0 - da * da, od - oa * da
    square = B * B - A * (x * x + y * y + z * z - oa * oa - r * r)
    if square < 0.0:
        return np.inf
    along = oa
    if A > 1e-12:
        t = (-B - math.sqrt(square)) / A
        along = oa + t * da
        if abs(along) <= half:
            return t if t > 0.0 else np.inf
    elif da > 0.0:
        along = -1.0
    end = math.copysign(half, along)
    x, y, z = x - end * a0, y - end * a1, z - end * a2
    b = x * d0 + y * d1 + z * d2
    square = b * b - (x * x + y * y + z * z - r * r)
    t = -b - math.sqrt(square) if square >= 0.0 else np.inf
    return t if t > 0.0 else np.inf
