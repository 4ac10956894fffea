# SPDX-License-Identifier: Apache-2.0
"""Odometry of each vehicle of a recorded flight: exact, with errors of a model, or from files.

The model, for every vehicle, at 10 Hz, with the covariance that follows from it exactly:

    yaw         random walk in time while it moves
    position    random walk in the way flown, and the way flown turned by the yaw's error
    tilt        first-order Gauss-Markov
    velocity    first-order Gauss-Markov; biases off by constants
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from team_recordings import Recording

from skyhaul.geometry.quaternion import quat_exp, quat_mul, quat_rotate, quat_to_R
from skyhaul.perception.vio.api import NavState, VioEstimate, VioStatus
from skyhaul.types import Array

PERIOD_US = 100_000


@dataclass(frozen=True, kw_only=True)
class OdometryModel:
    """Sizes of the errors, standard deviations."""

    way_m_per_sqrt_m: float = 0.014
    """Of each axis of the position per square root of the way. With the yaw's: a mean RMS error of
    0.5 % of the way on flights of `paper`, what the odometry's own bar allows."""
    yaw_deg_per_sqrt_s: float = 0.05
    tilt_deg: float = 0.2
    tilt_time_s: float = 5.0
    velocity_mps: float = 0.02
    velocity_time_s: float = 0.5
    jitter_m: float = 0.002
    gyro_bias_radps: float = 5e-4
    accel_bias_mps2: float = 0.02
    start_m: float = 1e-3
    start_rad: float = 1e-3
    drifting: int = -1
    """A vehicle whose drift is `drift_factor` times as large; its covariance says so."""
    drift_factor: float = 5.0


@lru_cache(maxsize=8)
def truth_of(recording: Recording, vehicle: int) -> tuple[Array, Array, Array]:
    """True pose and velocity of a vehicle's IMU at every step: p_WI, q_WI, v_WI."""
    track, arm = recording.track, recording.config.sensors.imu.calibration().p_BI
    p, q = track.p_WB[:, vehicle], track.q_WB[:, vehicle]
    v, w = track.v_WB[:, vehicle], track.w_WB_B[:, vehicle]
    return p + quat_rotate(q, arm), q, v + quat_rotate(q, np.cross(w, arm))


def rows_of(recording: Recording, vehicle: int) -> Array:
    """Steps at which a vehicle's odometry speaks: when its cameras do."""
    n = recording.config.team.count
    lag = vehicle * (PERIOD_US // 2_000) // n
    return np.arange(lag, len(recording.track), PERIOD_US // 2_000)


def exact(recording: Recording, vehicle: int) -> Iterator[VioEstimate]:
    """Odometry without any error."""
    p, q, v = truth_of(recording, vehicle)
    cov = np.diag(np.repeat([1e-8, 1e-8, 1e-6, 1e-8, 1e-4], 3))
    gyro, accel = recording.bias[1 + vehicle, :3], recording.bias[1 + vehicle, 3:]
    for k in rows_of(recording, vehicle).tolist():
        state = NavState(p[k].copy(), q[k].copy(), v[k].copy(), gyro.copy(), accel.copy())
        yield VioEstimate(2_000 * k, VioStatus.TRACKING, state, cov.copy(), 50, 0)


def modelled(recording: Recording, vehicle: int, model: OdometryModel) -> Iterator[VioEstimate]:
    """Odometry with errors of the model."""
    rng = np.random.default_rng([recording.seed, vehicle, 77])
    p, q, v = truth_of(recording, vehicle)
    grow = model.drift_factor if vehicle == model.drifting else 1.0
    walk, yaw = grow * model.way_m_per_sqrt_m, grow * math.radians(model.yaw_deg_per_sqrt_s)
    tilt, dt = math.radians(model.tilt_deg), 1e-6 * PERIOD_US
    keep, slow = math.exp(-dt / model.tilt_time_s), math.exp(-dt / model.velocity_time_s)
    C = np.diag([model.start_m**2] * 3 + [model.start_rad**2])
    drift = np.sqrt(np.diag(C)) * rng.standard_normal(4)
    lean, slip = tilt * rng.standard_normal(2), np.zeros(3)
    gyro = recording.bias[1 + vehicle, :3] + model.gyro_bias_radps * rng.standard_normal(3)
    accel = recording.bias[1 + vehicle, 3:] + model.accel_bias_mps2 * rng.standard_normal(3)
    before = None
    for k in rows_of(recording, vehicle).tolist():
        way = np.zeros(3) if before is None else p[k] - p[before]
        size = float(np.linalg.norm(way))
        moves = size > 1e-3
        F = np.eye(4)
        F[0, 3], F[1, 3] = -way[1], way[0]
        Q = np.diag([walk**2 * size] * 3 + [yaw**2 * dt * moves])
        C = F @ C @ F.T + Q
        drift = F @ drift + np.sqrt(np.diag(Q)) * rng.standard_normal(4)
        lean = keep * lean + tilt * math.sqrt(1.0 - keep**2) * rng.standard_normal(2)
        noise = model.velocity_mps * math.sqrt(1.0 - slow**2) * rng.standard_normal(3)
        slip = slow * slip + noise * moves
        before = k
        turn = np.array([lean[0], lean[1], drift[3]])
        jitter = model.jitter_m * rng.standard_normal(3)
        state = NavState(
            p[k] + drift[:3] + jitter, quat_mul(quat_exp(turn), q[k]), v[k] + slip, gyro, accel
        )
        cov = np.diag(np.repeat([model.jitter_m**2, 0, model.velocity_mps**2, 2.5e-7, 4e-4], 3))
        W = np.zeros((6, 6))
        W[3, 3] = W[4, 4] = tilt**2
        W[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])] = C
        R = np.eye(6)
        R[3:, 3:] = quat_to_R(state.q_WI)
        cov[:6, :6] += R.T @ W @ R
        yield VioEstimate(2_000 * k, VioStatus.TRACKING, state, cov, 50, 0)


def from_file(file: Path) -> Iterator[VioEstimate]:
    """Odometry that an estimator wrote into a NumPy archive.

    Rows: `stamp_us`, `p_WI`, `q_WI`, `v_WI`, `gyro_bias`, `accel_bias`, `covariance` (k, 15, 15)
    of `VioEstimate`, and `tracking` (k,).
    """
    with np.load(file) as rows:
        kept = {name: rows[name] for name in rows.files}
    for k, stamp in enumerate(kept["stamp_us"].tolist()):
        names = ("p_WI", "q_WI", "v_WI", "gyro_bias", "accel_bias")
        status = VioStatus.TRACKING if kept["tracking"][k] else VioStatus.LOST
        state = NavState(*(kept[name][k].copy() for name in names))
        yield VioEstimate(stamp, status, state, kept["covariance"][k].copy(), 0, 0)
