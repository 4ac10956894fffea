# SPDX-License-Identifier: Apache-2.0
"""Odometry of the vehicles made from truth, with the errors that real odometry has.

It stands in for cameras and their estimator where those are not what is looked at. Errors of a
vehicle, each with the covariance that follows from it exactly:

    yaw        random walk in time while the vehicle moves
    position   random walk in the way flown; besides, the yaw's error turns the way flown
    tilt       first-order Gauss-Markov
    velocity   first-order Gauss-Markov; biases are off by constants
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.geometry.quaternion import R_to_quat, quat_exp, quat_mul, quat_rotate, quat_to_R
from skyhaul.params import Params
from skyhaul.perception.vio.api import NavState, VioEstimate, VioStatus
from skyhaul.plant.api import PLANT_STEP_US, Truth
from skyhaul.sensors.api import ImuCalibration
from skyhaul.types import US_PER_S, Array, TimeUs

_STILL_M = 1e-3
"""A vehicle that moved less between two estimates does not drift [m]."""


class OdometryMemory(NamedTuple):
    """Errors of one vehicle's odometry now."""

    seed: int
    vehicle: int
    of: int  # vehicles of the team; they speak in turn
    p_WI: Array  # (3,) true place at the last estimate [m]; nan before the first
    drift: Array  # (4,) of position [m] and yaw [rad]
    covariance: Array  # (4, 4) of them
    tilt: Array  # (2,) [rad]
    slip: Array  # (3,) of the velocity [m/s]


@dataclass(frozen=True, kw_only=True)
class ModelledOdometry(Params):
    """The true pose with errors; all sizes are standard deviations, 0 for none.

    The defaults make a mean RMS error of 0.5 % of the way on flights of `paper`.
    """

    kind: Literal["modelled"] = "modelled"
    rate_hz: int = 10
    """Estimates a second; divides the 500 steps of the plant [Hz]."""
    way_m_per_sqrt_m: float = 0.014
    """Drift of each axis of the position, per square root of the way."""
    yaw_deg_per_sqrt_s: float = 0.05
    """Drift of the yaw, per square root of the time in motion."""
    tilt_deg: float = 0.2
    """Error of roll and of pitch [deg]."""
    tilt_time_s: float = 5.0
    """How long it lasts [s]."""
    velocity_mps: float = 0.02
    """Error of each axis of the velocity [m/s]."""
    velocity_time_s: float = 0.5
    """How long it lasts [s]."""
    jitter_m: float = 0.002
    """White error of each axis of the position [m]."""
    gyro_bias_radps: float = 5e-4
    """Error of the gyro's bias [rad/s]."""
    accel_bias_mps2: float = 0.02
    """Error of the accelerometer's bias [m/s^2]."""
    start_m: float = 1e-3
    """Error of each axis of the start [m]."""
    start_deg: float = 0.06
    """Error of the heading at the start [deg]."""

    def __post_init__(self) -> None:
        steps = US_PER_S // PLANT_STEP_US
        if not (self.rate_hz > 0 and steps % self.rate_hz == 0):
            raise ValueError(f"rate_hz must divide {steps}, got {self.rate_hz}")
        if not min(self.tilt_time_s, self.velocity_time_s) > 0.0:
            raise ValueError("tilt_time_s and velocity_time_s must be > 0")
        for name, value in vars(self).items():
            if name != "kind" and not value >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {value}")

    def init(self, seed: int, vehicle: int, count: int) -> OdometryMemory:
        """Before the first estimate of a vehicle of a team."""
        z = _draws(seed, vehicle, 0)
        size = np.array([*[self.start_m] * 3, math.radians(self.start_deg)])
        tilt = math.radians(self.tilt_deg) * z[4:6]
        return OdometryMemory(
            seed, vehicle, count, np.full(3, np.nan), size * z[:4], np.diag(size**2), tilt,
            np.zeros(3),
        )  # fmt: skip

    def step(
        self, memory: OdometryMemory, truth: Truth, imu: ImuCalibration, bias: Array
    ) -> tuple[OdometryMemory, VioEstimate | None]:
        """An estimate where one is due.

        Args:
            memory: What `init` or the last `step` returned.
            truth: True state now.
            imu: Where the vehicle's IMU sits.
            bias: True biases of its gyro and accelerometer, (6,).
        """
        period_us = US_PER_S // self.rate_hz
        turn_us = period_us // PLANT_STEP_US * memory.vehicle // memory.of * PLANT_STEP_US
        since = truth.stamp_us - turn_us
        if since < 0 or since % period_us:
            return memory, None
        i, z = memory.vehicle, _draws(memory.seed, memory.vehicle, 1 + since // period_us)
        q_WB, w = truth.team.q_WB[i], truth.team.w_WB_B[i]
        p_WI = truth.team.p_WB[i] + quat_rotate(q_WB, imu.p_BI)
        v_WI = truth.team.v_WB[i] + quat_rotate(q_WB, np.cross(w, imu.p_BI))
        memory = self._drift(memory, p_WI, z)
        constant = _draws(memory.seed, memory.vehicle, 0)[6:12]
        turn = np.array([*memory.tilt, memory.drift[3]])
        state = NavState(
            p_WI=p_WI + memory.drift[:3] + self.jitter_m * z[9:12],
            q_WI=quat_mul(quat_exp(turn), quat_mul(q_WB, R_to_quat(imu.R_BI))),
            v_WI=v_WI + memory.slip,
            gyro_bias=bias[:3] + self.gyro_bias_radps * constant[:3],
            accel_bias=bias[3:] + self.accel_bias_mps2 * constant[3:],
        )
        return memory, self._estimate(truth.stamp_us, state, memory.covariance)

    def _drift(self, memory: OdometryMemory, p_WI: Array, z: Array) -> OdometryMemory:
        first = bool(np.isnan(memory.p_WI[0]))
        way = np.zeros(3) if first else p_WI - memory.p_WI
        size, dt = float(np.linalg.norm(way)), 1.0 / self.rate_hz
        moves = size > _STILL_M
        F = np.eye(4)
        F[0, 3], F[1, 3] = -way[1], way[0]
        yaw = math.radians(self.yaw_deg_per_sqrt_s)
        Q = np.array([*[self.way_m_per_sqrt_m**2 * size] * 3, yaw**2 * dt * moves])
        keep, slow = math.exp(-dt / self.tilt_time_s), math.exp(-dt / self.velocity_time_s)
        tilt = math.radians(self.tilt_deg) * math.sqrt(1.0 - keep**2) * z[4:6]
        slip = self.velocity_mps * math.sqrt(1.0 - slow**2) * z[6:9] * moves
        return memory._replace(
            p_WI=p_WI,
            drift=F @ memory.drift + np.sqrt(Q) * z[:4],
            covariance=F @ memory.covariance @ F.T + np.diag(Q),
            tilt=memory.tilt if first else keep * memory.tilt + tilt,
            slip=slow * memory.slip + slip,
        )

    def _estimate(self, stamp_us: TimeUs, state: NavState, drift: Array) -> VioEstimate:
        """With its covariance; the attitude's from world to body axes."""
        bias = (self.gyro_bias_radps**2, self.accel_bias_mps2**2)
        least = (self.jitter_m**2, 0.0, self.velocity_mps**2, *bias)
        cov = np.diag(np.repeat(least, 3) + 1e-8)
        W, R = np.zeros((6, 6)), np.eye(6)
        W[3, 3] = W[4, 4] = math.radians(self.tilt_deg) ** 2
        W[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])] = drift
        R[3:, 3:] = quat_to_R(state.q_WI)
        cov[:6, :6] += R.T @ W @ R
        return VioEstimate(stamp_us, VioStatus.TRACKING, state, cov, 0, 0)


def without_errors(model: ModelledOdometry) -> ModelledOdometry:
    """The same odometry, exact."""
    return ModelledOdometry(
        rate_hz=model.rate_hz, way_m_per_sqrt_m=0.0, yaw_deg_per_sqrt_s=0.0, tilt_deg=0.0,
        velocity_mps=0.0, jitter_m=0.0, gyro_bias_radps=0.0, accel_bias_mps2=0.0, start_m=0.0,
        start_deg=0.0,
    )  # fmt: skip


def _draws(seed: int, vehicle: int, number: int) -> Array:
    """Normal variates of one estimate, (12,); number 0: those of the whole flight."""
    return np.random.default_rng([seed, vehicle, number, 77]).standard_normal(12)
