# SPDX-License-Identifier: Apache-2.0
"""Has a vehicle come to rest? What its tracks say must pass its IMU and its own estimate.

Tracks that stand are no proof: before a plain wall a tracker follows the noise of the image, which
stays where it is however fast the vehicle flies.
"""

import itertools
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.special import chdtri

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.so3 import hat
from skyhaul.perception.vio.api import BA, BG, NE, NavState, R, V
from skyhaul.perception.vio.imu import GRAVITY_W, NO_SAMPLES
from skyhaul.perception.vio.intake import Intake
from skyhaul.perception.vio.standing import Standing, stands
from skyhaul.sensors.api import ImuReading
from skyhaul.types import US_PER_S, Array, TimeUs

GATE = 0.999
"""Share of vehicles at rest that pass each test."""

KNOWN = 2.0
"""How many times as badly a velocity may be known at most for the IMU alone to tell rest."""


class Rest(StrEnum):
    """What is known of a vehicle's rest."""

    NO = "no"
    """It moves, or nobody knows."""
    YES = "yes"
    """Tracks, IMU and estimate agree that it stands."""
    DESPITE = "despite"
    """It has stood for long; the estimate says otherwise and must be wrong."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """Means of the IMU over a piece of time."""

    gyro_I: Array  # (3,) [rad/s]
    accel_I: Array  # (3,) [m/s^2]


def rest_of(params: Standing, intake: Intake, state: NavState, covariance: Array) -> Rest:
    """Whether the vehicle stands at the last frame.

    The tracks must stand, and the IMU must: no rate but the bias, a steady force. Then velocity
    and acceleration of the estimate must not differ from zero by more than its covariance allows.
    A velocity that does differ is overruled once tracks and IMU have stood for `certain_s` and no
    acceleration contradicts: a vehicle that turns round slowly before a far wall has one. Without
    tracks nothing is overruled, and a velocity must be known well to be that of rest: who flies
    steadily in the dark feels what one feels who stands.

    Args:
        params: Thresholds.
        intake: Frames and samples.
        state: Predicted at the last frame.
        covariance: Of its error, (15, 15).
    """
    pieces = _pieces(params, intake.imu, intake.now_us, params.window_s)
    if not _imu_rests(params, pieces, state, covariance):
        return Rest.NO
    seen = stands(params, intake.frames, NO_SAMPLES, params.window_s)
    felt = _slow(params, covariance) and stands(params, intake.frames, intake.imu, params.window_s)
    if not seen and not felt:
        return Rest.NO
    if _estimate_rests(params, pieces, state, covariance):
        return Rest.YES
    if not seen or not stands(params, intake.frames, NO_SAMPLES, params.certain_s):
        return Rest.NO
    pieces = _pieces(params, intake.imu, intake.now_us, params.certain_s)
    steady = _imu_rests(params, pieces, state, covariance)
    certain = steady and _force_rests(params, params.certain_s, pieces, state, covariance)
    return Rest.DESPITE if certain else Rest.NO


def widened(state: NavState, covariance: Array) -> Array:
    """The covariance of an estimate whose velocity turned out to be wrong by all of it."""
    out = covariance.copy()
    out[V, V] += float(state.v_WI @ state.v_WI) * np.eye(3)
    return out


def brought_to_rest(params: Standing, state: NavState, covariance: Array) -> tuple[NavState, Array]:
    """State and covariance after one update with zero velocity, of an estimate that was wrong.

    Only the velocity changes: what the false velocity did to the rest is not known.
    """
    wide = widened(state, covariance)
    H = np.zeros((3, NE))
    H[:, V] = np.eye(3)
    noise = params.speed_sigma_mps**2 * np.eye(3)
    K = np.linalg.solve(wide[V, V] + noise, H @ wide).T
    I_KH = np.eye(NE) - K @ H
    after = I_KH @ wide @ I_KH.T + K @ noise @ K.T
    v_WI = state.v_WI - K[V] @ state.v_WI
    at_rest = NavState(state.p_WI, state.q_WI, v_WI, state.gyro_bias, state.accel_bias)
    return at_rest, 0.5 * (after + after.T)


def _pieces(params: Standing, imu: ImuReading, now_us: TimeUs, span_s: float) -> list[_Piece]:
    """Means over pieces of half a window that end now; none where one of them has no sample."""
    count = max(2, round(2.0 * span_s / params.window_s))
    edges = now_us - np.round(np.linspace(span_s, 0.0, count + 1) * US_PER_S).astype(np.int64)
    cuts = np.searchsorted(imu.stamp_us, edges, side="right")
    if np.any(np.diff(cuts) < 1):
        return []
    return [
        _Piece(imu.gyro_I[a:b].mean(axis=0), imu.accel_I[a:b].mean(axis=0))
        for a, b in itertools.pairwise(cuts)
    ]


def _imu_rests(params: Standing, pieces: list[_Piece], state: NavState, covariance: Array) -> bool:
    """Whether there is no rate and the force stays what it is; rotors may shake."""
    if not pieces:
        return False
    shorter = params.init_s / (0.5 * params.window_s)  # than what the sigmas are given for
    mean = np.mean([p.accel_I for p in pieces], axis=0)
    rate = covariance[BG, BG] + shorter * params.rate_sigma_rad_s**2 * np.eye(3)
    force = shorter * params.force_sigma_mps2**2 * np.eye(3)
    return all(
        _small(p.gyro_I - state.gyro_bias, rate) and _small(p.accel_I - mean, force) for p in pieces
    )


def _estimate_rests(
    params: Standing, pieces: list[_Piece], state: NavState, covariance: Array
) -> bool:
    """Whether velocity and acceleration are zero within the covariance: chi-square, 3 dof each."""
    speed = covariance[V, V] + params.speed_sigma_mps**2 * np.eye(3)
    return _small(state.v_WI, speed) and _force_rests(
        params, params.window_s, pieces, state, covariance
    )


def _slow(params: Standing, covariance: Array) -> bool:
    """Whether the velocity is known nearly as well as that of a vehicle that stands."""
    return float(np.trace(covariance[V, V])) <= 3.0 * (KNOWN * params.speed_sigma_mps) ** 2


def _force_rests(
    params: Standing, span_s: float, pieces: list[_Piece], state: NavState, covariance: Array
) -> bool:
    """Whether the mean force over a time is gravity's, as far as tilt and bias are known."""
    R_WI = quat_to_R(state.q_WI)
    force = np.mean([p.accel_I for p in pieces], axis=0) - state.accel_bias
    H = np.zeros((3, NE))
    H[:, R], H[:, BA] = -R_WI @ hat(force), -R_WI
    shorter = params.init_s / span_s
    noise = shorter * params.force_sigma_mps2**2 * np.eye(3)
    return _small(R_WI @ force + GRAVITY_W, H @ covariance @ H.T + noise)


def _small(residual: Array, covariance: Array) -> bool:
    bound = float(chdtri(3, 1.0 - GATE))
    return float(residual @ np.linalg.solve(covariance, residual)) <= bound
