# SPDX-License-Identifier: Apache-2.0
"""Preintegrated motion: what the IMU says between two frames, whatever the state at the first."""

from dataclasses import dataclass

import numpy as np

from skyhaul.geometry.quaternion import R_to_quat, quat_rotate, quat_to_R
from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.vio.api import BA, BG, NE, NavState, P, R, V
from skyhaul.perception.vio.imu import GRAVITY_W
from skyhaul.perception.vio.propagation import propagate
from skyhaul.types import Array, frozen


@dataclass(frozen=True, eq=False)
class Preintegrated:
    """Relative motion from the first frame i to the last frame j, in axes of i.

    R_ij, dv = R_i^T (v_j - v_i - g dt), dp = R_i^T (p_j - p_i - v_i dt - 1/2 g dt^2).
    """

    dt_s: float
    R_ij: Array  # (3, 3)
    dv: Array  # (3,) [m/s]
    dp: Array  # (3,) [m]
    gyro_bias: Array  # (3,) that was taken off the samples [rad/s]
    accel_bias: Array  # (3,) [m/s^2]
    by_bias: Array  # (9, 6) derivative of the error (p, R, v) by the biases
    covariance: Array  # (15, 15) of the error, walk of the biases included

    def __post_init__(self) -> None:
        frozen(self.R_ij, self.dv, self.dp, self.by_bias, self.covariance)

    def corrected(self, gyro_bias: Array, accel_bias: Array) -> tuple[Array, Array, Array]:
        """R_ij, dv, dp for other biases, to first order: no sample is integrated anew."""
        d = self.by_bias @ np.concatenate(
            [gyro_bias - self.gyro_bias, accel_bias - self.accel_bias]
        )
        return self.R_ij @ so3_exp(d[R]), self.dv + d[V], self.dp + d[P]

    def predict(self, state: NavState) -> NavState:
        """State at j from the state at i."""
        R_ij, dv, dp = self.corrected(state.gyro_bias, state.accel_bias)
        h, q = self.dt_s, state.q_WI
        return NavState(
            state.p_WI + h * state.v_WI + 0.5 * h * h * GRAVITY_W + quat_rotate(q, dp),
            R_to_quat(quat_to_R(q) @ R_ij),
            state.v_WI + h * GRAVITY_W + quat_rotate(q, dv),
            state.gyro_bias,
            state.accel_bias,
        )


def preintegrate(
    samples: Array, gyro_bias: Array, accel_bias: Array, noise: Array
) -> Preintegrated:
    """Sum IMU segments up, see `imu.segments` for them and `propagate` for the noise."""
    x = np.concatenate([np.zeros(6), gyro_bias, accel_bias])
    R_ij, Phi, Q = np.eye(3), np.empty((NE, NE)), np.empty((NE, NE))
    propagate(x, R_ij, np.zeros(3), samples, noise, Phi, Q)
    by_bias = Phi[:9, BG.start : BA.stop]
    dt_s = float(samples[:, 0].sum())
    return Preintegrated(dt_s, R_ij, x[3:6], x[:3], gyro_bias, accel_bias, by_bias, Q)
