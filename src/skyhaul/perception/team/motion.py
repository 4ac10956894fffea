# SPDX-License-Identifier: Apache-2.0
"""How load and vehicles move between measurements: IMU samples and new odometry."""

import math

import numpy as np

from skyhaul.geometry.kernels import (
    Vec3Out,
    cross,
    mat_vec,
    quat_exp,
    quat_inv_rotate,
    quat_mul,
    quat_rotate,
    quat_to_R,
)
from skyhaul.jit import njit
from skyhaul.perception.team.layout import (
    KEPT,
    LOAD_NE,
    VEHICLE_NE,
    FilterParams,
    FilterState,
)
from skyhaul.types import Array


@njit
def three(a: Array, k: int) -> Vec3Out:
    """Entries k, k + 1, k + 2."""
    return a[k], a[k + 1], a[k + 2]


@njit
def turned(x: Array, w: Vec3Out, dt: float) -> None:
    """Turn the attitude of a pose (16,) by the rate w, body axes, for dt; in place."""
    q = quat_mul(x[3:7], quat_exp((w[0] * dt, w[1] * dt, w[2] * dt)))
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for c in range(4):
        x[3 + c] = scale * q[c]


@njit
def integrate(x: Array, w: Vec3Out, s: Vec3Out, dt: float, g: float) -> None:
    """Move a pose and motion (16,) by one sample; dt < 0 goes back.

    v += (R s - g e_3) dt, p likewise, R <- R Exp(w dt); s acts at the attitude of half time.

    Args:
        x: Pose and motion, changed in place.
        w: Rate without bias, body axes [rad/s].
        s: Specific force without bias, body axes [m/s^2].
        dt: Duration [s].
        g: Gravity [m/s^2].
    """
    half = quat_mul(x[3:7], quat_exp((0.5 * w[0] * dt, 0.5 * w[1] * dt, 0.5 * w[2] * dt)))
    a = quat_rotate(half, s)
    for c in range(3):
        acc = a[c] - (g if c == 2 else 0.0)
        x[c] += x[7 + c] * dt + 0.5 * acc * dt * dt
        x[7 + c] += acc * dt
    turned(x, w, dt)


@njit
def advance_load(
    p: FilterParams, s: FilterState, t_us: float, gyro: Vec3Out, accel: Vec3Out, spread: float
) -> None:
    """Move the load by one sample of its IMU, with its covariance.

    Args:
        p: Parameters.
        s: State, changed.
        t_us: End of the sample's period [us].
        gyro: Rate as read, L axes [rad/s].
        accel: Specific force as read, L axes [m/s^2].
        spread: Factor on the densities of the noise; above 1 for a sample made up for a lost one.
    """
    dt = 1e-6 * (t_us - s.load_us[0])
    x, P = s.load, s.P
    w = (gyro[0] - x[10], gyro[1] - x[11], gyro[2] - x[12])
    f = (accel[0] - x[13], accel[1] - x[14], accel[2] - x[15])
    F = np.zeros((LOAD_NE, LOAD_NE))
    _load_transition(x, w, f, dt, F)
    A = np.zeros((LOAD_NE, P.shape[0]))
    for i in range(LOAD_NE):
        for k in range(LOAD_NE):
            if F[i, k] != 0.0:
                for j in range(P.shape[0]):
                    A[i, j] += F[i, k] * P[k, j]
    for i in range(LOAD_NE):
        for j in range(LOAD_NE, P.shape[0]):
            P[i, j] = A[i, j]
            P[j, i] = A[i, j]
        for j in range(i + 1):
            total = 0.0
            for k in range(LOAD_NE):
                total += A[i, k] * F[j, k]
            P[i, j] = total
            P[j, i] = total
    d, fast = p.load_noise, spread * spread
    for c in range(3):
        P[c, c] += fast * d[1] * d[1] * dt * dt * dt / 3.0
        P[3 + c, 3 + c] += fast * d[0] * d[0] * dt
        P[6 + c, 6 + c] += fast * d[1] * d[1] * dt
        P[9 + c, 9 + c] += d[2] * d[2] * dt
        P[12 + c, 12 + c] += d[3] * d[3] * dt
    integrate(x, w, f, dt, p.g)
    old = three(s.load_last, 0)
    first = s.load_us[3] == 0.0
    for c in range(3):
        s.load_last[6 + c] = 0.0 if first or spread > 1.0 else (w[c] - old[c]) / dt
        s.load_last[c], s.load_last[3 + c] = w[c], f[c]
    s.load_us[0] = t_us
    s.load_us[3] += 1.0


@njit
def _load_transition(x: Array, w: Vec3Out, f: Vec3Out, dt: float, F: Array) -> None:
    """Derivative of the error after a sample by the error before, (15, 15); see `integrate`."""
    back = quat_exp((-w[0] * dt, -w[1] * dt, -w[2] * dt))
    half = quat_exp((0.5 * w[0] * dt, 0.5 * w[1] * dt, 0.5 * w[2] * dt))
    R = np.empty((3, 3))
    quat_to_R(quat_mul(x[3:7], half), R)  # at half time
    for i in range(LOAD_NE):
        F[i, i] = 1.0
    for j in range(3):
        e = (1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0)
        turn, push = quat_rotate(back, e), mat_vec(R, cross(quat_inv_rotate(half, e), f))
        slip = mat_vec(R, cross(e, f))  # of the turn at half time by the gyro's bias
        for i in range(3):
            F[3 + i, 3 + j] = turn[i]
            F[6 + i, 3 + j] = push[i] * dt
            F[i, 3 + j] = 0.5 * push[i] * dt * dt
            F[6 + i, 9 + j] = -0.5 * slip[i] * dt * dt
            F[i, 9 + j] = -0.25 * slip[i] * dt * dt * dt
            F[6 + i, 12 + j] = -R[i, j] * dt
            F[i, 12 + j] = -0.5 * R[i, j] * dt * dt
        F[j, 6 + j] = dt
        F[3 + j, 9 + j] = -dt


@njit
def latest(s: FilterState, i: int) -> float:
    """End of the last sample of vehicle i's IMU [us]; -1 before the first."""
    at: float = s.past[i, int(s.head[i] - 1.0) % KEPT, 0] if s.head[i] > 0.0 else -1.0
    return at


@njit
def advance_vehicle(
    p: FilterParams, s: FilterState, i: int, t_us: float, gyro: Vec3Out, accel: Vec3Out
) -> None:
    """Move vehicle i by one sample of its IMU, I axes, and keep the sample.

    Before its first odometry it moves on from where it was surveyed, at rest and without biases.
    Also the specific force at its centre of mass, B axes, into `nav_last[6:9]`.
    """
    row = s.past[i, int(s.head[i]) % KEPT]
    row[0] = t_us
    for c in range(3):
        row[1 + c], row[4 + c] = gyro[c], accel[c]
    x, last = s.nav[i], s.nav_last[i]
    w = (gyro[0] - x[10], gyro[1] - x[11], gyro[2] - x[12])
    f = (accel[0] - x[13], accel[1] - x[14], accel[2] - x[15])
    integrate(x, w, f, p.dt[0], p.g)
    w_B = mat_vec(p.R_BI, w)
    s_B = mat_vec(p.R_BI, accel)
    if s.head[i] > 0.0:
        for c in range(3):
            last[3 + c] += 0.3 * ((w_B[c] - last[c]) / p.dt[0] - last[3 + c])
    for c in range(3):
        last[c] = w_B[c]
    arm = p.p_BI
    lever, swing = cross(three(last, 3), arm), cross(w_B, cross(w_B, arm))
    for c in range(3):
        last[6 + c] = s_B[c] - lever[c] - swing[c]
    s.head[i] += 1.0


@njit
def take_odometry(
    p: FilterParams, s: FilterState, i: int, t_us: float, pose: Array, cov: Array
) -> None:
    """Take a new estimate of vehicle i's odometry in.

    Its frame drifts as the covariance of the estimate grows; its yaw error turns the way flown:
    p += turn_z e_3 x (way since the last estimate). Errors of roll and pitch are stationary and
    fade in `tilt_time`. Where the covariance falls to less than a half, the odometry has found its
    place again: the frame is forgotten.

    Args:
        p: Parameters.
        s: State, changed.
        i: Vehicle.
        t_us: Time of the estimate; samples after it are gone through again [us].
        pose: Pose and motion, (16,).
        cov: Covariance of p and turn, W axes, (6, 6).
    """
    last, before, b = s.vio[i], s.vio_cov[i], LOAD_NE + VEHICLE_NE * i
    found = cov[0, 0] + cov[1, 1] + cov[2, 2] < 0.5 * (before[0, 0] + before[1, 1] + before[2, 2])
    if last[3] < 0.0 or found:
        _new_frame(s, i, cov)
    else:
        _drift(p, s, i, 1e-6 * (t_us - last[3]), pose, cov)
    for c in range(3):
        last[c] = pose[c]
        s.P[b + 6 + c, b + 6 + c] += p.force_walk**2 * 1e-6 * max(0.0, t_us - last[3])
    last[3] = t_us
    before[:] = cov
    x = s.nav[i]
    x[:] = pose
    first = max(0, int(s.head[i]) - KEPT)
    for k in range(first, int(s.head[i])):
        row = s.past[i, k % KEPT]
        if row[0] > t_us:
            w = (row[1] - x[10], row[2] - x[11], row[3] - x[12])
            f = (row[4] - x[13], row[5] - x[14], row[6] - x[15])
            integrate(x, w, f, min(p.dt[0], 1e-6 * (row[0] - t_us)), p.g)


@njit
def _new_frame(s: FilterState, i: int, cov: Array) -> None:
    b, N = LOAD_NE + VEHICLE_NE * i, s.P.shape[0]
    for r in range(6):
        s.offset[i, r] = 0.0
        for j in range(N):
            s.P[b + r, j] = 0.0
            s.P[j, b + r] = 0.0
    for r in range(6):
        for c in range(6):
            s.P[b + r, b + c] = cov[r, c]
        s.P[b + r, b + r] += 1e-8


@njit
def _drift(p: FilterParams, s: FilterState, i: int, dt: float, pose: Array, cov: Array) -> None:
    """Move the frame of vehicle i; see `take_odometry`."""
    P, b, before, N = s.P, LOAD_NE + VEHICLE_NE * i, s.vio_cov[i], s.P.shape[0]
    way = (pose[0] - s.vio[i, 0], pose[1] - s.vio[i, 1])
    lever = (-way[1], way[0])
    fade = math.exp(-dt / p.tilt_time)
    for c in range(2):
        s.offset[i, c] += lever[c] * s.offset[i, 5]
        s.offset[i, 3 + c] *= fade
        for j in range(N):
            P[b + c, j] += lever[c] * P[b + 5, j]
            P[b + 3 + c, j] *= fade
        for j in range(N):
            P[j, b + c] += lever[c] * P[j, b + 5]
            P[j, b + 3 + c] *= fade
    for c in range(3):
        known = before[c, c]
        if c < 2:
            known += 2.0 * lever[c] * before[c, 5] + lever[c] * lever[c] * before[5, 5]
        P[b + c, b + c] += max(cov[c, c] - known, p.frame_walk[0] ** 2 * dt)
    P[b + 5, b + 5] += max(cov[5, 5] - before[5, 5], p.frame_walk[1] ** 2 * dt)
    for c in range(2):
        P[b + 3 + c, b + 3 + c] += (1.0 - fade * fade) * cov[3 + c, 3 + c]


@njit
def vehicle_at(p: FilterParams, s: FilterState, i: int, t_us: float) -> Array:
    """Pose and motion of vehicle i's IMU in W at a time not long ago, (16,)."""
    x = s.nav[i].copy()
    k = int(s.head[i]) - 1
    stop = max(0, k + 1 - KEPT)
    while k >= stop and s.vio[i, 3] >= 0.0:
        row = s.past[i, k % KEPT]
        if row[0] <= t_us:
            break
        w = (row[1] - x[10], row[2] - x[11], row[3] - x[12])
        f = (row[4] - x[13], row[5] - x[14], row[6] - x[15])
        integrate(x, w, f, -p.dt[0], p.g)
        k -= 1
    return in_team_frame(s, i, x)


@njit
def in_team_frame(s: FilterState, i: int, x: Array) -> Array:
    """Pose and motion (16,) of vehicle i from its odometry's frame to W."""
    o, y = s.offset[i], x.copy()
    turn = quat_exp((o[3], o[4], o[5]))
    q = quat_mul(turn, x[3:7])
    v = quat_rotate(turn, three(x, 7))
    for c in range(3):
        y[c], y[7 + c] = x[c] + o[c], v[c]
    for c in range(4):
        y[3 + c] = q[c]
    return y


@njit
def load_at(p: FilterParams, s: FilterState, t_us: float) -> Array:
    """Pose and motion of the load's IMU at a time near that of the state, (16,).

    The rate goes on with the last angular acceleration, the force stays.
    """
    x = s.load.copy()
    dt = 1e-6 * (t_us - s.load_us[0])
    if dt != 0.0:
        integrate(x, load_rate(p, s, 0.5 * dt), three(s.load_last, 3), dt, p.g)
    return x


@njit
def load_rate(p: FilterParams, s: FilterState, dt: float) -> Vec3Out:
    """Rate of the load dt after the time of its state, L axes [rad/s].

    The last sample is the mean over its period; it goes on with the last angular acceleration.
    """
    last, lead = s.load_last, dt + 0.5 * p.dt[1]
    return last[0] + lead * last[6], last[1] + lead * last[7], last[2] + lead * last[8]
