# SPDX-License-Identifier: Apache-2.0
"""What IMUs measure between two true states, and what they make of it: one kernel for all."""

import math
from typing import NamedTuple

import numpy as np

from skyhaul.geometry.kernels import (
    cross,
    mat_t_vec,
    quat_conj,
    quat_exp,
    quat_inv_rotate,
    quat_log,
    quat_mul,
    quat_rotate,
)
from skyhaul.jit import njit
from skyhaul.types import GRAVITY_MPS2, Array, IntArray, Mask

# mypy: disable-error-code="no-any-return"

Q, V, BIAS, COUNT = slice(0, 4), slice(4, 7), slice(7, 13), 13
"""Layout of a row of `state` (14,): the body's q and the IMU's v_WI [m/s] at the last sample, the
biases now, the number of steps since that sample; -1 before the first state."""
STATE_NX = 14
NOISE_NX = 12
"""Normal variates for a sample: six white, six for the random walk."""


class Motion(NamedTuple):
    """Attitude, velocity and body rate of the load and of the vehicles."""

    q_WL: Array  # (4,)
    v_WL: Array  # (3,) [m/s]
    w_WL_L: Array  # (3,) [rad/s]
    q_WB: Array  # (n, 4)
    v_WB: Array  # (n, 3) [m/s]
    w_WB_B: Array  # (n, 3) [rad/s]


class ImuArrays(NamedTuple):
    """k IMUs; columns of six are gyro, then accelerometer."""

    body: IntArray  # (k,) 0 the load, 1 + i vehicle i
    every: IntArray  # (k,) plant steps to a sample
    p_BI: Array  # (k, 3) [m]
    R_BI: Array  # (k, 3, 3)
    white: Array  # (k, 6) standard deviation of a sample's noise [rad/s, m/s^2]
    walk: Array  # (k, 6) standard deviation of the bias's step between samples
    span: Array  # (k, 6) largest reading
    lsb: Array  # (k, 6) step of the reading; 0: continuous


class ImuErrors(NamedTuple):
    """What differs from unit to unit: reading = error @ true + bias."""

    gyro: Array  # (k, 3, 3) scale and misalignment
    accel: Array  # (k, 3, 3)


@njit
def imu_step(
    imus: ImuArrays,
    errors: ImuErrors,
    motion: Motion,
    dt: float,
    noise: Array,
    state: Array,
    out: Array,
    ready: Mask,
) -> None:
    """Advance k IMUs to the next true state.

    A sample is the mean over its period T, as of a sensor that integrates with coning and sculling
    made good: the rotation vector of the period over T, and the IMU's change of velocity less that
    of free fall over T, in the axes half the rotation on. A strapdown integration of the exact
    samples (attitude by the exponential, force turned half-way) meets the true velocity exactly,
    the attitude too, and the place up to T^2/12 times the change of acceleration.

    Args:
        imus: Their parameters.
        errors: Scale and misalignment.
        motion: True state now.
        dt: Time since the state before [s].
        noise: Normal variates, (k, 12).
        state: See `Q` and its neighbours, (k, 14); in place.
        out: Samples, (k, 6) [rad/s, m/s^2]; rows of IMUs that are ready are written.
        ready: Which gave a sample, (k,); written.
    """
    rate = np.empty(6)
    for r in range(imus.body.shape[0]):
        ready[r] = False
        state[r, COUNT] += 1.0
        if 0.0 < state[r, COUNT] < imus.every[r]:
            continue
        _mean(imus, r, motion, max(state[r, COUNT], 1.0) * dt, state[r], rate)
        if state[r, COUNT] > 0.0:
            imu_sample(imus, errors, r, rate, noise[r], state[r], out[r])
            ready[r] = True
        state[r, COUNT] = 0.0


@njit
def _mean(imus: ImuArrays, r: int, motion: Motion, dt: float, state: Array, rate: Array) -> None:
    """Mean angular rate and specific force over the dt since the last sample; keeps the state."""
    b = imus.body[r]
    if b == 0:
        q = (motion.q_WL[0], motion.q_WL[1], motion.q_WL[2], motion.q_WL[3])
        v = (motion.v_WL[0], motion.v_WL[1], motion.v_WL[2])
        w = (motion.w_WL_L[0], motion.w_WL_L[1], motion.w_WL_L[2])
    else:
        i = b - 1
        q = (motion.q_WB[i, 0], motion.q_WB[i, 1], motion.q_WB[i, 2], motion.q_WB[i, 3])
        v = (motion.v_WB[i, 0], motion.v_WB[i, 1], motion.v_WB[i, 2])
        w = (motion.w_WB_B[i, 0], motion.w_WB_B[i, 1], motion.w_WB_B[i, 2])
    arm = quat_rotate(q, cross(w, imus.p_BI[r]))
    old = (state[0], state[1], state[2], state[3])
    turn = quat_log(quat_mul(quat_conj(old), q))
    middle = quat_mul(old, quat_exp((0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2])))
    force_W = (
        (v[0] + arm[0] - state[4]) / dt,
        (v[1] + arm[1] - state[5]) / dt,
        (v[2] + arm[2] - state[6]) / dt + GRAVITY_MPS2,
    )
    force_I = mat_t_vec(imus.R_BI[r], quat_inv_rotate(middle, force_W))
    turn_I = mat_t_vec(imus.R_BI[r], turn)
    for c in range(3):
        rate[c], rate[3 + c] = turn_I[c] / dt, force_I[c]
        state[4 + c] = v[c] + arm[c]
    for c in range(4):
        state[c] = q[c]


@njit
def imu_sample(
    imus: ImuArrays,
    errors: ImuErrors,
    r: int,
    exact: Array,
    noise: Array,
    state: Array,
    out: Array,
) -> None:
    """The reading of IMU r for an exact sample, both (6,); advances the biases in `state`.

    Bias and noise are those of a sensor that integrates over the sample's period T: white noise
    of density N has the variance N^2 / T; the bias walks by K sqrt(T), its mean over the period
    lies half-way plus an independent K sqrt(T / 12), which is part of `ImuArrays.white`.
    """
    for c in range(6):
        row = c % 3
        M, first = (errors.gyro, 0) if c < 3 else (errors.accel, 3)
        value = (
            M[r, row, 0] * exact[first]
            + M[r, row, 1] * exact[first + 1]
            + M[r, row, 2] * exact[first + 2]
        )
        step = imus.walk[r, c] * noise[6 + c]
        value += state[7 + c] + 0.5 * step + imus.white[r, c] * noise[c]
        state[7 + c] += step
        if imus.lsb[r, c] > 0.0:
            value = imus.lsb[r, c] * math.floor(value / imus.lsb[r, c] + 0.5)
        out[c] = min(max(value, -imus.span[r, c]), imus.span[r, c])


@njit
def imu_still(
    imus: ImuArrays, errors: ImuErrors, exact: Array, noise: Array, state: Array, out: Array
) -> None:
    """A long record of IMU 0 at rest.

    Args:
        imus: Their parameters.
        errors: Scale and misalignment.
        exact: What an ideal IMU would read at rest, (6,).
        noise: Normal variates, (m, 12).
        state: Its row, (14,); in place.
        out: Readings, (m, 6); written.
    """
    for i in range(noise.shape[0]):
        imu_sample(imus, errors, 0, exact, noise[i], state, out[i])
