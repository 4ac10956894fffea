# SPDX-License-Identifier: Apache-2.0
"""Signed distance between posed convex shapes, surface to surface, for use inside numba.

A shape is a core grown by a radius: a sphere is a point and a radius, a capsule a segment and a
radius; boxes and cylinders are cores without one. Pairs of round cores and sphere against box or
cylinder have closed forms; the other pairs run GJK on the cores.
"""

import math

from skyhaul.geometry.gjk import core_overlap, gjk_distance
from skyhaul.geometry.shapes import BOX, CAPSULE, SPHERE, ShapeArrays
from skyhaul.geometry.team_clearance import (
    prism_sdf,
    team_clearance,
    team_clearance_gradient,
    team_clearances,
)
from skyhaul.jit import njit

# mypy: disable-error-code="no-any-return"

__all__ = [
    "bounding_radius",
    "lowest_point",
    "point_distance",
    "rounding",
    "shape_distance",
    "team_clearance",
    "team_clearance_gradient",
    "team_clearances",
]


@njit
def shape_distance(a: ShapeArrays, i: int, b: ShapeArrays, j: int) -> float:
    """Signed distance between shape i of `a` and shape j of `b` [m].

    Separated shapes: the distance, to 1e-7 m where it is not in closed form. Overlapping shapes:
    negative; the depth is exact while only the rounding overlaps and for sphere against box,
    sphere against cylinder and box against box, else an upper bound of the depth from a set of
    directions (the axes of both shapes, their cross products, the line of centres).

    Args:
        a: Shapes; of a capsule only column 2 of `R_WO`, its axis, is read.
        i: Row of `a`.
        b: Shapes, may be `a`.
        j: Row of `b`.
    """
    ka, kb = a.kind[i], b.kind[j]
    if ka == SPHERE:
        d = point_distance(b, j, a.p_WO[i, 0], a.p_WO[i, 1], a.p_WO[i, 2])
        return d - a.size[i, 0]
    if kb == SPHERE:
        d = point_distance(a, i, b.p_WO[j, 0], b.p_WO[j, 1], b.p_WO[j, 2])
        return d - b.size[j, 0]
    if ka == CAPSULE and kb == CAPSULE:
        return _axis_distance(a, i, b, j) - a.size[i, 0] - b.size[j, 0]
    radius = rounding(a, i) + rounding(b, j)
    d = gjk_distance(a, i, b, j)
    if d > 0.0:
        return d - radius
    return -core_overlap(a, i, b, j) - radius


@njit
def rounding(s: ShapeArrays, j: int) -> float:
    """Radius by which the core of shape j is grown [m]."""
    if s.kind[j] == SPHERE or s.kind[j] == CAPSULE:
        return s.size[j, 0]
    return 0.0


@njit
def bounding_radius(s: ShapeArrays, j: int) -> float:
    """Radius of the smallest ball around the centre of shape j that holds it [m]."""
    k = s.kind[j]
    x, y, z = s.size[j, 0], s.size[j, 1], s.size[j, 2]
    if k == SPHERE:
        return x
    if k == CAPSULE:
        return x + y
    return math.sqrt(x * x + y * y + z * z)


@njit
def lowest_point(s: ShapeArrays, j: int, axis: int, sign: float) -> float:
    """Smallest value of sign * coordinate `axis` over shape j: for distances to walls [m]."""
    k = s.kind[j]
    c = sign * s.p_WO[j, axis]
    x, y, z = s.size[j, 0], s.size[j, 1], s.size[j, 2]
    if k == SPHERE:
        return c - x
    r2 = abs(s.R_WO[j, axis, 2])
    if k == CAPSULE:
        return c - x - y * r2
    if k == BOX:
        return c - x * abs(s.R_WO[j, axis, 0]) - y * abs(s.R_WO[j, axis, 1]) - z * r2
    return c - x * math.sqrt(max(0.0, 1.0 - r2 * r2)) - y * r2


@njit
def point_distance(s: ShapeArrays, j: int, px: float, py: float, pz: float) -> float:
    """Signed distance of a point to the surface of shape j, any kind; exact inside too."""
    dx, dy, dz = px - s.p_WO[j, 0], py - s.p_WO[j, 1], pz - s.p_WO[j, 2]
    k, R = s.kind[j], s.R_WO
    if k == SPHERE:
        return math.sqrt(dx * dx + dy * dy + dz * dz) - s.size[j, 0]
    z = R[j, 0, 2] * dx + R[j, 1, 2] * dy + R[j, 2, 2] * dz
    if k == CAPSULE:
        t = min(max(z, -s.size[j, 1]), s.size[j, 1])
        dx, dy, dz = dx - t * R[j, 0, 2], dy - t * R[j, 1, 2], dz - t * R[j, 2, 2]
        return math.sqrt(dx * dx + dy * dy + dz * dz) - s.size[j, 0]
    x = R[j, 0, 0] * dx + R[j, 1, 0] * dy + R[j, 2, 0] * dz
    y = R[j, 0, 1] * dx + R[j, 1, 1] * dy + R[j, 2, 1] * dz
    if k == BOX:
        return box_sdf(abs(x) - s.size[j, 0], abs(y) - s.size[j, 1], abs(z) - s.size[j, 2])
    return prism_sdf(math.sqrt(x * x + y * y) - s.size[j, 0], abs(z) - s.size[j, 1])


@njit
def box_sdf(ex: float, ey: float, ez: float) -> float:
    """Signed distance of a point to a box from its excess over each half edge [m]."""
    ox, oy, oz = max(ex, 0.0), max(ey, 0.0), max(ez, 0.0)
    outside = math.sqrt(ox * ox + oy * oy + oz * oz)
    return outside + min(max(ex, ey, ez), 0.0)


@njit
def _axis_distance(a: ShapeArrays, i: int, b: ShapeArrays, j: int) -> float:
    """Distance between the axes of two capsules: closest points of two segments.

    Source: Lumelsky, On fast computation of distance between line segments, 1985.
    """
    ux, uy, uz = a.R_WO[i, 0, 2], a.R_WO[i, 1, 2], a.R_WO[i, 2, 2]
    vx, vy, vz = b.R_WO[j, 0, 2], b.R_WO[j, 1, 2], b.R_WO[j, 2, 2]
    dx = b.p_WO[j, 0] - a.p_WO[i, 0]
    dy = b.p_WO[j, 1] - a.p_WO[i, 1]
    dz = b.p_WO[j, 2] - a.p_WO[i, 2]
    ha, hb = a.size[i, 1], b.size[j, 1]
    c = ux * vx + uy * vy + uz * vz
    du, dv = dx * ux + dy * uy + dz * uz, dx * vx + dy * vy + dz * vz
    det = 1.0 - c * c
    s = 0.0
    if det > 1e-12:
        s = min(max((du - c * dv) / det, -ha), ha)
    t = min(max(c * s - dv, -hb), hb)
    s = min(max(c * t + du, -ha), ha)
    t = min(max(c * s - dv, -hb), hb)
    gx = dx + t * vx - s * ux
    gy = dy + t * vy - s * uy
    gz = dz + t * vz - s * uz
    return math.sqrt(gx * gx + gy * gy + gz * gz)
