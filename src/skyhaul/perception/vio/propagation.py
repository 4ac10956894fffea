# SPDX-License-Identifier: Apache-2.0
"""Motion of the body from IMU samples: the mean, its derivatives and its covariance.

One kernel serves two users. With gravity and the state of the body it propagates the state
(paper eqs 7-9); from identity, at rest and without gravity it gives the preintegrated motion.
"""

import math

import numpy as np

from skyhaul.geometry.kernels import quat_exp, quat_to_R
from skyhaul.jit import njit
from skyhaul.perception.vio.api import NE
from skyhaul.types import Array


@njit
def right_jacobian(phi: Array, out: Array) -> None:
    """Jr: Exp(phi + d) = Exp(phi) Exp(Jr d), to first order in d; into `out`, (3, 3)."""
    x, y, z = phi[0], phi[1], phi[2]
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-6:
        a, b = 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        angle = math.sqrt(angle2)
        a = (1.0 - math.cos(angle)) / angle2
        b = (angle - math.sin(angle)) / (angle2 * angle)
    out[0, 0] = 1.0 - b * (y * y + z * z)
    out[1, 1] = 1.0 - b * (x * x + z * z)
    out[2, 2] = 1.0 - b * (x * x + y * y)
    out[0, 1], out[1, 0] = b * x * y + a * z, b * x * y - a * z
    out[0, 2], out[2, 0] = b * x * z - a * y, b * x * z + a * y
    out[1, 2], out[2, 1] = b * y * z + a * x, b * y * z - a * x


@njit
def product(A: Array, B: Array, out: Array) -> None:
    """Matrix product A B into `out`, any sizes."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            out[i, j] = 0.0
        for k in range(A.shape[1]):
            a = A[i, k]
            if a != 0.0:
                for j in range(B.shape[1]):
                    out[i, j] += a * B[k, j]


@njit
def product_t(A: Array, B: Array, out: Array) -> None:
    """Matrix product A B^T into `out`, any sizes."""
    for i in range(A.shape[0]):
        for j in range(B.shape[0]):
            s = 0.0
            for k in range(A.shape[1]):
                s += A[i, k] * B[j, k]
            out[i, j] = s


@njit
def step_matrices(R: Array, w: Array, a: Array, dt: float, F: Array, G: Array, work: Array) -> None:
    """Error of the state after one sample: e' = F e - G (noise of gyro, noise of accelerometer).

    The acceleration acts at the attitude of half time, so its error has half the turn in it.

    Args:
        R: R_WI before the sample, (3, 3).
        w: Angular rate without bias, (3,) [rad/s].
        a: Specific force without bias, (3,) [m/s^2].
        dt: Duration of the sample [s].
        F: Out, (15, 15).
        G: Out, (15, 6).
        work: Scratch, (6, 3, 3).
    """
    E, H, Jr, Jh, M, N = work[0], work[1], work[2], work[3], work[4], work[5]
    turn = w * dt
    half = 0.5 * turn
    quat_to_R(quat_exp(turn), E)
    quat_to_R(quat_exp(half), H)
    right_jacobian(turn, Jr)
    right_jacobian(half, Jh)
    product(R, H, M)  # R_WI at half time
    N[0, 0] = N[1, 1] = N[2, 2] = 0.0  # N = -M hat(a): d(M a) / d(turn at half time)
    for i in range(3):
        N[i, 0] = -(M[i, 1] * a[2] - M[i, 2] * a[1])
        N[i, 1] = -(M[i, 2] * a[0] - M[i, 0] * a[2])
        N[i, 2] = -(M[i, 0] * a[1] - M[i, 1] * a[0])
    F[:] = 0.0
    G[:] = 0.0
    for i in range(NE):
        F[i, i] = 1.0
    for i in range(3):
        F[i, 6 + i] = dt
        for j in range(3):
            from_turn, from_gyro = 0.0, 0.0
            for k in range(3):
                from_turn += N[i, k] * H[j, k]
                from_gyro += N[i, k] * Jh[k, j]
            F[6 + i, 3 + j] = from_turn * dt
            F[i, 3 + j] = 0.5 * from_turn * dt * dt
            F[3 + i, 3 + j] = E[j, i]
            G[3 + i, j] = Jr[i, j] * dt
            G[6 + i, j] = 0.5 * from_gyro * dt * dt
            G[i, j] = 0.25 * from_gyro * dt * dt * dt
            G[6 + i, 3 + j] = M[i, j] * dt
            G[i, 3 + j] = 0.5 * M[i, j] * dt * dt
    for i in range(9):
        for j in range(6):
            F[i, 9 + j] = -G[i, j]


@njit
def propagate(
    x: Array, R: Array, gravity: Array, samples: Array, noise: Array, Phi: Array, Q: Array
) -> None:
    """Move a state through IMU samples, with its transition matrix and its process noise.

    v += (R (a - b_a) + g) dt, p likewise with 1/2 dt^2, R <- R Exp((w - b_g) dt), where the
    acceleration acts at the attitude of half time. Noise enters Q alone, never the mean.

    Args:
        x: p_WI [m], v_WI [m/s], gyro bias [rad/s], accelerometer bias [m/s^2], (12,); its p and v
            are changed in place, like R.
        R: R_WI, (3, 3).
        gravity: Gravity in W, (3,) [m/s^2]; zero for preintegration.
        samples: Duration [s], angular rate [rad/s], specific force [m/s^2] of each, (k, 7).
        noise: Densities: gyro, accelerometer, walk of the gyro's and of the accelerometer's
            bias, (4,) [rad/s/sqrt(Hz), m/s^2/sqrt(Hz), rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz)].
        Phi: Out: transition of the error, e' = Phi e, (15, 15); columns 9-14 are the derivatives
            by the biases.
        Q: Out: covariance that the noise adds, (15, 15).

    Source:    Paper eqs (7)-(9).
    Deviation: (7)-(8) lack gravity and put the noise into the mean (PAPER_NOTES 40); (9) prints
        exp(w dt / 2), right only for pure quaternions: the half angle is inside Exp
        (PAPER_NOTES 41). See `tests/paper/test_perception.py`.
    """
    F, G = np.empty((NE, NE)), np.empty((NE, 6))
    A, work = np.empty((NE, NE)), np.empty((6, 3, 3))
    w, a, Rn = np.empty(3), np.empty(3), np.empty((3, 3))
    Phi[:] = 0.0
    Q[:] = 0.0
    for i in range(NE):
        Phi[i, i] = 1.0
    for s in range(samples.shape[0]):
        h = samples[s, 0]
        for i in range(3):
            w[i] = samples[s, 1 + i] - x[6 + i]
            a[i] = samples[s, 4 + i] - x[9 + i]
        step_matrices(R, w, a, h, F, G, work)
        for i in range(3):
            acc = gravity[i]
            for j in range(3):
                acc += work[4, i, j] * a[j]
            x[i] += x[3 + i] * h + 0.5 * acc * h * h
            x[3 + i] += acc * h
        product(R, work[0], Rn)
        R[:] = Rn
        product(F, Phi, A)
        Phi[:] = A
        product(F, Q, A)
        product_t(A, F, Q)
        add_noise(G, h, noise, Q)


@njit
def add_noise(G: Array, dt: float, noise: Array, Q: Array) -> None:
    """Q += what white noise and the walk of the biases add in one sample; see `propagate`."""
    for i in range(9):
        for j in range(9):
            for k in range(3):
                Q[i, j] += G[i, k] * G[j, k] * noise[0] * noise[0] / dt
                Q[i, j] += G[i, 3 + k] * G[j, 3 + k] * noise[1] * noise[1] / dt
    for i in range(3):
        Q[9 + i, 9 + i] += noise[2] * noise[2] * dt
        Q[12 + i, 12 + i] += noise[3] * noise[3] * dt
