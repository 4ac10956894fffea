# SPDX-License-Identifier: Apache-2.0
"""A point from bearings of cameras whose poses are known."""

import math
from typing import NamedTuple

import numpy as np

from skyhaul.geometry.kernels import mat_t_vec
from skyhaul.jit import njit
from skyhaul.types import Array


class Point(NamedTuple):
    """A point and how well the bearings hold it."""

    p_WP: Array  # (3,) [m]
    parallax_rad: float  # largest angle between two of the bearings
    depth_m: float  # smallest depth in a camera; <= 0: behind one
    error: float  # RMS of the errors in the normalised image


@njit
def triangulate(R_WC: Array, p_WC: Array, xy: Array, p_WP: Array, error: Array) -> None:
    """Least squares in the normalised image: linear, then Gauss-Newton.

    Args:
        R_WC: Attitudes of the cameras, (k, 3, 3).
        p_WC: Their positions, (k, 3) [m].
        xy: Where each sees the point, (k, 2).
        p_WP: Out, the point (3,) [m]; NaN where the bearings are parallel.
        error: Out, errors in the normalised image, (k, 2); infinite behind a camera.
    """
    A, b, rows = np.empty((3, 3)), np.empty(3), np.empty((2, 3))
    inverse_depth = np.ones(len(xy))
    p_WP[:] = 0.0
    for it in range(6):
        A[:] = 0.0
        b[:] = 0.0
        for k in range(len(xy)):
            _rows(R_WC[k], p_WC[k], xy[k], p_WP, it >= 2, inverse_depth[k], rows, error[k])
            for r in range(2):
                for i in range(3):
                    b[i] -= rows[r, i] * error[k, r]
                    for j in range(3):
                        A[i, j] += rows[r, i] * rows[r, j]
        trace = A[0, 0] + A[1, 1] + A[2, 2]
        if not abs(np.linalg.det(A)) > 1e-18 * trace * trace * trace:
            p_WP[:] = np.nan
            return
        p_WP += np.linalg.solve(A, b)
        for k in range(len(xy)):
            depth = mat_t_vec(R_WC[k], p_WP - p_WC[k])[2]
            inverse_depth[k] = 1.0 / max(depth, 0.1)
    for k in range(len(xy)):
        c = mat_t_vec(R_WC[k], p_WP - p_WC[k])
        if c[2] > 0.01:
            error[k, 0], error[k, 1] = c[0] / c[2] - xy[k, 0], c[1] / c[2] - xy[k, 1]
        else:
            error[k] = np.inf


@njit
def _rows(
    R: Array, p: Array, xy: Array, p_WP: Array, exact: bool, scale: float, rows: Array, e: Array
) -> None:
    """Errors and their derivatives by the point: those of the linear problem, or the exact ones."""
    c = mat_t_vec(R, p_WP - p)
    x, y = xy[0], xy[1]
    if exact and c[2] > 0.05:
        x, y, scale = c[0] / c[2], c[1] / c[2], 1.0 / c[2]
        e[0], e[1] = x - xy[0], y - xy[1]
    else:
        e[0], e[1] = scale * (c[0] - x * c[2]), scale * (c[1] - y * c[2])
    for i in range(3):
        rows[0, i] = scale * (R[i, 0] - x * R[i, 2])
        rows[1, i] = scale * (R[i, 1] - y * R[i, 2])


@njit
def largest_angle(R_WC: Array, xy: Array) -> float:
    """Largest angle between the first bearing and another one, in world axes [rad]."""
    first, largest = np.empty(3), 0.0
    for k in range(len(xy)):
        r = (xy[k, 0], xy[k, 1], 1.0)
        n = math.sqrt(r[0] * r[0] + r[1] * r[1] + 1.0)
        d = 0.0
        for i in range(3):
            w = (R_WC[k, i, 0] * r[0] + R_WC[k, i, 1] * r[1] + R_WC[k, i, 2]) / n
            if k == 0:
                first[i] = w
            d += first[i] * w
        largest = max(largest, math.acos(min(1.0, max(-1.0, d))))
    return largest


def locate(R_WC: Array, p_WC: Array, xy: Array) -> Point:
    """The point that the bearings meet in; see `triangulate`."""
    p_WP, error = np.empty(3), np.empty((len(xy), 2))
    triangulate(R_WC, p_WC, xy, p_WP, error)
    parallax = largest_angle(R_WC, xy)
    if not np.all(np.isfinite(p_WP)):
        return Point(p_WP, parallax, -1.0, math.inf)
    depth = float(np.min(np.einsum("ki,ki->k", R_WC[:, :, 2], p_WP - p_WC)))
    rms = math.sqrt(float(np.mean(np.sum(error * error, axis=1)))) if depth > 0.0 else math.inf
    return Point(p_WP, parallax, depth, rms)
