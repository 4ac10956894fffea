# SPDX-License-Identifier: Apache-2.0
"""A path of straight legs -> closely spaced points with rounded corners."""

import math

import numpy as np

from skyhaul.jit import njit
from skyhaul.mapping.api import MapArrays
from skyhaul.mapping.clearance import static_clearance
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"


@njit
def round_corners(
    m: MapArrays, path: Array, reach: float, clearance: float, spacing: float
) -> Array:
    """Points along a path whose corners are parabolas that begin and end on the legs.

    A parabola takes up to `reach` of both legs, at most half of one that has another corner; it
    is halved until it is clear of what stands, five times at most.

    Args:
        m: The map.
        path: Corners, (n, 3), n > 0 [m].
        reach: Part of the legs that a corner may take [m].
        clearance: Smallest clearance of the curve [m].
        spacing: Distance of the points, about [m].

    Returns:
        Points, (k, 3) [m]; the first and the last are those of the path.
    """
    n = len(path)
    leg = np.empty(max(n - 1, 1))
    for i in range(n - 1):
        leg[i] = _distance(path[i], path[i + 1])
    cut = np.zeros(n)
    for i in range(1, n - 1):
        before = leg[i - 1] if i == 1 else 0.5 * leg[i - 1]
        after = leg[i] if i == n - 2 else 0.5 * leg[i]
        cut[i] = min(reach, min(before, after))
        for _ in range(5):
            if _corner_clear(m, path, leg, i, cut[i], clearance):
                break
            cut[i] *= 0.5
    return _points(path, leg, cut, spacing)


@njit
def _points(path: Array, leg: Array, cut: Array, spacing: float) -> Array:
    """Points on the legs and on the parabolas between them."""
    n = len(path)
    count = 1
    for i in range(n - 1):
        count += _steps(leg[i] - cut[i] - cut[i + 1], spacing)
        if i + 1 < n - 1:
            count += _corner_steps(cut[i + 1], spacing)
    out = np.empty((count, 3))
    out[0] = path[0]
    k = 1
    for i in range(n - 1):
        flat = leg[i] - cut[i] - cut[i + 1]
        steps = _steps(flat, spacing)
        for q in range(1, steps + 1):
            along = (cut[i] + flat * q / steps) / max(leg[i], 1e-12)
            for c in range(3):
                out[k, c] = path[i, c] + along * (path[i + 1, c] - path[i, c])
            k += 1
        if i + 1 < n - 1:
            steps = _corner_steps(cut[i + 1], spacing)
            for q in range(1, steps + 1):
                _on_corner(path, leg, i + 1, cut[i + 1], q / steps, out[k])
                k += 1
    out[k - 1] = path[n - 1]
    return out[:k]


@njit
def _steps(length: float, spacing: float) -> int:
    """Points on a straight leg."""
    return math.ceil(length / spacing) if length > 1e-9 else 0


@njit
def _corner_steps(cut: float, spacing: float) -> int:
    """Points on a corner."""
    return max(4, math.ceil(2.0 * cut / spacing)) if cut > 1e-9 else 0


@njit
def _distance(a: Array, b: Array) -> float:
    """Distance of two points [m]."""
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@njit
def _on_corner(path: Array, leg: Array, i: int, cut: float, u: float, out: Array) -> None:
    """Point of the parabola around corner i, u from 0 to 1, (3,)."""
    for c in range(3):
        back = (path[i - 1, c] - path[i, c]) / max(leg[i - 1], 1e-12)
        on = (path[i + 1, c] - path[i, c]) / max(leg[i], 1e-12)
        out[c] = path[i, c] + cut * ((1.0 - u) * (1.0 - u) * back + u * u * on)


@njit
def _corner_clear(
    m: MapArrays, path: Array, leg: Array, i: int, cut: float, clearance: float
) -> bool:
    """Whether the parabola around corner i keeps clear of what stands."""
    p = np.empty(3)
    steps = max(4, math.ceil(2.0 * cut / m.fine.voxel))
    for q in range(steps + 1):
        _on_corner(path, leg, i, cut, q / steps, p)
        if static_clearance(m, p[0], p[1], p[2]) < clearance:
            return False
    return True


@njit
def curvatures(points: Array) -> Array:
    """Turn per length at every point, (k,) [1/m]; 0 at the ends."""
    k = len(points)
    out = np.zeros(k)
    for i in range(1, k - 1):
        a, b = _distance(points[i - 1], points[i]), _distance(points[i], points[i + 1])
        if a < 1e-9 or b < 1e-9:
            continue
        turn = 0.0
        for c in range(3):
            d = (points[i + 1, c] - points[i, c]) / b - (points[i, c] - points[i - 1, c]) / a
            turn += d * d
        angle = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(turn)))
        out[i] = angle / (0.5 * (a + b))
    return out
