# SPDX-License-Identifier: Apache-2.0
"""The tag seen by a vehicle ties its frame to the load: four corners, eight pixels."""

import numpy as np

from skyhaul.geometry.camera import project_jacobian
from skyhaul.geometry.kernels import (
    cross,
    mat_mul,
    mat_t_vec,
    mat_vec,
    quat_exp,
    quat_log,
    quat_mul,
    quat_to_R,
)
from skyhaul.jit import njit
from skyhaul.perception.team.kalman import update
from skyhaul.perception.team.layout import LOAD_NE, VEHICLE_NE, FilterParams, FilterState
from skyhaul.perception.team.motion import load_at, three, turned, vehicle_at
from skyhaul.types import Array

_FARTHEST_US = 100_000.0
"""A sight that is older is not used [us]."""


@njit
def tag_rows(
    p: FilterParams, load: Array, vehicle: Array, lag: float, i: int, h: Array, H: Array
) -> bool:
    """Where the tag's corners should be in the image of vehicle i, and derivatives.

    y = R_IC^T (R_WI^T (p_WL + R_WL c - p_WI) - p_IC),  u = project(y)

    Args:
        p: Parameters.
        load: Pose and motion of the load's IMU in W when the image was taken, (16,).
        vehicle: Of the vehicle's IMU in W, (16,).
        lag: Time of the image after that of the load's state, for the derivative by v [s].
        i: Vehicle.
        h: Pixels u, v of each corner, (8,), written.
        H: Derivative by the error of the state, (8, N), written.

    Returns:
        Whether every corner has an image.
    """
    R_L, R_I, R_C = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    quat_to_R(load[3:7], R_L)
    quat_to_R(vehicle[3:7], R_I)
    mat_mul(R_I, p.R_IC, R_C)  # R_WC
    J, b = np.empty((2, 3)), LOAD_NE + VEHICLE_NE * i
    H[:] = 0.0
    seen = True
    for k in range(4):
        c = p.corners_L[k]
        arm = mat_vec(R_L, three(c, 0))
        line = (
            load[0] + arm[0] - vehicle[0],
            load[1] + arm[1] - vehicle[1],
            load[2] + arm[2] - vehicle[2],
        )
        at, mount = mat_t_vec(R_C, line), mat_t_vec(p.R_IC, three(p.p_IC, 0))
        y = (at[0] - mount[0], at[1] - mount[1], at[2] - mount[2])
        u, v, ok = project_jacobian(p.camera, y[0], y[1], y[2], J)
        seen = seen and ok
        h[2 * k], h[2 * k + 1] = u, v
        for r in range(2):
            # d(pixel) / d(point in W), as a row
            g = mat_vec(R_C, (J[r, 0], J[r, 1], J[r, 2]))
            in_load = mat_t_vec(R_L, g)
            by_turn = cross(three(c, 0), in_load)  # g . R (dtheta x c)
            by_frame = cross(g, line)  # g . (line x dturn)
            for a in range(3):
                H[2 * k + r, a] = g[a]
                H[2 * k + r, 3 + a] = by_turn[a]
                H[2 * k + r, 6 + a] = lag * g[a]
                H[2 * k + r, b + a] = -g[a]
                H[2 * k + r, b + 3 + a] = by_frame[a]
    return seen


@njit
def take_sight(p: FilterParams, s: FilterState, i: int, t_us: float, corners: Array) -> bool:
    """Correct the state by the tag as vehicle i saw it; False when it is refused.

    Args:
        p: Parameters.
        s: State, changed.
        i: Vehicle.
        t_us: Time of the image [us].
        corners: Pixels, (4, 2).
    """
    lag = 1e-6 * (t_us - s.load_us[0])
    H, h = np.empty((8, s.P.shape[0])), np.empty(8)
    fresh = abs(t_us - s.load_us[0]) <= _FARTHEST_US
    load, vehicle = load_at(p, s, t_us), vehicle_at(p, s, i, t_us)
    good = fresh and tag_rows(p, load, vehicle, lag, i, h, H)
    if good:
        r, variance = np.empty(8), np.full(8, p.sigma_px * p.sigma_px)
        for k in range(4):
            r[2 * k], r[2 * k + 1] = corners[k, 0] - h[2 * k], corners[k, 1] - h[2 * k + 1]
        dx = np.empty(s.P.shape[0])
        good = update(s.P, H, r, variance, dx)
        if good:
            apply(s, dx)
    s.tally[0 if good else 1] += 1.0
    s.tally[2] = 0.0 if good else s.tally[2] + 1.0
    return good


@njit
def apply(s: FilterState, dx: Array) -> None:
    """Add a correction to the state."""
    turned(s.load, (dx[3], dx[4], dx[5]), 1.0)
    for c in range(3):
        s.load[c] += dx[c]
        s.load[7 + c] += dx[6 + c]
        s.load[10 + c] += dx[9 + c]
        s.load[13 + c] += dx[12 + c]
        s.load_last[c] -= dx[9 + c]
        s.load_last[3 + c] -= dx[12 + c]
    for i in range(s.offset.shape[0]):
        b, o = LOAD_NE + VEHICLE_NE * i, s.offset[i]
        turn = quat_mul(quat_exp(three(dx, b + 3)), quat_exp(three(o, 3)))
        o[3], o[4], o[5] = quat_log(turn)
        for c in range(3):
            o[c] += dx[b + c]
            o[6 + c] += dx[b + 6 + c]


@njit
def place_load(s: FilterState, pose: Array, sigma_m: float, sigma_rad: float) -> None:
    """Begin anew with the load at a pose, (16,) of which p, q are used; at rest to 1 m/s."""
    N = s.P.shape[0]
    for r in range(9):
        for j in range(N):
            s.P[r, j] = 0.0
            s.P[j, r] = 0.0
    for c in range(3):
        s.load[c], s.load[7 + c] = pose[c], 0.0
        s.P[c, c] = sigma_m * sigma_m
        s.P[3 + c, 3 + c] = sigma_rad * sigma_rad
        s.P[6 + c, 6 + c] = 1.0
    for c in range(3, 7):
        s.load[c] = pose[c]
    s.tally[2] = 0.0
