# SPDX-License-Identifier: Apache-2.0
"""Distance of the cores of two convex shapes by GJK, and their overlap.

Source:
    Gilbert, Johnson, Keerthi, A fast procedure for computing the distance between complex
    objects, 1988; closest points of simplices by regions as in Ericson, Real-time collision
    detection, 2005.
"""

import math

import numpy as np

from skyhaul.geometry.shapes import BOX, CAPSULE, SPHERE, ShapeArrays
from skyhaul.jit import njit
from skyhaul.types import Array

GAP_M = 1e-9
"""GJK ends when the distance is known to this [m]."""
MAX_ITERATIONS = 128

Vec = tuple[float, float, float]

# mypy: disable-error-code="no-any-return"


@njit
def support(s: ShapeArrays, j: int, dx: float, dy: float, dz: float) -> Vec:
    """Point of the core of shape j that lies farthest along d, from its centre, W axes."""
    k, R = s.kind[j], s.R_WO
    if k == SPHERE:
        return 0.0, 0.0, 0.0
    lz = R[j, 0, 2] * dx + R[j, 1, 2] * dy + R[j, 2, 2] * dz
    if k == CAPSULE:
        z = s.size[j, 1] if lz >= 0.0 else -s.size[j, 1]
        return z * R[j, 0, 2], z * R[j, 1, 2], z * R[j, 2, 2]
    lx = R[j, 0, 0] * dx + R[j, 1, 0] * dy + R[j, 2, 0] * dz
    ly = R[j, 0, 1] * dx + R[j, 1, 1] * dy + R[j, 2, 1] * dz
    if k == BOX:
        x = s.size[j, 0] if lx >= 0.0 else -s.size[j, 0]
        y = s.size[j, 1] if ly >= 0.0 else -s.size[j, 1]
        z = s.size[j, 2] if lz >= 0.0 else -s.size[j, 2]
    else:
        rho = math.sqrt(lx * lx + ly * ly)
        scale = s.size[j, 0] / rho if rho > 1e-14 else 0.0
        x, y = scale * lx, scale * ly
        z = s.size[j, 1] if lz >= 0.0 else -s.size[j, 1]
    return (
        R[j, 0, 0] * x + R[j, 0, 1] * y + R[j, 0, 2] * z,
        R[j, 1, 0] * x + R[j, 1, 1] * y + R[j, 1, 2] * z,
        R[j, 2, 0] * x + R[j, 2, 1] * y + R[j, 2, 2] * z,
    )


@njit
def gjk_distance(a: ShapeArrays, i: int, b: ShapeArrays, j: int) -> float:
    """Distance between the cores of two shapes, 0 when they overlap [m]."""
    W = np.empty((4, 3))  # the simplex: points of the Minkowski difference a - b
    ox = a.p_WO[i, 0] - b.p_WO[j, 0]
    oy = a.p_WO[i, 1] - b.p_WO[j, 1]
    oz = a.p_WO[i, 2] - b.p_WO[j, 2]
    vx, vy, vz = (ox, oy, oz) if ox * ox + oy * oy + oz * oz > 1e-12 else (1.0, 0.0, 0.0)
    vv, m = np.inf, 0
    for _ in range(MAX_ITERATIONS):
        ax, ay, az = support(a, i, -vx, -vy, -vz)
        bx, by, bz = support(b, j, vx, vy, vz)
        wx, wy, wz = ox + ax - bx, oy + ay - by, oz + az - bz
        if m > 0:
            d = math.sqrt(vv)
            if d - (vx * wx + vy * wy + vz * wz) / d <= GAP_M:
                return d
        W[m, 0], W[m, 1], W[m, 2] = wx, wy, wz
        m, vx, vy, vz = _closest(W, m + 1)
        shorter = vx * vx + vy * vy + vz * vz
        if m == 4 or shorter < 1e-24:
            return 0.0
        if shorter >= vv:
            return math.sqrt(vv)
        vv = shorter
    return math.sqrt(vv)


@njit
def _closest(W: Array, m: int) -> tuple[int, float, float, float]:
    """Closest point to the origin on a simplex of m points; keeps in W only what it needs.

    Returns:
        Number of points kept (4: the origin is inside) and the closest point.
    """
    if m == 1:
        return 1, W[0, 0], W[0, 1], W[0, 2]
    if m == 2:
        l0, l1 = _closest_on_edge(W, 0, 1)
        return _keep(W, l0, l1, 0.0, 0.0)
    if m == 3:
        l0, l1, l2 = _closest_on_face(W, 0, 1, 2)
        return _keep(W, l0, l1, l2, 0.0)
    return _closest_on_tetrahedron(W)


@njit
def _keep(W: Array, l0: float, l1: float, l2: float, l3: float) -> tuple[int, float, float, float]:
    """Drop the points without weight and add the others up."""
    m, x, y, z = 0, 0.0, 0.0, 0.0
    for k in range(4):
        w = l0 if k == 0 else (l1 if k == 1 else (l2 if k == 2 else l3))
        if w > 0.0:
            px, py, pz = W[k, 0], W[k, 1], W[k, 2]
            x, y, z = x + w * px, y + w * py, z + w * pz
            W[m, 0], W[m, 1], W[m, 2] = px, py, pz
            m += 1
    return m, x, y, z


@njit
def _closest_on_edge(W: Array, i: int, j: int) -> tuple[float, float]:
    """Weights of the point of edge ij closest to the origin."""
    ex, ey, ez = W[j, 0] - W[i, 0], W[j, 1] - W[i, 1], W[j, 2] - W[i, 2]
    ee = ex * ex + ey * ey + ez * ez
    if ee <= 0.0:
        return 1.0, 0.0
    t = -(W[i, 0] * ex + W[i, 1] * ey + W[i, 2] * ez) / ee
    t = min(max(t, 0.0), 1.0)
    return 1.0 - t, t


@njit
def _dot(W: Array, i: int, ex: float, ey: float, ez: float) -> float:
    return W[i, 0] * ex + W[i, 1] * ey + W[i, 2] * ez


@njit
def _closest_on_face(W: Array, i: int, j: int, k: int) -> Vec:
    """Weights of the point of triangle ijk closest to the origin."""
    ux, uy, uz = W[j, 0] - W[i, 0], W[j, 1] - W[i, 1], W[j, 2] - W[i, 2]
    vx, vy, vz = W[k, 0] - W[i, 0], W[k, 1] - W[i, 1], W[k, 2] - W[i, 2]
    d1, d2 = -_dot(W, i, ux, uy, uz), -_dot(W, i, vx, vy, vz)
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    d3, d4 = -_dot(W, j, ux, uy, uz), -_dot(W, j, vx, vy, vz)
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    d5, d6 = -_dot(W, k, ux, uy, uz), -_dot(W, k, vx, vy, vz)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    a, b, c = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if c <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        l0, l1 = _closest_on_edge(W, i, j)
        return l0, l1, 0.0
    if b <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        l0, l2 = _closest_on_edge(W, i, k)
        return l0, 0.0, l2
    if a <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        l1, l2 = _closest_on_edge(W, j, k)
        return 0.0, l1, l2
    total = a + b + c
    return a / total, b / total, c / total


@njit
def _side(W: Array, i: int, j: int, k: int, other: int) -> float:
    """> 0: the origin and point `other` lie on opposite sides of face ijk, or it is flat."""
    ux, uy, uz = W[j, 0] - W[i, 0], W[j, 1] - W[i, 1], W[j, 2] - W[i, 2]
    vx, vy, vz = W[k, 0] - W[i, 0], W[k, 1] - W[i, 1], W[k, 2] - W[i, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    to_origin = -_dot(W, i, nx, ny, nz)
    to_other = _dot(W, other, nx, ny, nz) + to_origin
    size = (nx * nx + ny * ny + nz * nz) ** 0.75
    if abs(to_other) <= 1e-12 * size:
        return 1.0
    return -to_origin * to_other


@njit
def _closest_on_tetrahedron(W: Array) -> tuple[int, float, float, float]:
    """`_closest` of four points."""
    best, b0, b1, b2, b3 = np.inf, 0.0, 0.0, 0.0, 0.0
    outside = False
    for face in range(4):
        i = 0 if face != 0 else 3
        j = 1 if face != 1 else 3
        k = 2 if face != 2 else 3
        if _side(W, i, j, k, face) > 0.0:
            outside = True
            li, lj, lk = _closest_on_face(W, i, j, k)
            x = li * W[i, 0] + lj * W[j, 0] + lk * W[k, 0]
            y = li * W[i, 1] + lj * W[j, 1] + lk * W[k, 1]
            z = li * W[i, 2] + lj * W[j, 2] + lk * W[k, 2]
            d = x * x + y * y + z * z
            if d < best:
                best = d
                l3 = li if face == 0 else (lj if face == 1 else (lk if face == 2 else 0.0))
                b0 = li if face != 0 else 0.0
                b1 = lj if face != 1 else 0.0
                b2 = lk if face != 2 else 0.0
                b3 = l3
    if not outside:
        return 4, 0.0, 0.0, 0.0
    return _keep(W, b0, b1, b2, b3)


@njit
def core_overlap(a: ShapeArrays, i: int, b: ShapeArrays, j: int) -> float:
    """Upper bound of the shortest translation that parts two overlapping cores [m]."""
    dx = b.p_WO[j, 0] - a.p_WO[i, 0]
    dy = b.p_WO[j, 1] - a.p_WO[i, 1]
    dz = b.p_WO[j, 2] - a.p_WO[i, 2]
    best = _overlap_along(a, i, b, j, dx, dy, dz)
    for p in range(3):
        ux, uy, uz = a.R_WO[i, 0, p], a.R_WO[i, 1, p], a.R_WO[i, 2, p]
        best = min(best, _overlap_along(a, i, b, j, ux, uy, uz))
        vx, vy, vz = b.R_WO[j, 0, p], b.R_WO[j, 1, p], b.R_WO[j, 2, p]
        best = min(best, _overlap_along(a, i, b, j, vx, vy, vz))
        for q in range(3):
            vx, vy, vz = b.R_WO[j, 0, q], b.R_WO[j, 1, q], b.R_WO[j, 2, q]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            best = min(best, _overlap_along(a, i, b, j, nx, ny, nz))
    if a.kind[i] != BOX:
        nx, ny, nz = _across(a, i, dx, dy, dz)
        best = min(best, _overlap_along(a, i, b, j, nx, ny, nz))
    if b.kind[j] != BOX:
        nx, ny, nz = _across(b, j, dx, dy, dz)
        best = min(best, _overlap_along(a, i, b, j, nx, ny, nz))
    return max(best, 0.0)


@njit
def _across(s: ShapeArrays, j: int, dx: float, dy: float, dz: float) -> Vec:
    """The part of d that is normal to the axis of shape j."""
    zx, zy, zz = s.R_WO[j, 0, 2], s.R_WO[j, 1, 2], s.R_WO[j, 2, 2]
    along = dx * zx + dy * zy + dz * zz
    return dx - along * zx, dy - along * zy, dz - along * zz


@njit
def _overlap_along(
    a: ShapeArrays, i: int, b: ShapeArrays, j: int, ux: float, uy: float, uz: float
) -> float:
    """Overlap of the cores along a line, the smaller of both senses; inf when u is zero."""
    norm = math.sqrt(ux * ux + uy * uy + uz * uz)
    if norm < 1e-9:
        return np.inf
    ux, uy, uz = ux / norm, uy / norm, uz / norm
    ax, ay, az = support(a, i, ux, uy, uz)
    bx, by, bz = support(b, j, ux, uy, uz)
    reach = ax * ux + ay * uy + az * uz + bx * ux + by * uy + bz * uz  # cores are symmetric
    gap = (
        (b.p_WO[j, 0] - a.p_WO[i, 0]) * ux
        + (b.p_WO[j, 1] - a.p_WO[i, 1]) * uy
        + (b.p_WO[j, 2] - a.p_WO[i, 2]) * uz
    )
    return reach - abs(gap)
