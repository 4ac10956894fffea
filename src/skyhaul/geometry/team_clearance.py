# SPDX-License-Identifier: Apache-2.0
"""Clearance of the team's shape, an upright cylinder, to one obstacle, with its gradient."""

import math

import numpy as np

from skyhaul.geometry.shapes import BOX, CAPSULE
from skyhaul.jit import njit
from skyhaul.types import Array, IntArray

Clearance = tuple[float, float, float, float]
"""Signed distance [m] and the unit vector along which it grows, obstacle to team, W axes."""

# mypy: disable-error-code="no-any-return"


@njit
def prism_sdf(across: float, along: float) -> float:
    """Signed distance of two prisms with one axis from the gaps across and along it [m]."""
    ox, oz = max(across, 0.0), max(along, 0.0)
    return math.sqrt(ox * ox + oz * oz) + min(max(across, along), 0.0)


@njit
def team_clearance(
    radius: float,
    above: float,
    below: float,
    p_WL: Array,
    kind: int,
    size: Array,
    p_WO: Array,
    R_WO: Array,
) -> float:
    """Signed distance between the team's upright cylinder and one obstacle [m].

    Args:
        radius: Of the cylinder [m].
        above: Height of its top over P [m].
        below: Depth of its bottom under P [m].
        p_WL: Load's centre of mass on the axis, (3,) [m].
        kind: SPHERE, BOX (upright) or CAPSULE.
        size: (3,), as in `ShapeArrays`.
        p_WO: Centre of the obstacle, (3,) [m].
        R_WO: Its attitude, (3, 3).

    Returns:
        Distance, negative on overlap: exact for spheres and boxes, exact in sign and a lower
        bound of the depth for capsules.

    Limits:
        A box must be upright; its yaw is free.
    """
    half = 0.5 * (above + below)
    x, y = p_WO[0] - p_WL[0], p_WO[1] - p_WL[1]
    z = p_WO[2] - p_WL[2] - 0.5 * (above - below)
    if kind == BOX:
        bx, by = R_WO[0, 0] * x + R_WO[1, 0] * y, R_WO[0, 1] * x + R_WO[1, 1] * y
        ex, ey = abs(bx) - size[0], abs(by) - size[1]
        return prism_sdf(prism_sdf(ex, ey) - radius, abs(z) - half - size[2])
    if kind == CAPSULE:
        t = _closest_on_axis(radius, half, x, y, z, size[1], R_WO)
        x, y, z = x + t * R_WO[0, 2], y + t * R_WO[1, 2], z + t * R_WO[2, 2]
    return prism_sdf(math.sqrt(x * x + y * y) - radius, abs(z) - half) - size[0]


@njit
def team_clearance_gradient(
    radius: float,
    above: float,
    below: float,
    p_WL: Array,
    kind: int,
    size: Array,
    p_WO: Array,
    R_WO: Array,
) -> Clearance:
    """`team_clearance` and its gradient by `p_WL`: the unit vector from obstacle to team.

    Where it jumps it is one of the directions on either side. While the axis of a capsule runs
    through the cylinder it is the way out from the axis' deepest point, not the gradient.
    """
    half = 0.5 * (above + below)
    x, y = p_WO[0] - p_WL[0], p_WO[1] - p_WL[1]
    z = p_WO[2] - p_WL[2] - 0.5 * (above - below)
    if kind == BOX:
        bx, by = R_WO[0, 0] * x + R_WO[1, 0] * y, R_WO[0, 1] * x + R_WO[1, 1] * y
        ex, ey = abs(bx) - size[0], abs(by) - size[1]
        gx, gy = _prism_gradient(ex, ey)
        gx, gy = math.copysign(gx, bx), math.copysign(gy, by)
        nx, ny = R_WO[0, 0] * gx + R_WO[0, 1] * gy, R_WO[1, 0] * gx + R_WO[1, 1] * gy
        across, along = prism_sdf(ex, ey) - radius, abs(z) - half - size[2]
        rounding = 0.0
    else:
        if kind == CAPSULE:
            t = _closest_on_axis(radius, half, x, y, z, size[1], R_WO)
            x, y, z = x + t * R_WO[0, 2], y + t * R_WO[1, 2], z + t * R_WO[2, 2]
        rho = math.sqrt(x * x + y * y)
        nx, ny = (x / rho, y / rho) if rho > 1e-12 else (1.0, 0.0)
        across, along, rounding = rho - radius, abs(z) - half, size[0]
    gr, gz = _prism_gradient(across, along)
    return (
        prism_sdf(across, along) - rounding,
        -gr * nx,
        -gr * ny,
        -math.copysign(gz, z),
    )


@njit
def _prism_gradient(across: float, along: float) -> tuple[float, float]:
    """Gradient of `prism_sdf`."""
    if across <= 0.0 or along <= 0.0:
        return (1.0, 0.0) if across > along else (0.0, 1.0)
    norm = math.sqrt(across * across + along * along)
    return across / norm, along / norm


@njit
def _closest_on_axis(
    radius: float, half: float, x: float, y: float, z: float, reach: float, R_WO: Array
) -> float:
    """Place on a capsule's axis, in [-reach, reach], closest to an upright cylinder at 0.

    The signed distance along a straight line is convex: bisection on the sign of its slope.
    """
    ux, uy, uz = R_WO[0, 2], R_WO[1, 2], R_WO[2, 2]
    low, high = -reach, reach
    for _ in range(48):
        t = 0.5 * (low + high)
        px, py, pz = x + t * ux, y + t * uy, z + t * uz
        rho = math.sqrt(px * px + py * py)
        gr, gz = _prism_gradient(rho - radius, abs(pz) - half)
        slope = math.copysign(gz, pz) * uz
        if rho > 1e-15:
            slope += gr * (px * ux + py * uy) / rho
        if slope < 0.0:
            low = t
        else:
            high = t
    return 0.5 * (low + high)


@njit
def team_clearances(
    shape: tuple[float, float, float],
    p_WL: Array,
    kind: IntArray,
    size: Array,
    p_WO: Array,
    R_WO: Array,
) -> Array:
    """`team_clearance` to m obstacles, (m,) [m]; `shape` is (radius, above, below)."""
    out = np.empty(len(kind))
    for j in range(len(kind)):
        out[j] = team_clearance(
            shape[0], shape[1], shape[2], p_WL, kind[j], size[j], p_WO[j], R_WO[j]
        )
    return out
