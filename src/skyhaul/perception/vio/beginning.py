# SPDX-License-Identifier: Apache-2.0
"""The first state: from gravity while the vehicle stands, or from structure while it moves."""

from dataclasses import dataclass, field

import numpy as np

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.params import Params
from skyhaul.perception.vio.api import CameraRig, NavState, R, StartPose, V
from skyhaul.perception.vio.imu import ImuNoise, advance, segments, since
from skyhaul.perception.vio.imu_check import check_imu
from skyhaul.perception.vio.intake import Intake
from skyhaul.perception.vio.moving_start import MovingStart, moving_start
from skyhaul.perception.vio.recording import part
from skyhaul.perception.vio.standing import Standing, stands, start_covariance, static_start
from skyhaul.types import US_PER_S, Array

HANGS_MPS = 0.02
"""Standard deviation of the speed of a vehicle that hovers, at rest [m/s]."""
LEAST_SAMPLES = 20
"""Of the IMU of a vehicle that is known to stand."""


@dataclass(frozen=True, kw_only=True)
class Beginning(Params):
    """How the first state is found."""

    standing: Standing = field(default_factory=Standing)
    """When a vehicle counts as standing."""
    moving: MovingStart = field(default_factory=MovingStart)
    """How a vehicle that already moves begins."""
    keep_s: float = 3.0
    """Frames and samples that are kept [s]."""

    def __post_init__(self) -> None:
        standing = self.standing
        least_s = max(1.1 * self.moving.span_s, 1.1 * standing.init_s, 1.1 * standing.certain_s)
        if not self.keep_s >= least_s:
            raise ValueError(f"keep_s must be >= {least_s:g}, got {self.keep_s}")


def begin(
    params: Beginning,
    intake: Intake,
    start: StartPose,
    rig: CameraRig,
    noise: ImuNoise,
    sigma: float,
) -> tuple[NavState, Array] | None:
    """State and covariance now, or None while they cannot be known yet."""
    standing = params.standing
    if start.q_WI is not None:
        return _surveyed(standing, intake, start, start.q_WI, noise)
    if start.stands_until_us > 0:
        return _known_to_stand(standing, intake, start, noise)
    if not intake.checked:
        return None
    if stands(standing, intake.frames, intake.imu, standing.init_s):
        begin_us = intake.now_us - round(standing.init_s * US_PER_S)
        return static_start(standing, since(intake.imu, begin_us), start)
    if not _attempt_due(params, intake) or stands(
        standing, intake.frames, intake.imu, standing.window_s
    ):
        return None
    return moving_start(params.moving, standing, intake, start, rig, noise, sigma)


def _known_to_stand(
    standing: Standing, intake: Intake, start: StartPose, noise: ImuNoise
) -> tuple[NavState, Array] | None:
    """The same for a vehicle on the floor: however short it stands, that is used.

    Raises:
        SensorDataError: When its samples are nonsense.
    """
    until_us = start.stands_until_us
    if intake.now_us < until_us or len(intake.imu.stamp_us) < LEAST_SAMPLES:
        return None
    check_imu(intake.imu)
    rests = int(np.searchsorted(intake.imu.stamp_us, until_us, side="right"))
    if rests < LEAST_SAMPLES:
        return None
    state, before = static_start(standing, part(intake.imu, 0, rests), start)
    if intake.now_us == until_us:
        return state, before
    moved = segments(intake.imu, until_us, intake.now_us)
    state, Phi, Q = advance(state, moved, noise.densities())
    return state, Phi @ before @ Phi.T + Q


def _surveyed(
    standing: Standing, intake: Intake, start: StartPose, q_WI: Array, noise: ImuNoise
) -> tuple[NavState, Array] | None:
    """From a pose at time 0, at rest, by the IMU; its biases are those of its calibration.

    Raises:
        SensorDataError: When its samples are nonsense.
    """
    if len(intake.imu.stamp_us) < LEAST_SAMPLES:
        return None
    check_imu(intake.imu)
    state = NavState(start.p_WI, q_WI, np.zeros(3), np.zeros(3), np.zeros(3))
    before = start_covariance(standing, start, quat_to_R(q_WI))
    before[R, R] = start.sigma_yaw_rad**2 * np.eye(3)
    before[V, V] = HANGS_MPS**2 * np.eye(3)
    state, Phi, Q = advance(state, segments(intake.imu, 0, intake.now_us), noise.densities())
    return state, Phi @ before @ Phi.T + Q


def _attempt_due(params: Beginning, intake: Intake) -> bool:
    """Whether a multiple of `retry_s` passed since the frame before."""
    if len(intake.frames) < 2:
        return False
    every = round(params.moving.retry_s * US_PER_S)
    return intake.now_us // every != intake.frames[-2].stamp_us // every
